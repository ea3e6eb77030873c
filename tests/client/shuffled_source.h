// A network at its worst that still delivers: what answers a wish comes in any order and in pieces of any
// size, and a part of it is held back, so that it must be wished for again.
#pragma once

#include <algorithm>
#include <iterator>
#include <random>
#include <utility>
#include <vector>

#include "forwarding_source.h"

namespace brickyard {

class ShuffledSource final : public ForwardingSource {
public:
    ShuffledSource(std::unique_ptr<BrickSource> inner, unsigned seed)
        : ForwardingSource(std::move(inner)), random_(seed) {}

    Result<FrameFooter> openFrame(std::uint32_t frame,
                                  SourceDeadline deadline = SourceDeadline::max()) override {
        waiting_.clear();
        return inner_->openFrame(frame, deadline);
    }
    Result<void> wish(PageWish newest) override {
        waiting_.clear();
        if (Result<void> sent = inner_->wish(std::move(newest)); !sent) return sent;
        for (;;) {
            Result<std::vector<Arrival>> some = inner_->take(std::chrono::steady_clock::time_point::max());
            if (!some) return tl::unexpected(some.error());
            if (some->empty()) break;
            std::move(some->begin(), some->end(), std::back_inserter(waiting_));
        }
        std::shuffle(waiting_.begin(), waiting_.end(), random_);
        // At least one is delivered, so that a client gets on.
        const std::size_t held_back = waiting_.size() > 1 ? random_() % (waiting_.size() / 2 + 1) : 0;
        waiting_.erase(waiting_.end() - std::ptrdiff_t(held_back), waiting_.end());
        held_back_ += held_back;
        return {};
    }
    Result<std::vector<Arrival>> take(std::chrono::steady_clock::time_point) override {
        std::vector<Arrival> piece;
        for (std::size_t count = 1 + random_() % 7; count > 0 && !waiting_.empty(); --count) {
            piece.push_back(std::move(waiting_.back()));
            waiting_.pop_back();
        }
        return piece;
    }
    bool wishDone() const override { return waiting_.empty(); }
    std::uint64_t heldBack() const { return held_back_; }

private:
    std::mt19937 random_;
    std::vector<Arrival> waiting_;
    std::uint64_t held_back_ = 0;
};

}  // namespace brickyard

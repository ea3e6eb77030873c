#include "client/wish_turns.h"

#include <algorithm>

namespace brickyard {

bool WishTurns::inLine(const DatasetStream& stream) const {
    return std::find(line_.begin(), line_.end(), &stream) != line_.end();
}

void WishTurns::enter(DatasetStream& stream) {
    if (holder_ == &stream) holder_ = nullptr;
    if (!inLine(stream)) line_.push_back(&stream);
    if (!holder_ || unbroken_) return;
    line_.push_back(holder_);
    holder_ = nullptr;
}

bool WishTurns::leave(DatasetStream& stream) {
    std::erase(line_, &stream);
    for (auto& [epoch, owner] : owners_)
        if (owner == &stream) owner = nullptr;
    if (hungry_ == &stream) hungry_ = nullptr;
    if (holder_ != &stream) return false;
    holder_ = nullptr;
    return line_.empty();
}

void WishTurns::restart() {
    if (holder_ && !inLine(*holder_)) line_.push_front(holder_);
    holder_ = nullptr;
    owners_.clear();
}

void WishTurns::sent(DatasetStream& stream) {
    std::erase(line_, &stream);
    holder_ = &stream;
    sliced_ = false;
    unbroken_ = stream.wanted.has_camera();
    owners_.emplace_back(stream.epoch, &stream);
}

std::optional<Wish> WishTurns::next() {
    if (holder_) return std::nullopt;
    const auto first = std::find_if(line_.begin(), line_.end(), [](auto* s) { return s->frame_open; });
    if (first == line_.end()) return std::nullopt;
    DatasetStream& stream = **first;
    line_.erase(first);
    const bool others = std::any_of(line_.begin(), line_.end(), [](auto* s) { return s->frame_open; });

    // A list that was asked for before is asked for without what came; a camera's pages come again.
    if (stream.wanted.has_camera())
        stream.credit_left = stream.credit_granted;
    else
        dropPages(stream.wanted, stream.had);
    Wish wish = stream.wanted;
    std::uint64_t credit = stream.credit_left;
    unbroken_ = wish.has_camera() || hungry_ == &stream;
    sliced_ = others && !unbroken_;
    if (hungry_ == &stream) hungry_ = nullptr;
    cut_ = sliced_ && wish.pages_size() > kTurnPages;
    if (sliced_) {
        credit = std::min(credit, kTurnBytes);
        if (cut_) wish.mutable_pages()->DeleteSubrange(kTurnPages, wish.pages_size() - kTurnPages);
    }
    stream.epoch = nextEpoch();
    if (stream.first_epoch == 0) stream.first_epoch = stream.epoch;
    wish.set_epoch(stream.epoch);
    wish.set_dataset_id(stream.dataset_id);
    wish.set_frame(*stream.frame);
    wish.set_credit_bytes(credit);
    left_before_ = stream.credit_left;
    holder_ = &stream;
    owners_.emplace_back(stream.epoch, &stream);
    return wish;
}

DatasetStream* WishTurns::ownerOf(std::uint64_t epoch) {
    // The server answers in order: nothing of an older wish comes behind this.
    while (!owners_.empty() && owners_.front().first < epoch) owners_.pop_front();
    return !owners_.empty() && owners_.front().first == epoch ? owners_.front().second : nullptr;
}

bool WishTurns::finish(std::uint64_t epoch, bool credit_exhausted) {
    DatasetStream* owner = ownerOf(epoch);
    // Of a wish that was replaced, or waits in the line for its next turn.
    if (!owner || owner->epoch != epoch || holder_ != owner) return false;
    holder_ = nullptr;
    if (!cut_ && !(sliced_ && credit_exhausted)) return true;
    dropPages(owner->wanted, owner->had);
    if (owner->wanted.pages_size() + owner->wanted.blocks_size() == 0) return true;
    if (credit_exhausted && left_before_ <= kTurnBytes) return true;
    if (owner->credit_left == left_before_) hungry_ = owner;
    line_.push_back(owner);
    return false;
}

}  // namespace brickyard

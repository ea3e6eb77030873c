// Memory that all clients share, counted but not held: whoever allocates reserves first. Any thread.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <utility>

namespace brickyard {

class ByteBudget {
public:
    explicit ByteBudget(std::uint64_t limit) : limit_(limit) {}

    // Gives back what it reserved when it goes.
    class Share {
    public:
        Share() = default;
        Share(Share&& other) noexcept { *this = std::move(other); }
        Share& operator=(Share&& other) noexcept {
            if (this == &other) return *this;
            reset();
            budget_ = std::exchange(other.budget_, nullptr);
            bytes_ = std::exchange(other.bytes_, 0);
            return *this;
        }
        ~Share() { reset(); }
        std::uint64_t bytes() const { return bytes_; }
        // False, and nothing changes, where there is no room.
        bool growTo(std::uint64_t bytes) {
            if (bytes <= bytes_ || budget_ == nullptr) return true;
            Share more = budget_->reserveUpTo(bytes - bytes_);
            if (more.bytes_ < bytes - bytes_) return false;
            more.budget_ = nullptr;
            bytes_ = bytes;
            return true;
        }
        void reset() {
            if (budget_ != nullptr) budget_->used_.fetch_sub(bytes_, std::memory_order_relaxed);
            budget_ = nullptr;
            bytes_ = 0;
        }

    private:
        friend class ByteBudget;
        ByteBudget* budget_ = nullptr;
        std::uint64_t bytes_ = 0;
    };

    // As much of `wanted` as there is room for, perhaps nothing.
    Share reserveUpTo(std::uint64_t wanted) {
        std::uint64_t used = used_.load(std::memory_order_relaxed), given = 0;
        do {
            given = used >= limit_ ? 0 : std::min(wanted, limit_ - used);
        } while (!used_.compare_exchange_weak(used, used + given, std::memory_order_relaxed));
        Share share;
        share.budget_ = this;
        share.bytes_ = given;
        return share;
    }
    std::uint64_t usedBytes() const { return used_.load(std::memory_order_relaxed); }
    std::uint64_t limitBytes() const { return limit_; }

private:
    const std::uint64_t limit_;
    std::atomic<std::uint64_t> used_{0};
};

}  // namespace brickyard

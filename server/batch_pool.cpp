#include "server/batch_pool.h"

#include <algorithm>
#include <utility>

namespace brickyard {
namespace {

// Kept for the next client; the rest goes back to the system when it is quiet.
constexpr std::size_t kSpares = 64;

}  // namespace

BatchMemory& BatchMemory::operator=(BatchMemory&& other) noexcept {
    if (this == &other) return *this;
    reset();
    bytes_ = std::move(other.bytes_);
    capacity_ = std::exchange(other.capacity_, 0);
    pool_ = std::exchange(other.pool_, nullptr);
    return *this;
}

void BatchMemory::reset() {
    if (bytes_) pool_->giveBack(std::move(bytes_), capacity_);
    capacity_ = 0;
    pool_ = nullptr;
}

BatchMemory BatchPool::take(std::size_t bytes) {
    BatchMemory memory;
    const std::size_t capacity = std::max(bytes, kBatchBytes);
    {
        const std::lock_guard lock(mutex_);
        if (used_bytes_ != 0 && used_bytes_ + capacity > budget_bytes_) return memory;
        used_bytes_ += capacity;
        if (capacity == kBatchBytes && !spare_.empty()) {
            memory.bytes_ = std::move(spare_.back());
            spare_.pop_back();
        }
    }
    memory.pool_ = this;
    memory.capacity_ = capacity;
    if (!memory.bytes_) {
        try {
            memory.bytes_ = std::make_unique_for_overwrite<std::byte[]>(capacity);
        } catch (const std::bad_alloc&) {
            // The machine has less than the budget: as if that were used up.
            giveBack(nullptr, capacity);
            memory.capacity_ = 0;
        }
    }
    return memory;
}

void BatchPool::await(std::function<void()> retry) {
    {
        const std::lock_guard lock(mutex_);
        if (used_bytes_ != 0 && used_bytes_ + kBatchBytes > budget_bytes_) {
            waiting_.push_back(std::move(retry));
            return;
        }
    }
    retry();
}

std::uint64_t BatchPool::usedBytes() const {
    const std::lock_guard lock(mutex_);
    return used_bytes_;
}

void BatchPool::giveBack(std::unique_ptr<std::byte[]> bytes, std::size_t capacity) {
    std::function<void()> next;
    {
        const std::lock_guard lock(mutex_);
        used_bytes_ -= capacity;
        if (bytes && capacity == kBatchBytes && spare_.size() < kSpares) spare_.push_back(std::move(bytes));
        if (!waiting_.empty()) {
            next = std::move(waiting_.front());
            waiting_.pop_front();
        }
    }
    if (next) next();
}

}  // namespace brickyard

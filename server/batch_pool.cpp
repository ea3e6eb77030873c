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
    const std::size_t capacity = std::max(bytes, kBatchBytes);
    {
        const std::lock_guard lock(mutex_);
        if (!waiting_.empty() || !fits(capacity)) return {};
        used_bytes_ += capacity;
    }
    return allocate(capacity);
}

BatchMemory BatchPool::allocate(std::size_t capacity) {
    BatchMemory memory;
    memory.pool_ = this;
    memory.capacity_ = capacity;
    if (capacity == kBatchBytes) {
        const std::lock_guard lock(mutex_);
        if (!spare_.empty()) {
            memory.bytes_ = std::move(spare_.back());
            spare_.pop_back();
            return memory;
        }
    }
    try {
        memory.bytes_ = std::make_unique_for_overwrite<std::byte[]>(capacity);
    } catch (const std::bad_alloc&) {
        // The machine has less than the budget: as if that were used up.
        memory.capacity_ = 0;
        const std::lock_guard lock(mutex_);
        used_bytes_ -= capacity;
    }
    return memory;
}

void BatchPool::await(std::size_t bytes, std::function<void(BatchMemory)> granted) {
    {
        const std::lock_guard lock(mutex_);
        waiting_.push_back({std::max(bytes, kBatchBytes), std::move(granted)});
    }
    serveWaiting();
}

void BatchPool::serveWaiting() {
    for (;;) {
        Waiting next;
        {
            const std::lock_guard lock(mutex_);
            if (waiting_.empty() || !fits(waiting_.front().capacity)) return;
            next = std::move(waiting_.front());
            waiting_.pop_front();
            used_bytes_ += next.capacity;
        }
        next.granted(allocate(next.capacity));
    }
}

void BatchPool::forgetWaiting() {
    // Let go of without the lock: what they hold may hold memory of this pool.
    std::deque<Waiting> forgotten;
    {
        const std::lock_guard lock(mutex_);
        forgotten.swap(waiting_);
    }
}

std::uint64_t BatchPool::usedBytes() const {
    const std::lock_guard lock(mutex_);
    return used_bytes_;
}

void BatchPool::giveBack(std::unique_ptr<std::byte[]> bytes, std::size_t capacity) {
    {
        const std::lock_guard lock(mutex_);
        used_bytes_ -= capacity;
        if (bytes && capacity == kBatchBytes && spare_.size() < kSpares) spare_.push_back(std::move(bytes));
    }
    serveWaiting();
}

}  // namespace brickyard

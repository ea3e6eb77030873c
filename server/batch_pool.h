// Memory for what is on its way to clients, within one budget for all of them: DESIGN.md, "Everything from
// the network has a limit". Any thread.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <vector>

namespace brickyard {

// What one client gets at a time, unless a single message is longer.
inline constexpr std::size_t kBatchBytes = 128u << 10;

class BatchPool;

// A piece of the budget. Movable; gives itself back.
class BatchMemory {
public:
    BatchMemory() = default;
    BatchMemory(BatchMemory&& other) noexcept { *this = std::move(other); }
    BatchMemory& operator=(BatchMemory&& other) noexcept;
    ~BatchMemory() { reset(); }

    explicit operator bool() const { return bytes_ != nullptr; }
    std::byte* data() const { return bytes_.get(); }
    std::size_t capacity() const { return capacity_; }
    void reset();

private:
    friend class BatchPool;
    std::unique_ptr<std::byte[]> bytes_;
    std::size_t capacity_ = 0;
    BatchPool* pool_ = nullptr;
};

class BatchPool {
public:
    explicit BatchPool(std::uint64_t budget_bytes) : budget_bytes_(budget_bytes) {}

    // At least `bytes`, and at least kBatchBytes; empty where the budget is used up, or others wait for it.
    // What alone is more than the whole budget is given when nothing else is out.
    BatchMemory take(std::size_t bytes = kBatchBytes);
    // Calls `granted` with such memory when there is room for it, at once where there is now. Who waited
    // first is served first, so that small pieces do not starve a large one. The memory is empty only where
    // the machine has none. `granted` must only post, not act; where it does nothing, the next one is served.
    void await(std::size_t bytes, std::function<void(BatchMemory)> granted);
    // Nobody who waits is called any more.
    void forgetWaiting();

    std::uint64_t usedBytes() const;
    std::uint64_t budgetBytes() const { return budget_bytes_; }

private:
    friend class BatchMemory;
    struct Waiting {
        std::size_t capacity = 0;
        std::function<void(BatchMemory)> granted;
    };
    // REQUIRES: the mutex is held.
    bool fits(std::size_t capacity) const {
        return used_bytes_ == 0 || used_bytes_ + capacity <= budget_bytes_;
    }
    // REQUIRES: the capacity is counted as used.
    BatchMemory allocate(std::size_t capacity);
    void serveWaiting();
    void giveBack(std::unique_ptr<std::byte[]> bytes, std::size_t capacity);

    const std::uint64_t budget_bytes_;
    mutable std::mutex mutex_;
    std::uint64_t used_bytes_ = 0;  // Invariant: at most budget_bytes_, or one piece is out
    std::vector<std::unique_ptr<std::byte[]>> spare_;  // pieces of kBatchBytes: new ones cost page faults
    std::deque<Waiting> waiting_;
};

}  // namespace brickyard

#include "tools/worker_pool.h"

#include <algorithm>
#include <cassert>

namespace brickyard {

WorkerPool::WorkerPool(unsigned jobs) {
    const unsigned count = jobs > 0 ? jobs : std::max(1u, std::thread::hardware_concurrency());
    for (unsigned i = 1; i < count; ++i) threads_.emplace_back([this] { work(); });
}

WorkerPool::~WorkerPool() {
    {
        const std::lock_guard lock(mutex_);
        stop_ = true;
    }
    started_.notify_all();
    for (std::thread& thread : threads_) thread.join();
}

void WorkerPool::run(std::size_t n, const std::function<void(std::size_t)>& body) {
    std::unique_lock lock(mutex_);
    assert(body_ == nullptr && "loops do not nest");
    body_ = &body;
    next_ = 0;
    end_ = n;
    error_ = nullptr;
    if (n > 1) started_.notify_all();
    takeIndices(lock);
    finished_.wait(lock, [this] { return running_ == 0; });
    body_ = nullptr;
    if (error_) std::rethrow_exception(std::exchange(error_, nullptr));
}

void WorkerPool::work() {
    std::unique_lock lock(mutex_);
    for (;;) {
        started_.wait(lock, [this] { return stop_ || next_ < end_; });
        if (stop_) return;
        takeIndices(lock);
    }
}

// Bodies are bricks, tens of microseconds or more: a lock per index is not felt.
void WorkerPool::takeIndices(std::unique_lock<std::mutex>& lock) {
    while (next_ < end_) {
        const std::size_t i = next_++;
        const auto* body = body_;
        ++running_;
        lock.unlock();
        std::exception_ptr error;
        try {
            (*body)(i);
        } catch (...) {
            error = std::current_exception();
        }
        lock.lock();
        if (error && !error_) {
            error_ = error;
            next_ = end_;
        }
        if (--running_ == 0 && next_ >= end_) finished_.notify_all();
    }
}

}  // namespace brickyard

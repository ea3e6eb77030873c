// Threads for a ParallelFor: a loop's indices are handed out one by one to a fixed set of workers and to the
// caller.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include "core/octree_builder.h"

namespace brickyard {

class WorkerPool {
public:
    // `jobs` threads work on a loop, the calling one included; 0 means one per hardware thread.
    explicit WorkerPool(unsigned jobs);
    ~WorkerPool();
    WorkerPool(const WorkerPool&) = delete;
    WorkerPool& operator=(const WorkerPool&) = delete;

    unsigned jobs() const { return unsigned(threads_.size()) + 1; }
    // Calls body(i) for each i in [0, n); returns when all are done. The first exception ends the loop early
    // and is thrown here. One loop at a time, and none from inside another.
    void run(std::size_t n, const std::function<void(std::size_t)>& body);
    // The pool must outlive it.
    ParallelFor parallelFor() {
        return [this](std::size_t n, const std::function<void(std::size_t)>& body) { run(n, body); };
    }

private:
    void work();
    void takeIndices(std::unique_lock<std::mutex>& lock);

    std::mutex mutex_;
    std::condition_variable started_, finished_;
    std::vector<std::thread> threads_;
    bool stop_ = false;
    const std::function<void(std::size_t)>* body_ = nullptr;
    std::size_t next_ = 0, end_ = 0;  // indices not yet handed out
    std::size_t running_ = 0;         // bodies that have not returned
    std::exception_ptr error_;
};

}  // namespace brickyard

// Of the errors of a parallel loop, the one with the lowest index: the same message for any number of
// threads.
#pragma once

#include <cstdint>
#include <mutex>

#include "core/result.h"

namespace brickyard {

class FirstError {
public:
    // Any thread.
    void add(std::size_t index, Error error) {
        const std::lock_guard lock(mutex_);
        if (index < index_) index_ = index, error_ = std::move(error);
    }
    void add(std::size_t index, const Result<void>& result) {
        if (!result) add(index, result.error());
    }
    // After the loop.
    Result<void> result() {
        if (index_ == SIZE_MAX) return {};
        return tl::unexpected<Error>(std::move(error_));
    }

private:
    std::mutex mutex_;
    std::size_t index_ = SIZE_MAX;
    Error error_{};
};

}  // namespace brickyard

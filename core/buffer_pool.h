// Large arrays that pass from one piece of work to the next: fresh ones would be handed out by the system
// page by page, which takes as long as what is done with them. Any thread.
#pragma once

#include <cstddef>
#include <mutex>
#include <vector>

#include "core/field_source.h"

namespace brickyard {

class BufferPool {
public:
    // `size` doubles of any value.
    std::vector<double> takeDoubles(std::size_t size) {
        std::vector<double> buffer;
        {
            const std::lock_guard lock(mutex_);
            // Pieces of work of one kind take the same sizes: the smallest that is large enough.
            auto best = doubles_.end();
            for (auto it = doubles_.begin(); it != doubles_.end(); ++it)
                if (it->capacity() >= size && (best == doubles_.end() || it->capacity() < best->capacity()))
                    best = it;
            if (best != doubles_.end()) {
                buffer = std::move(*best);
                doubles_.erase(best);
            }
        }
        buffer.resize(size);
        return buffer;
    }
    void give(std::vector<double> buffer) {
        if (buffer.capacity() == 0) return;
        const std::lock_guard lock(mutex_);
        doubles_.push_back(std::move(buffer));
    }
    SampleBlock takeBlock() {
        const std::lock_guard lock(mutex_);
        if (blocks_.empty()) return {};
        SampleBlock block = std::move(blocks_.back());
        blocks_.pop_back();
        return block;
    }
    void give(SampleBlock block) {
        if (block.values.capacity() == 0) return;
        const std::lock_guard lock(mutex_);
        blocks_.push_back(std::move(block));
    }

private:
    std::mutex mutex_;
    std::vector<std::vector<double>> doubles_;
    std::vector<SampleBlock> blocks_;
};

}  // namespace brickyard

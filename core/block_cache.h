// Decoded tree blocks of frames that are being read, least recently used out first. Any thread.
#pragma once

#include <atomic>
#include <cstdint>
#include <list>
#include <memory>
#include <mutex>
#include <unordered_map>

#include "core/tree_block.h"

namespace brickyard {

struct BlockKey {
    std::uint64_t frame_id = 0;  // a number of its own for each open frame
    std::uint32_t channel = 0;
    std::uint32_t block = 0;
    bool operator==(const BlockKey&) const = default;
};

class BlockCache {
public:
    explicit BlockCache(std::uint64_t budget_bytes) : budget_bytes_(budget_bytes) {}

    // nullptr where it is not there.
    std::shared_ptr<const TreeBlock> find(const BlockKey& key);
    // A block larger than the whole budget is not kept.
    void insert(const BlockKey& key, std::shared_ptr<const TreeBlock> block);
    std::uint64_t usedBytes() const;
    // Since the cache was made.
    std::uint64_t hits() const { return hits_.load(std::memory_order_relaxed); }
    std::uint64_t misses() const { return misses_.load(std::memory_order_relaxed); }

private:
    struct KeyHash {
        std::size_t operator()(const BlockKey& key) const;
    };
    struct Entry {
        BlockKey key;
        std::shared_ptr<const TreeBlock> block;
        std::uint64_t bytes = 0;
    };

    const std::uint64_t budget_bytes_;
    std::atomic<std::uint64_t> hits_{0}, misses_{0};
    mutable std::mutex mutex_;
    std::uint64_t used_bytes_ = 0;  // Invariant: the sum of the entries' bytes, at most budget_bytes_
    std::list<Entry> entries_;      // most recently used first
    std::unordered_map<BlockKey, std::list<Entry>::iterator, KeyHash> index_;
};

}  // namespace brickyard

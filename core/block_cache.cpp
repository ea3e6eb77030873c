#include "core/block_cache.h"

#include "core/page_address.h"

namespace brickyard {

std::size_t BlockCache::KeyHash::operator()(const BlockKey& key) const {
    return PageAddressHash{}({key.channel, key.block, std::uint32_t(key.frame_id)});
}

std::shared_ptr<const TreeBlock> BlockCache::find(const BlockKey& key) {
    const std::lock_guard lock(mutex_);
    const auto found = index_.find(key);
    (found == index_.end() ? misses_ : hits_).fetch_add(1, std::memory_order_relaxed);
    if (found == index_.end()) return nullptr;
    entries_.splice(entries_.begin(), entries_, found->second);
    return found->second->block;
}

void BlockCache::insert(const BlockKey& key, std::shared_ptr<const TreeBlock> block) {
    const std::uint64_t bytes = block->memoryBytes();
    if (bytes > budget_bytes_) return;
    const std::lock_guard lock(mutex_);
    // Two threads may have missed the same block and decoded it twice; the first copy stays.
    if (index_.contains(key)) return;
    while (used_bytes_ + bytes > budget_bytes_) {
        used_bytes_ -= entries_.back().bytes;
        index_.erase(entries_.back().key);
        entries_.pop_back();
    }
    entries_.push_front({key, std::move(block), bytes});
    index_.emplace(key, entries_.begin());
    used_bytes_ += bytes;
}

std::uint64_t BlockCache::usedBytes() const {
    const std::lock_guard lock(mutex_);
    return used_bytes_;
}

}  // namespace brickyard

#include "client/page_cache.h"

#include <algorithm>
#include <cassert>

namespace brickyard {

PageCache::PageCache(std::uint64_t budget_bytes, std::size_t page_floats)
    : page_floats_(page_floats), capacity_(std::size_t(budget_bytes / (page_floats * sizeof(float)))) {}

const float* PageCache::find(const PageAddress& page) const {
    const auto found = index_.find(page);
    if (found == index_.end()) return nullptr;
    Slot& slot = *slots_[found->second];
    // Most finds of a pass are not the first of their page: they only read, so threads share the line. Of
    // those that race to be the first, one sees the old number, so that a hit is counted once.
    if (slot.last_used.load(std::memory_order_relaxed) < pass_) {
        const std::uint64_t before = slot.last_used.exchange(pass_, std::memory_order_relaxed);
        if (before < picture_begin_) hits_.fetch_add(1, std::memory_order_relaxed);
    }
    return slot.samples.get();
}

PageCacheCounters PageCache::counters() const {
    PageCacheCounters all = counters_;
    all.hits = hits_.load(std::memory_order_relaxed);
    return all;
}

std::vector<bool>::reference PageCache::evictedBit(const PageAddress& page) {
    std::vector<bool>& nodes =
        evicted_[std::uint64_t(page.channel) << 33 | std::uint64_t(page.draft) << 32 | page.block];
    if (nodes.size() <= page.node) nodes.resize(page.node + 1);
    return nodes[page.node];
}

float* PageCache::insert(const PageAddress& page) {
    assert(!contains(page));
    std::uint32_t at = 0;
    if (slots_.size() < capacity_) {
        at = std::uint32_t(slots_.size());
        slots_.push_back(std::make_unique<Slot>());
        slots_.back()->samples = std::make_unique<float[]>(page_floats_);
    } else {
        auto used = [&](std::uint32_t i) { return slots_[i]->last_used.load(std::memory_order_relaxed); };
        // What was inserted in this pass carries pass_ + 1 and is not a candidate.
        if (eviction_order_.empty()) {
            for (std::uint32_t i = 0; i < slots_.size(); ++i)
                if (!slots_[i]->pinned && used(i) <= pass_) eviction_order_.push_back(i);
            std::sort(eviction_order_.begin(), eviction_order_.end(), [&](std::uint32_t a, std::uint32_t b) {
                return used(a) != used(b) ? used(a) > used(b) : a > b;
            });
        }
        if (eviction_order_.empty()) return nullptr;
        at = eviction_order_.back();
        eviction_order_.pop_back();
        index_.erase(slots_[at]->page);
        evictedBit(slots_[at]->page) = true;
        ++counters_.evictions;
    }
    ++counters_.loads;
    if (counters_.evictions > 0 && evictedBit(page)) ++counters_.reloads;
    Slot& slot = *slots_[at];
    slot.page = page;
    slot.pinned = false;
    slot.last_used.store(pass_ + 1, std::memory_order_relaxed);
    index_.emplace(page, at);
    return slot.samples.get();
}

void PageCache::pin(const PageAddress& page) {
    Slot& slot = *slots_[index_.at(page)];
    if (slot.pinned || 2 * (pinned_ + 1) > capacity_) return;
    slot.pinned = true;
    ++pinned_;
    eviction_order_.clear();
}

}  // namespace brickyard

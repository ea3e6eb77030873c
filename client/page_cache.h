// Decoded bricks within a byte budget that is never exceeded. docs/page-cache.md.
//
// Slots have one size, allocated when first needed. During a pass the cache is read-only and find() may be
// called from any thread without a lock; a page found is marked as used in that pass. insert(), pin(),
// beginPass() and beginPicture() belong to one thread, between passes. Evicted first is the page whose last
// use by a ray is oldest.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <unordered_map>
#include <vector>

#include "core/page_address.h"

namespace brickyard {

// Since the cache was made; none of them falls.
struct PageCacheCounters {
    std::uint64_t hits = 0;       // resident when a picture began, and used in it; once a page and picture
    std::uint64_t loads = 0;      // inserted: what was a miss
    std::uint64_t evictions = 0;  // made way for another page
    std::uint64_t reloads = 0;    // loads of pages that had been evicted before
    PageCacheCounters operator-(const PageCacheCounters& before) const {
        return {hits - before.hits, loads - before.loads, evictions - before.evictions,
                reloads - before.reloads};
    }
    // Hits of all pages that were needed; 1 where none was.
    double hitRate() const { return hits + loads == 0 ? 1 : double(hits) / double(hits + loads); }
};

class PageCache {
public:
    // `page_floats` floats a page. REQUIRES: page_floats > 0. A budget below one page holds none: see
    // capacity().
    PageCache(std::uint64_t budget_bytes, std::size_t page_floats);

    std::size_t capacity() const { return capacity_; }  // pages
    std::size_t size() const { return index_.size(); }
    std::uint64_t pageBytes() const { return page_floats_ * sizeof(float); }
    // Most bytes ever held.
    std::uint64_t peakBytes() const { return slots_.size() * pageBytes(); }
    // Exact between passes.
    PageCacheCounters counters() const;

    // The page's samples, or nullptr. Valid until the next insert().
    const float* find(const PageAddress& page) const;
    bool contains(const PageAddress& page) const { return index_.contains(page); }
    // Resident, and found by a ray or inserted since beginPicture().
    bool usedInPicture(const PageAddress& page) const {
        const auto found = index_.find(page);
        return found != index_.end() &&
               slots_[found->second]->last_used.load(std::memory_order_relaxed) >= picture_begin_;
    }

    // Later finds of what is resident now are hits.
    void beginPicture() {
        // Pages that arrived last carry pass_ + 1.
        pass_ += 2;
        picture_begin_ = pass_;
        eviction_order_.clear();
    }
    // Later finds count as used in a new pass.
    void beginPass() {
        ++pass_;
        eviction_order_.clear();
    }
    // Pages that an insert could take the place of, plus free ones.
    std::size_t room() const { return capacity_ - pinned_; }
    // Makes room by evicting, then gives the slot to fill; nullptr where every slot is pinned or was inserted
    // since beginPass(). REQUIRES: !contains(page).
    float* insert(const PageAddress& page);
    // Keeps a page for good. REQUIRES: contains(page). Does nothing once half the slots are pinned.
    void pin(const PageAddress& page);

private:
    // The bit of a page in evicted_.
    std::vector<bool>::reference evictedBit(const PageAddress& page);
    struct Slot {
        std::unique_ptr<float[]> samples;
        PageAddress page;
        std::atomic<std::uint64_t> last_used{0};
        bool pinned = false;
    };
    std::size_t page_floats_;
    std::size_t capacity_;
    std::size_t pinned_ = 0;
    std::uint64_t pass_ = 1;
    std::uint64_t picture_begin_ = 1;  // its first pass
    PageCacheCounters counters_;       // but the hits
    std::vector<std::unique_ptr<Slot>> slots_;
    std::unordered_map<PageAddress, std::uint32_t, PageAddressHash> index_;
    std::vector<std::uint32_t> eviction_order_;  // candidates, oldest last; made anew when used up
    // Which pages have ever been evicted: a bit a node of the tree blocks whose pages were.
    std::unordered_map<std::uint64_t, std::vector<bool>> evicted_;
    // Written on the rays' path, though only by the first find of a page in a picture: on a line of its own.
    alignas(64) mutable std::atomic<std::uint64_t> hits_{0};
};

}  // namespace brickyard

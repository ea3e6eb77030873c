// Decoded bricks within a byte budget that is never exceeded. docs/design.md, section "Page cache".
//
// Slots have one size, allocated when first needed. During a pass the cache is read-only and find() may be
// called from any thread without a lock; a page found is marked as used in that pass. insert(), pin() and
// beginPass() belong to one thread, between passes. Evicted first is the page whose last use by a ray is
// oldest.
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
    std::uint64_t evictions() const { return evictions_; }
    // Pages that were inserted after having been evicted before.
    std::uint64_t reloads() const { return reloads_; }

    // The page's samples, or nullptr. Valid until the next insert().
    const float* find(const PageAddress& page) const;
    bool contains(const PageAddress& page) const { return index_.contains(page); }

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
    std::uint64_t evictions_ = 0, reloads_ = 0;
    std::vector<std::unique_ptr<Slot>> slots_;
    std::unordered_map<PageAddress, std::uint32_t, PageAddressHash> index_;
    std::unordered_map<PageAddress, bool, PageAddressHash> evicted_;
    std::vector<std::uint32_t> eviction_order_;  // candidates, oldest last; made anew when used up
};

}  // namespace brickyard

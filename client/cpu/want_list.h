// What the rays of a pass missed: pages and tree blocks with their worth. One list per thread, merged between
// passes. Not thread-safe.
#pragma once

#include <cstdint>
#include <unordered_map>

#include "core/page_address.h"

namespace brickyard {

struct WantedPage {
    bool is_block = false;
    PageAddress address;
    bool operator==(const WantedPage&) const = default;
};

struct WantedPageHash {
    std::size_t operator()(const WantedPage& w) const {
        return PageAddressHash()(w.address) * 2 + w.is_block;
    }
};

struct Want {
    std::uint32_t bytes = 0;  // stored
    double worth = 0;         // expected picture error it removes, summed over rays; compared per byte
    std::uint32_t tile = 0;   // first tile that wants it
};

class WantList {
public:
    void add(const WantedPage& page, std::uint32_t bytes, double worth, std::uint32_t tile) {
        Want& want = wants_.try_emplace(page, Want{bytes, 0, tile}).first->second;
        want.worth += worth;
        want.tile = want.tile < tile ? want.tile : tile;
    }
    void merge(const WantList& other) {
        for (const auto& [page, want] : other.wants_) add(page, want.bytes, want.worth, want.tile);
    }
    void clear() { wants_.clear(); }
    bool empty() const { return wants_.empty(); }
    std::size_t size() const { return wants_.size(); }
    const std::unordered_map<WantedPage, Want, WantedPageHash>& all() const { return wants_; }

private:
    std::unordered_map<WantedPage, Want, WantedPageHash> wants_;
};

}  // namespace brickyard

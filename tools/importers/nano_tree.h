// The topology of a NanoVDB tree as it was checked: where each leaf is, and all tiles. Only nano_source.cpp
// includes this. `Bits` is one value, all components, compared bit for bit.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <vector>

#include "core/index_box.h"

namespace brickyard {

// 2^(3 * kLog2Slots) slots, x slowest, each 2^kLog2Child voxels an edge.
template <int kSlots, int kChild, class Bits>
struct NanoNode {
    static constexpr int kLog2Slots = kSlots, kLog2Child = kChild;
    static constexpr std::size_t kWords = std::size_t(1) << (3 * kSlots - 6);

    std::array<std::uint64_t, kWords> child_mask{}, value_mask{};
    std::array<std::uint16_t, kWords> rank{};  // children in front of each word
    std::uint64_t first_child = 0;             // children stand together, in the order of their slots
    struct Tile {
        std::uint32_t slot;
        Bits value;
    };
    std::vector<Tile> tiles;  // by slot; those that are not listed have the background's value

    bool hasChild(std::uint32_t slot) const { return child_mask[slot >> 6] >> (slot & 63) & 1; }
    bool isActive(std::uint32_t slot) const { return value_mask[slot >> 6] >> (slot & 63) & 1; }
    std::uint64_t childOf(std::uint32_t slot) const {
        const std::uint64_t before = child_mask[slot >> 6] & ((std::uint64_t(1) << (slot & 63)) - 1);
        return first_child + rank[slot >> 6] + std::uint64_t(std::popcount(before));
    }
    Bits valueOf(std::uint32_t slot, const Bits& background) const {
        const auto at = std::ranges::lower_bound(tiles, slot, {}, &Tile::slot);
        return at == tiles.end() || at->slot != slot ? background : at->value;
    }
    std::uint64_t countChildren() {
        std::uint64_t count = 0;
        for (std::size_t w = 0; w < kWords; ++w) {
            rank[w] = std::uint16_t(count);
            count += std::uint64_t(std::popcount(child_mask[w]));
        }
        return count;
    }

    // Calls visit(slot, box of the slot within `box`) for each slot that the box touches, until one gives
    // false.
    template <class Visit>
    static bool visitSlots(const Index3& origin, const IndexBox& box, const Visit& visit) {
        Index3 first, last;
        for (std::size_t a = 0; a < 3; ++a) {
            first[a] = std::max<std::int64_t>(0, box.begin[a] - origin[a]) >> kChild;
            last[a] = std::min<std::int64_t>((std::int64_t(1) << (kSlots + kChild)) - 1,
                                             box.end[a] - 1 - origin[a]) >>
                      kChild;
        }
        for (std::int64_t x = first[0]; x <= last[0]; ++x)
            for (std::int64_t y = first[1]; y <= last[1]; ++y)
                for (std::int64_t z = first[2]; z <= last[2]; ++z) {
                    const Index3 corner{origin[0] + (x << kChild), origin[1] + (y << kChild),
                                        origin[2] + (z << kChild)};
                    constexpr std::int64_t kEdge = std::int64_t(1) << kChild;
                    const auto slot = std::uint32_t((x << 2 * kSlots) | (y << kSlots) | z);
                    if (!visit(slot, corner,
                               intersect(
                                   box, {corner, {corner[0] + kEdge, corner[1] + kEdge, corner[2] + kEdge}})))
                        return false;
                }
        return true;
    }
    // Where a slot begins.
    static Index3 cornerOf(const Index3& origin, std::uint32_t slot) {
        constexpr std::uint32_t kMask = (1u << kSlots) - 1;
        return {origin[0] + (std::int64_t(slot >> 2 * kSlots) << kChild),
                origin[1] + (std::int64_t(slot >> kSlots & kMask) << kChild),
                origin[2] + (std::int64_t(slot & kMask) << kChild)};
    }
};

template <class Bits>
struct NanoTree {
    using Lower = NanoNode<4, 3, Bits>;
    using Upper = NanoNode<5, 7, Bits>;
    static constexpr std::int64_t kRootEdge = 4096;
    static constexpr std::uint64_t kNoNode = ~std::uint64_t(0);
    struct RootEntry {
        Index3 origin;
        std::uint64_t upper;  // kNoNode: a tile
        Bits value;
        bool active;
    };

    Bits background{};
    std::vector<RootEntry> roots;  // by origin, each once
    std::vector<Upper> uppers;
    std::vector<Lower> lowers;
    std::vector<std::uint64_t>
        leaves;  // offset in the grid, a multiple of 32, plus what its low bits say of its size

    std::uint64_t bytes() const {
        return roots.size() * sizeof(RootEntry) + uppers.size() * sizeof(Upper) +
               lowers.size() * sizeof(Lower) + leaves.size() * 8 + tile_bytes;
    }
    std::uint64_t tile_bytes = 0;
};

}  // namespace brickyard

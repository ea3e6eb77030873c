// Walking a VdbTree: the templates of vdb_tree.h, which includes this.
#pragma once

#include <algorithm>
#include <bit>

#include "tools/importers/vdb_tree.h"

namespace brickyard {

template <int kLog2Slots>
std::uint32_t VdbTree::ChildMasks<kLog2Slots>::rank(std::uint32_t node, std::uint32_t slot) const {
    const std::size_t word = node * kWords + slot / 64;
    const std::uint64_t below = bits[word] & ((std::uint64_t(1) << slot % 64) - 1);
    return before[word] + std::uint32_t(std::popcount(below));
}

template <class Body>
void VdbTree::runsOver(const Node& node, std::uint32_t first, std::uint32_t last, Body&& body) const {
    const auto runs = std::span(runs_).subspan(node.first_run, node.runs);
    auto run = std::upper_bound(runs.begin(), runs.end(), first,
                                [](std::uint32_t slot, const Run& r) { return slot < r.slot; }) -
               1;
    for (std::uint32_t from = first; from <= last; ++run) {
        const std::uint32_t next =
            run + 1 == runs.end() ? last + 1 : std::min<std::uint32_t>(run[1].slot, last + 1);
        body(*run, from, next - 1);
        from = next;
    }
}

template <class Body>
bool VdbTree::rootEntries(const IndexBox& box, bool each_gap, Body&& body) const {
    Index3 first, last;
    double positions = 1;  // at most 2^60: compared, not counted on
    for (std::size_t a = 0; a < 3; ++a) {
        first[a] = box.begin[a] >> kUpperLog2;
        last[a] = (box.end[a] - 1) >> kUpperLog2;
        positions *= double(last[a] - first[a] + 1);
    }
    if (!each_gap && positions > double(root_.size())) {
        double present = 0;
        for (const RootEntry& entry : root_) {
            const Index3 origin{entry.origin[0], entry.origin[1], entry.origin[2]};
            if (intersect(box, regionOf(origin, kUpperLog2)).empty()) continue;
            present += 1;
            if (!body(origin, &entry)) return false;
        }
        return present == positions || body(Index3{}, nullptr);
    }
    bool gap_told = false;
    for (std::int64_t x = first[0]; x <= last[0]; ++x)
        for (std::int64_t y = first[1]; y <= last[1]; ++y)
            for (std::int64_t z = first[2]; z <= last[2]; ++z) {
                const Index3 origin{x << kUpperLog2, y << kUpperLog2, z << kUpperLog2};
                const std::array<std::int32_t, 3> key{std::int32_t(origin[0]), std::int32_t(origin[1]),
                                                      std::int32_t(origin[2])};
                const auto at = std::ranges::lower_bound(root_, key, {}, &RootEntry::origin);
                const bool there = at != root_.end() && at->origin == key;
                if (!there && !each_gap && gap_told) continue;
                gap_told = gap_told || !there;
                if (!body(origin, there ? &*at : nullptr)) return false;
            }
    return true;
}

// Tells the tiles of a node that `part` touches, those first that leaves or lower nodes then overwrite.
template <int kLog2Slots, class Tile>
void VdbTree::visitTiles(const Node& node, const ChildMasks<kLog2Slots>& masks, const Index3& origin,
                         const IndexBox& part, Tile&& tile) const {
    const int log2_child = kLog2Slots == kUpperSlotsLog2 ? kLowerLog2 : kLeafLog2;
    const SlotRange slots = slotsOf(origin, part, log2_child);
    const std::uint32_t count_z = slots.last[2] - slots.first[2] + 1;
    if (node.runs == 0) {
        // Background all over, unless children fill the part anyway.
        std::uint64_t children = 0;
        if (node.children != kNone)
            for (std::uint32_t x = slots.first[0]; x <= slots.last[0]; ++x)
                for (std::uint32_t y = slots.first[1]; y <= slots.last[1]; ++y)
                    children += std::uint64_t(std::popcount(
                        masks.row(node.children, (x << 2 * kLog2Slots) | (y << kLog2Slots) | slots.first[2],
                                  int(count_z))));
        if (children != slots.count()) tile(part, tileOf(0, false));
        return;
    }
    for (std::uint32_t x = slots.first[0]; x <= slots.last[0]; ++x)
        for (std::uint32_t y = slots.first[1]; y <= slots.last[1]; ++y) {
            const std::uint32_t row = (x << 2 * kLog2Slots) | (y << kLog2Slots);
            const auto row_slots = std::uint32_t(row + slots.first[2]);
            if (node.children != kNone &&
                masks.row(node.children, row_slots, int(count_z)) == (std::uint64_t(1) << count_z) - 1)
                continue;
            runsOver(node, row_slots, row + slots.last[2],
                     [&](const Run& run, std::uint32_t from, std::uint32_t last) {
                         const std::int64_t edge = std::int64_t(1) << log2_child;
                         const Index3 begin{origin[0] + x * edge, origin[1] + y * edge,
                                            origin[2] + (from - row) * edge};
                         const Index3 end{begin[0] + edge, begin[1] + edge,
                                          origin[2] + (last - row + 1) * edge};
                         tile(intersect(part, {begin, end}), tileOf(run.value, run.active));
                     });
        }
}

template <class Tile, class Leaf>
void VdbTree::visit(const IndexBox& box, Tile&& tile, Leaf&& leaf) const {
    // Calls body(slot, origin, part) for the children that `part` touches.
    const auto children = [](const Node& node, const auto& masks, auto log2_slots, int log2_child,
                             const Index3& origin, const IndexBox& part, auto&& body) {
        if (node.children == kNone) return;
        constexpr int kLog2Slots = decltype(log2_slots)::value;
        const SlotRange slots = slotsOf(origin, part, log2_child);
        for (std::uint32_t x = slots.first[0]; x <= slots.last[0]; ++x)
            for (std::uint32_t y = slots.first[1]; y <= slots.last[1]; ++y) {
                const std::uint32_t row = (x << 2 * kLog2Slots) | (y << kLog2Slots);
                std::uint64_t bits =
                    masks.row(node.children, row + slots.first[2], int(slots.last[2] - slots.first[2] + 1));
                for (; bits != 0; bits &= bits - 1) {
                    const std::uint32_t z = slots.first[2] + std::uint32_t(std::countr_zero(bits));
                    const std::int64_t edge = std::int64_t(1) << log2_child;
                    const Index3 at{origin[0] + x * edge, origin[1] + y * edge, origin[2] + z * edge};
                    body(row + z, at, intersect(part, regionOf(at, log2_child)));
                }
            }
    };
    rootEntries(box, /*each_gap=*/true, [&](const Index3& origin, const RootEntry* entry) {
        const IndexBox part = intersect(box, regionOf(origin, kUpperLog2));
        if (!entry || entry->upper == kNone) {
            tile(part, entry ? tileOf(entry->value, entry->active) : tileOf(0, false));
            return true;
        }
        const Node& upper = uppers_[entry->upper];
        visitTiles<kUpperSlotsLog2>(upper, upper_masks_, origin, part, tile);
        children(upper, upper_masks_, std::integral_constant<int, kUpperSlotsLog2>(), kLowerLog2, origin,
                 part, [&](std::uint32_t slot, const Index3& lower_origin, const IndexBox& lower_part) {
                     const Node& lower = lowers_[upper.first_child + upper_masks_.rank(upper.children, slot)];
                     visitTiles<kLowerSlotsLog2>(lower, lower_masks_, lower_origin, lower_part, tile);
                     children(
                         lower, lower_masks_, std::integral_constant<int, kLowerSlotsLog2>(), kLeafLog2,
                         lower_origin, lower_part,
                         [&](std::uint32_t leaf_slot, const Index3& leaf_origin, const IndexBox& leaf_part) {
                             leaf(leaf_part, leafPlace(lower, leaf_slot, leaf_origin));
                         });
                 });
        return true;
    });
}

}  // namespace brickyard

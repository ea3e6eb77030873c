#include "tools/importers/vdb_tree.h"

#include <algorithm>
#include <bit>
#include <cstring>

namespace brickyard {

// The value and state that all tiles so far had.
struct VdbTree::Uniformity {
    std::size_t value_bytes;
    const std::byte* value = nullptr;
    bool active = false;

    // False once two differ, in a single bit or in state.
    bool add(const VdbTile& tile) {
        if (!value) {
            value = tile.value;
            active = tile.active;
            return true;
        }
        return active == tile.active &&
               (value == tile.value || std::memcmp(value, tile.value, value_bytes) == 0);
    }
};

template <int kLog2Slots>
std::uint32_t VdbTree::ChildMasks<kLog2Slots>::add(std::span<const std::uint64_t> mask) {
    const std::size_t node = bits.size() / kWords;
    std::size_t count = 0;
    for (const std::uint64_t word : mask) {
        bits.push_back(word);
        before.push_back(std::uint16_t(count));
        count += std::size_t(std::popcount(word));
    }
    return std::uint32_t(node);
}
template struct VdbTree::ChildMasks<VdbTree::kUpperSlotsLog2>;
template struct VdbTree::ChildMasks<VdbTree::kLowerSlotsLog2>;

std::uint64_t VdbTree::memoryBytes() const {
    const auto bytesOf = [](const auto& items) { return std::uint64_t(items.capacity()) * sizeof(items[0]); };
    return bytesOf(root_) + bytesOf(uppers_) + bytesOf(lowers_) + bytesOf(upper_masks_.bits) +
           bytesOf(upper_masks_.before) + bytesOf(lower_masks_.bits) + bytesOf(lower_masks_.before) +
           bytesOf(runs_) + bytesOf(values_) + bytesOf(leaf_ends_);
}

VdbTree::SlotRange VdbTree::slotsOf(const Index3& origin, const IndexBox& part, int log2_child) {
    SlotRange range;
    for (std::size_t a = 0; a < 3; ++a) {
        range.first[a] = std::uint32_t((part.begin[a] - origin[a]) >> log2_child);
        range.last[a] = std::uint32_t((part.end[a] - 1 - origin[a]) >> log2_child);
    }
    return range;
}

VdbLeafPlace VdbTree::leafPlace(const Node& lower, std::uint32_t slot, const Index3& origin) const {
    const std::uint32_t rank = lower_masks_.rank(lower.children, slot), number = lower.first_child + rank;
    const std::uint32_t begin = rank == 0 ? 0 : leaf_ends_[number - 1];
    return {origin, number, leaf_ends_[number] - begin, lower.leaves_begin + begin};
}

// False where the tiles among `slots` differ from each other or from what was found before.
template <int kLog2Slots>
bool VdbTree::addTiles(Uniformity& found, const Node& node, const ChildMasks<kLog2Slots>& masks,
                       const SlotRange& slots) const {
    bool any_tile = node.children == kNone;
    const std::uint32_t count_z = slots.last[2] - slots.first[2] + 1;
    for (std::uint32_t x = slots.first[0]; x <= slots.last[0]; ++x)
        for (std::uint32_t y = slots.first[1]; y <= slots.last[1]; ++y) {
            const std::uint32_t row = (x << 2 * kLog2Slots) | (y << kLog2Slots), first = row + slots.first[2];
            const std::uint64_t children =
                node.children == kNone ? 0 : masks.row(node.children, first, int(count_z));
            const std::uint64_t tiles = ~children & ((std::uint64_t(1) << count_z) - 1);
            if (tiles == 0) continue;
            any_tile = true;
            if (node.runs == 0) break;  // one tile is as good as all
            bool same = true;
            runsOver(node, first, row + slots.last[2],
                     [&](const Run& run, std::uint32_t from, std::uint32_t last) {
                         const std::uint64_t covered = (std::uint64_t(1) << (last - from + 1)) - 1;
                         if ((tiles >> (from - first) & covered) != 0)
                             same = same && found.add(tileOf(run.value, run.active));
                     });
            if (!same) return false;
        }
    return node.runs != 0 || !any_tile || found.add(tileOf(0, false));
}

bool VdbTree::addLower(Uniformity& found, const Node& lower, const Index3& origin,
                       const IndexBox& part) const {
    const SlotRange slots = slotsOf(origin, part, kLeafLog2);
    if (lower.children != kNone)
        for (std::uint32_t x = slots.first[0]; x <= slots.last[0]; ++x)
            for (std::uint32_t y = slots.first[1]; y <= slots.last[1]; ++y)
                if (lower_masks_.row(lower.children,
                                     (x << 2 * kLowerSlotsLog2) | (y << kLowerSlotsLog2) | slots.first[2],
                                     int(slots.last[2] - slots.first[2] + 1)) != 0)
                    return false;
    return addTiles<kLowerSlotsLog2>(found, lower, lower_masks_, slots);
}

bool VdbTree::addNode(Uniformity& found, const Node& upper, const Index3& origin,
                      const IndexBox& part) const {
    const SlotRange slots = slotsOf(origin, part, kLowerLog2);
    if (!addTiles<kUpperSlotsLog2>(found, upper, upper_masks_, slots)) return false;
    if (upper.children == kNone) return true;
    for (std::uint32_t x = slots.first[0]; x <= slots.last[0]; ++x)
        for (std::uint32_t y = slots.first[1]; y <= slots.last[1]; ++y) {
            const std::uint32_t row = (x << 2 * kUpperSlotsLog2) | (y << kUpperSlotsLog2);
            std::uint64_t bits = upper_masks_.row(upper.children, row + slots.first[2],
                                                  int(slots.last[2] - slots.first[2] + 1));
            for (; bits != 0; bits &= bits - 1) {
                const std::uint32_t z = slots.first[2] + std::uint32_t(std::countr_zero(bits));
                const Node& lower = lowers_[upper.first_child + upper_masks_.rank(upper.children, row + z)];
                const std::int64_t edge = std::int64_t(1) << kLowerLog2;
                const Index3 at{origin[0] + x * edge, origin[1] + y * edge, origin[2] + z * edge};
                if (!addLower(found, lower, at, intersect(part, regionOf(at, kLowerLog2)))) return false;
            }
        }
    return true;
}

std::optional<VdbTile> VdbTree::uniformOver(const IndexBox& box) const {
    Uniformity found{coding_.type.bytes()};
    const bool uniform =
        rootEntries(box, /*each_gap=*/false, [&](const Index3& origin, const RootEntry* entry) {
            if (!entry) return found.add(tileOf(0, false));
            if (entry->upper == kNone) return found.add(tileOf(entry->value, entry->active));
            return addNode(found, uppers_[entry->upper], origin,
                           intersect(box, regionOf(origin, kUpperLog2)));
        });
    if (!uniform) return std::nullopt;
    return VdbTile{found.value, found.active};
}

}  // namespace brickyard

// Where everything is in one grid's tree of a .vdb file: tiles with their values, leaves as places in the
// file.
//
// A tree has a root table, nodes of 32^3 slots of 128^3 voxels ("upper"), nodes of 16^3 slots of 8^3
// ("lower") and leaves of 8^3 (openvdb/tree/*.h: the configuration 5, 4, 3). The file has the topology first,
// depth first, then the leaves' values in the same order, so that one pass over the grid's bytes finds every
// leaf. In memory a leaf costs 4 bytes, a lower node that has leaves about 700 and an upper one 5 KiB.
// Immutable once built, any thread.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/index_box.h"
#include "core/result.h"
#include "tools/importers/vdb_bytes.h"
#include "tools/importers/vdb_values.h"

namespace brickyard {

// A leaf's record in the file: 64 bytes of mask, then its values.
struct VdbLeafPlace {
    Index3 origin{};
    std::uint32_t number = 0;  // of the grid's leaves, in the file's order
    std::uint32_t bytes = 0;
    std::uint64_t begin = 0;
};

// What a box of positions holds where no leaf is.
struct VdbTile {
    const std::byte* value;  // coding().type.bytes() of them
    bool active;
};

class VdbTree {
public:
    static constexpr int kLeafLog2 = 3, kLowerLog2 = 7, kUpperLog2 = 12;  // edges in voxels

    // Passes over the tree that begins at `begin`; it must end by `end`. `where` begins messages ("a.vdb:
    // grid 'density'"). Takes memory in proportion to the bytes passed. Errors: kIo; kCorrupt; kUnsupported
    // (more tiles of values of their own than the file's size accounts for).
    static Result<VdbTree> build(const VdbBytes& file, std::uint64_t begin, std::uint64_t end,
                                 VdbCoding coding, const std::string& where);

    // As given, with the grid's background.
    const VdbCoding& coding() const { return coding_; }
    std::uint64_t end() const { return end_; }
    std::uint64_t leafCount() const { return leaf_ends_.size(); }
    std::uint64_t memoryBytes() const;

    // Active voxels and their tight box, tiles included.
    std::uint64_t activeVoxels() const { return active_voxels_; }
    const IndexBox& activeBox() const { return active_box_; }

    // The one tile value that all of `box` has; nothing where values differ or a leaf reaches into it.
    // REQUIRES: box not empty and inside int32.
    std::optional<VdbTile> uniformOver(const IndexBox& box) const;

    // Calls tile(part, VdbTile) and leaf(part, VdbLeafPlace) so that in the end every position of `box` has
    // been told last what it is: a tile may be told for more than it covers, and before the leaves in it.
    // Leaves come in the file's order, so long as one root entry is concerned. REQUIRES: as uniformOver.
    template <class Tile, class Leaf>
    void visit(const IndexBox& box, Tile&& tile, Leaf&& leaf) const;

private:
    friend class VdbTreeBuilder;

    static constexpr std::uint32_t kNone = ~std::uint32_t(0);

    // From this slot on, up to the next run. Slots that have a child count to any run.
    struct Run {
        std::uint16_t slot;
        bool active;
        std::uint32_t value;  // in values_, of which the first is the background
    };
    struct Node {
        std::uint32_t first_run = 0;
        std::uint32_t runs = 0;          // none: inactive background everywhere
        std::uint32_t children = kNone;  // number of its mask; kNone where it has no child
        std::uint32_t first_child = 0;   // the others follow in the order of their slots
        std::uint64_t leaves_begin = 0;  // of a lower node, in the file
    };
    struct RootEntry {
        std::array<std::int32_t, 3> origin{};
        std::uint32_t upper = kNone;  // else a tile
        std::uint32_t value = 0;
        bool active = false;
    };
    // Child masks of one level: `words` of 64 bits per node, and how many bits are set before each word.
    template <int kLog2Slots>
    struct ChildMasks {
        static constexpr std::size_t kWords = (std::size_t(1) << 3 * kLog2Slots) / 64;
        std::vector<std::uint64_t> bits;
        std::vector<std::uint16_t> before;

        std::uint32_t add(std::span<const std::uint64_t> mask);
        bool has(std::uint32_t node, std::uint32_t slot) const {
            return bits[node * kWords + slot / 64] >> slot % 64 & 1;
        }
        // `count` bits from `slot` on, all in one word: rows along z never straddle one.
        std::uint64_t row(std::uint32_t node, std::uint32_t slot, int count) const {
            return bits[node * kWords + slot / 64] >> slot % 64 & ((std::uint64_t(1) << count) - 1);
        }
        std::uint32_t rank(std::uint32_t node, std::uint32_t slot) const;
    };
    static constexpr int kUpperSlotsLog2 = 5, kLowerSlotsLog2 = 4;

    VdbTile tileOf(std::uint32_t value, bool active) const {
        return {values_.data() + std::size_t(value) * coding_.type.bytes(), active};
    }
    VdbLeafPlace leafPlace(const Node& lower, std::uint32_t slot, const Index3& origin) const;

    // Slots [first, last] per axis of a node of edge 2^kLog2Slots slots of 2^kLog2Child voxels that `box`
    // touches.
    struct SlotRange {
        std::array<std::uint32_t, 3> first, last;
        std::uint64_t count() const {
            return std::uint64_t(last[0] - first[0] + 1) * (last[1] - first[1] + 1) *
                   (last[2] - first[2] + 1);
        }
    };
    static SlotRange slotsOf(const Index3& origin, const IndexBox& part, int log2_child);
    static IndexBox regionOf(const Index3& origin, int log2_edge) {
        const std::int64_t edge = std::int64_t(1) << log2_edge;
        return {origin, {origin[0] + edge, origin[1] + edge, origin[2] + edge}};
    }

    // Calls body(run, first slot, last slot) for the pieces of runs in slots [first, last].
    template <class Body>
    void runsOver(const Node& node, std::uint32_t first, std::uint32_t last, Body&& body) const;

    // Calls body(origin, nullptr or the entry there) for root positions that `box` touches; false ends it.
    // Positions without an entry are told once, as nullptr, with any origin, where `each_gap` is false.
    template <class Body>
    bool rootEntries(const IndexBox& box, bool each_gap, Body&& body) const;

    template <int kLog2Slots, class Tile>
    void visitTiles(const Node& node, const ChildMasks<kLog2Slots>& masks, const Index3& origin,
                    const IndexBox& part, Tile&& tile) const;

    struct Uniformity;
    bool addNode(Uniformity& found, const Node& upper, const Index3& origin, const IndexBox& part) const;
    bool addLower(Uniformity& found, const Node& lower, const Index3& origin, const IndexBox& part) const;
    template <int kLog2Slots>
    bool addTiles(Uniformity& found, const Node& node, const ChildMasks<kLog2Slots>& masks,
                  const SlotRange& slots) const;

    VdbCoding coding_;
    std::uint64_t end_ = 0;
    std::vector<RootEntry> root_;  // by origin, x first
    std::vector<Node> uppers_, lowers_;
    ChildMasks<kUpperSlotsLog2> upper_masks_;
    ChildMasks<kLowerSlotsLog2> lower_masks_;
    std::vector<Run> runs_;
    std::vector<std::byte> values_;
    std::vector<std::uint32_t> leaf_ends_;  // of each leaf's record, from its lower node's leaves_begin
    std::uint64_t active_voxels_ = 0;
    IndexBox active_box_;
};

}  // namespace brickyard

#include "tools/importers/vdb_tree_visit.h"

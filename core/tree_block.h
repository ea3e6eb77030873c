// Octree topology in memory: one decoded tree block. After Laine and Karras, Efficient Sparse Voxel Octrees,
// 2010: a 32-bit child descriptor per inner node (child pointer 15 bits, far flag, valid mask, leaf mask),
// children of one parent stored together, far pointers through a table, the tree cut into blocks that are
// paged like bricks. Bytes: docs/format.md, section "Tree block". Immutable once decoded: any thread.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "core/result.h"
#include "core/sample_type.h"

namespace brickyard {

// Sub-boxes per axis of a node's error grids.
inline constexpr int kErrorGridEdge = 4;
inline constexpr int kErrorGridCells = kErrorGridEdge * kErrorGridEdge * kErrorGridEdge;

// Deviation of a node's field from level 0, per sub-box of (N / 4)^3 of its cells, x fastest. A byte each:
// 0 is zero; c > 0 is scale * 2^((c - 255) / 8), rounded up, where scale is the node's strict bound.
struct ErrorGrid {
    std::array<std::uint8_t, kErrorGridCells> bound{};
    std::array<std::uint8_t, kErrorGridCells> rms{};
};
float errorFromCode(std::uint8_t code, float scale);
// The least code whose error is not below `error`. REQUIRES: error <= scale.
std::uint8_t errorToCode(double error, float scale);

// What is known of a node without its brick. Deviations are of the node's decoded field from the source's
// level 0, in the channel's unit; for vectors, of the component that deviates most.
struct NodeRecord {
    std::uint64_t payload_offset = 0;    // in the frame file
    std::uint32_t payload_bytes = 0;     // 0: one value everywhere, kept in the block; no brick
    std::uint64_t payload_checksum = 0;  // XXH64, seed 0
    float value_min = 0,
          value_max = 0;  // over the node's samples and those of everything below it; rounded outwards
    float bound = 0;      // largest deviation anywhere in the node's closed region; rounded up
    float rms = 0;        // root mean square of the deviation over the level-0 samples it owns
    // Tight box of the cells that hold anything but background, in cells of this node, [begin, end) in [0,
    // N].
    std::array<std::uint8_t, 3> box_begin{}, box_end{};
    bool active = false;  // state of every voxel of a leaf that stores no states: a node of one value, or a
                          // leaf above level 0
    std::uint32_t constant = 0;  // index of its value in the block's table; only if payload_bytes == 0
    // Prefix of the payload that decodes alone to an approximation; 0: none. Only leaves have drafts.
    std::uint32_t draft_bytes = 0;
    std::uint64_t draft_checksum = 0;  // XXH64 of that prefix, seed 0
    float draft_bound = 0;             // largest deviation of the draft from level 0; rounded up
    float draft_rms = 0;               // as `rms`, of the draft
    std::int32_t grid = -1;            // index of its error grid; -1: `bound` and `rms` hold everywhere

    bool hasBrick() const { return payload_bytes > 0; }
    bool hasDraft() const { return draft_bytes > 0; }
};

// Where a node's children start. They follow each other in octant order of the valid mask.
struct ChildrenRef {
    std::uint32_t block = 0;  // index in the channel's list of blocks
    std::uint32_t first = 0;  // index of the first child in that block
};

class TreeBlock {
public:
    // `raw` is the decompressed block. Errors: kCorrupt (lengths, pointers, masks or numbers that cannot be;
    // the caller adds the place). Everything an accessor touches later was checked here. REQUIRES of the
    // caller: 1 <= components <= 3.
    static Result<TreeBlock> decode(std::span<const std::byte> raw, std::uint32_t own_index,
                                    std::uint32_t block_count, std::uint64_t file_bytes, int components);

    std::uint32_t nodeCount() const { return std::uint32_t(records_.size()); }
    // The nodes [0, headNodes()) are those that a parent in another block (or the list of roots) refers to.
    std::uint32_t headNodes() const { return head_nodes_; }
    const NodeRecord& record(std::uint32_t node) const { return records_[node]; }
    bool isLeaf(std::uint32_t node) const { return (descriptors_[node] & 0xff00u) == 0; }
    // Bit o: a child exists in octant o; where it does not, level 0 is background.
    std::uint8_t validMask(std::uint32_t node) const { return std::uint8_t(descriptors_[node] >> 8); }
    // Bit o: that child is a leaf. Known without its block.
    std::uint8_t leafMask(std::uint32_t node) const { return std::uint8_t(descriptors_[node]); }
    // REQUIRES: !isLeaf(node).
    ChildrenRef children(std::uint32_t node) const;
    // nullptr where the node has none.
    const ErrorGrid* errorGrid(std::uint32_t node) const {
        return records_[node].grid < 0 ? nullptr : &grids_[std::size_t(records_[node].grid)];
    }
    // One value per component. REQUIRES: !record(node).hasBrick().
    std::span<const ValueBits> constant(std::uint32_t node) const {
        return {constants_.data() + std::size_t(records_[node].constant) * std::size_t(components_),
                std::size_t(components_)};
    }
    std::size_t memoryBytes() const;

private:
    friend struct TreeBlockCodec;
    int components_ = 1;
    std::uint32_t own_index_ = 0;
    std::uint32_t head_nodes_ = 0;
    // child pointer:15 | far:1 | valid:8 | leaf:8, high to low; 0 for a leaf. The pointer counts nodes from
    // this one to its first child, or is an index into far_.
    std::vector<std::uint32_t> descriptors_;
    // High bit clear: nodes from the parent to its first child. High bit set: a block, whose nodes 0.. the
    // children are.
    std::vector<std::uint32_t> far_;
    std::vector<NodeRecord> records_;
    std::vector<ErrorGrid> grids_;
    std::vector<ValueBits> constants_;
};

// A block's raw bytes and nodes are at most this many.
inline constexpr std::uint32_t kMaxBlockRawBytes = 16u << 20;
inline constexpr std::uint32_t kMaxBlockNodes = 16384;
// Decompression and checks of a stored block in one step. Errors: as decode().
Result<TreeBlock> decodeStoredBlock(std::span<const std::byte> stored, std::uint32_t raw_bytes,
                                    std::uint32_t own_index, std::uint32_t block_count,
                                    std::uint64_t file_bytes, int components);

}  // namespace brickyard

// The octree of one channel, as the builder made it, cut into tree blocks: stored bytes for the frame file.
// Subtrees are cut bottom-up where they reach kBlockTargetNodes, so blocks hold a few thousand nodes and none
// more than kMaxBlockNodes; the top of the tree is block 0. docs/format.md, section "Tree block".
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "core/node_key.h"
#include "core/result.h"
#include "core/tree_block.h"

namespace brickyard {

inline constexpr std::uint32_t kBlockTargetNodes = 1024;

struct TreeNode {
    NodeRecord record;                // `constant` and `grid` are filled in by the encoder
    std::vector<ValueBits> constant;  // one per component; only where record.payload_bytes == 0
    std::unique_ptr<ErrorGrid> grid;  // may be null
    std::uint8_t valid_mask = 0;      // octants that have a child; 0 for a leaf
    std::vector<std::unique_ptr<TreeNode>> children;  // in octant order of valid_mask
    // A stub: its children are fetched when their block is written, and dropped again, so that a tree larger
    // than memory can be encoded. `record`, `grid` and `children` are then filled in by the loader, from
    // `handle`.
    std::uint32_t unloaded = 0;  // nodes below it; 0: no stub. Below kBlockTargetNodes
    std::uint64_t handle = 0;
};

// Fills in a stub. Errors: kIo.
using TreeLoader = std::function<Result<void>(TreeNode& stub)>;
// Receives the stored bytes of each block in the order of block numbers, and their decompressed size.
using BlockSink = std::function<Result<void>(std::span<const std::byte> stored, std::uint32_t raw_bytes)>;

// `roots` has at most 8 nodes. No roots give no blocks. Errors: those of the two functions.
Result<void> encodeTree(const std::vector<std::unique_ptr<TreeNode>>& roots, int components,
                        const TreeLoader& load, const BlockSink& sink);
// The same for a tree that is all in memory.
std::vector<std::vector<std::byte>> encodeTree(const std::vector<std::unique_ptr<TreeNode>>& roots,
                                               int components, std::vector<std::uint32_t>& raw_bytes);

}  // namespace brickyard

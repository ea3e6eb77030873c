// The input as a raw block: what is accepted must be safe to walk, and must survive being encoded again.
#include <bit>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "core/tree_block.h"
#include "core/tree_block_encoder.h"

using namespace brickyard;

namespace {

constexpr std::uint64_t kFileBytes = 1u << 30;

void require(bool holds) {
    if (!holds) std::abort();
}

// The subtree of a block's node; children in other blocks are left out.
std::unique_ptr<TreeNode> copyOf(const TreeBlock& block, std::uint32_t node) {
    auto copy = std::make_unique<TreeNode>();
    copy->record = block.record(node);
    if (!block.record(node).hasBrick())
        copy->constant.assign(block.constant(node).begin(), block.constant(node).end());
    if (block.errorGrid(node)) copy->grid = std::make_unique<ErrorGrid>(*block.errorGrid(node));
    if (block.isLeaf(node) || block.children(node).block != 0) return copy;
    copy->valid_mask = block.validMask(node);
    for (int i = 0; i < std::popcount(copy->valid_mask); ++i)
        copy->children.push_back(copyOf(block, block.children(node).first + std::uint32_t(i)));
    return copy;
}

void requireSame(const TreeNode& expected, const std::vector<TreeBlock>& blocks, std::uint32_t block,
                 std::uint32_t node) {
    require(block < blocks.size() && node < blocks[block].nodeCount());
    const TreeBlock& in = blocks[block];
    const NodeRecord &e = expected.record, &r = in.record(node);
    require(r.payload_bytes == e.payload_bytes && r.payload_offset == e.payload_offset);
    require(r.payload_checksum == e.payload_checksum && r.active == e.active);
    require(r.value_min == e.value_min && r.value_max == e.value_max && r.bound == e.bound && r.rms == e.rms);
    require(r.draft_bytes == e.draft_bytes && r.draft_checksum == e.draft_checksum);
    require(r.draft_bound == e.draft_bound && r.draft_rms == e.draft_rms);
    require(r.box_begin == e.box_begin && r.box_end == e.box_end);
    if (!e.hasBrick())
        require(std::equal(expected.constant.begin(), expected.constant.end(), in.constant(node).begin()));
    require((expected.grid != nullptr) == (in.errorGrid(node) != nullptr));
    if (expected.grid) require(std::memcmp(expected.grid.get(), in.errorGrid(node), sizeof(ErrorGrid)) == 0);
    require(in.validMask(node) == expected.valid_mask);
    if (expected.children.empty()) return;
    const ChildrenRef children = in.children(node);
    for (std::uint32_t i = 0; i < expected.children.size(); ++i)
        requireSame(*expected.children[i], blocks, children.block, children.first + i);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size < 2) return 0;
    const int components = 1 + data[0] % 3;
    const auto input = std::as_bytes(std::span(data, size)).subspan(2);
    // Stored bytes with a claimed size as well: decompression is part of the way in.
    (void)decodeStoredBlock(input, std::uint32_t(data[1]) * 64, 0, 4, kFileBytes, components);
    const auto block = TreeBlock::decode(input, 0, 4, kFileBytes, components);
    if (!block) return 0;

    std::vector<std::unique_ptr<TreeNode>> roots;
    for (std::uint32_t head = 0; head < block->headNodes(); ++head) roots.push_back(copyOf(*block, head));
    std::vector<std::uint32_t> raw_bytes;
    const auto stored = encodeTree(roots, components, raw_bytes);
    std::vector<TreeBlock> blocks;
    for (std::uint32_t b = 0; b < stored.size(); ++b) {
        auto again = decodeStoredBlock(stored[b], raw_bytes[b], b, std::uint32_t(stored.size()), kFileBytes,
                                       components);
        require(bool(again));
        blocks.push_back(std::move(*again));
    }
    for (std::uint32_t r = 0; r < roots.size(); ++r) requireSame(*roots[r], blocks, 0, r);
    return 0;
}

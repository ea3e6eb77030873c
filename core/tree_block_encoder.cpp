#include "core/tree_block_encoder.h"

#include <bit>
#include <cassert>
#include <map>
#include <unordered_set>

#include "core/lorenzo.h"
#include "core/tree_block_format.h"
#include "core/zstd_frame.h"

namespace brickyard {
namespace {

// The parents whose children begin a block of their own.
using CutParents = std::unordered_set<const TreeNode*>;

// Nodes below `node` that stay in its block. The depth is that of the octree: at most kMaxLevel.
std::size_t cutBelow(const TreeNode& node, CutParents& cut) {
    std::size_t nodes = node.children.empty() ? node.unloaded : 0;
    assert(nodes < kBlockTargetNodes);
    for (const auto& child : node.children) nodes += 1 + cutBelow(*child, cut);
    if (nodes < kBlockTargetNodes) return nodes;
    cut.insert(&node);
    return 0;
}
// A child brings fewer than kBlockTargetNodes nodes beside itself, so this is the most a block can hold.
static_assert(8 * kBlockTargetNodes <= kMaxBlockNodes);

// One block: its nodes breadth-first from the heads, so that the children of a parent follow each other,
// always behind it, and each level's payloads are met in the order in which the file has them.
class BlockWriter {
public:
    BlockWriter(const std::vector<std::unique_ptr<TreeNode>>& heads, int components)
        : components_(components), head_nodes_(heads.size()) {
        for (const auto& head : heads) nodes_.push_back(head.get());
    }

    // `next_block` is the number of the first block that no other one refers to yet; each parent cut here
    // takes one and is appended to `parents`.
    Result<std::vector<std::byte>> raw(const CutParents& cut, std::uint32_t next_block,
                                       std::vector<const TreeNode*>& parents, const TreeLoader& load) {
        std::vector<TreeNode*> loaded;
        for (std::size_t i = 0; i < nodes_.size(); ++i) {
            if (nodes_[i]->unloaded > 0 && nodes_[i]->children.empty()) {
                if (Result<void> done = load(*nodes_[i]); !done) return tl::unexpected(done.error());
                loaded.push_back(nodes_[i]);
            }
            addNode(i, cut, next_block, parents);
        }
        // What lies below a stub is in this block, and only there.
        for (TreeNode* stub : loaded) stub->children.clear();
        return bytes();
    }

private:
    void addNode(std::size_t i, const CutParents& cut, std::uint32_t& next_block,
                 std::vector<const TreeNode*>& parents) {
        const TreeNode& node = *nodes_[i];
        assert(std::size_t(std::popcount(node.valid_mask)) == node.children.size());
        std::uint32_t descriptor = 0;
        if (node.valid_mask != 0) {
            descriptor = std::uint32_t(node.valid_mask) << 8 | leafMask(node);
            if (cut.contains(&node)) {
                descriptor |= kFarFlag | std::uint32_t(far_.size()) << kChildPointerShift;
                far_.push_back(kFarIsBlock | next_block++);
                parents.push_back(&node);
            } else {
                const std::size_t distance = nodes_.size() - i;
                static_assert(kMaxBlockNodes <=
                              kMaxChildPointer);  // so a far pointer within a block is never needed
                descriptor |= std::uint32_t(distance) << kChildPointerShift;
                for (const auto& child : node.children) nodes_.push_back(child.get());
            }
        }
        descriptors_.push_back(descriptor);
        addRecord(node);
    }

    static std::uint32_t leafMask(const TreeNode& node) {
        std::uint32_t mask = 0;
        std::size_t child = 0;
        for (unsigned octant = 0; octant < 8; ++octant)
            if ((node.valid_mask >> octant & 1) != 0 && node.children[child++]->valid_mask == 0)
                mask |= 1u << octant;
        return mask;
    }

    void addRecord(const TreeNode& node) {
        const NodeRecord& r = node.record;
        flags_.push_back(std::uint8_t((r.active ? kNodeActive : 0) | (node.grid ? kNodeHasGrid : 0)));
        if (node.grid) grids_.push_back(*node.grid);
        for (std::size_t axis = 0; axis < 3; ++axis) {
            box_[axis].push_back(r.box_begin[axis]);
            box_[3 + axis].push_back(r.box_end[axis]);
        }
        payload_bytes_.push_back(r.payload_bytes);
        payload_steps_.push_back(r.hasBrick() ? zigzag(r.payload_offset - payload_end_) : 0);
        checksums_.push_back(r.hasBrick() ? r.payload_checksum : 0);
        if (r.hasBrick()) payload_end_ = r.payload_offset + r.payload_bytes;
        value_min_.push_back(r.value_min);
        value_max_.push_back(r.value_max);
        bound_.push_back(r.bound);
        rms_.push_back(r.rms);
        constant_.push_back(r.hasBrick() ? 0 : constantIndex(node.constant));
        assert(!r.hasDraft() || (r.draft_bytes < r.payload_bytes && node.valid_mask == 0));
        draft_bytes_.push_back(r.draft_bytes);
        draft_checksums_.push_back(r.hasDraft() ? r.draft_checksum : 0);
        draft_bound_.push_back(r.hasDraft() ? r.draft_bound : 0);
        draft_rms_.push_back(r.hasDraft() ? r.draft_rms : 0);
    }

    std::uint32_t constantIndex(const std::vector<ValueBits>& value) {
        assert(value.size() == std::size_t(components_));
        const auto [at, is_new] =
            constant_indices_.try_emplace(value, std::uint32_t(constant_indices_.size()));
        if (is_new) constants_.insert(constants_.end(), value.begin(), value.end());
        return at->second;
    }

    std::vector<std::byte> bytes() const {
        TreeBlockHeader header;
        header.components = std::uint8_t(components_);
        header.nodes = std::uint32_t(nodes_.size());
        header.head_nodes = std::uint32_t(head_nodes_);
        header.far_entries = std::uint32_t(far_.size());
        header.constants = std::uint32_t(constant_indices_.size());
        header.grids = std::uint32_t(grids_.size());
        assert(header.nodes <= kMaxBlockNodes);

        std::vector<std::byte> out;
        ByteWriter writer(out);
        writer.put(header);
        putColumn(descriptors_, out);
        putColumn(far_, out);
        putColumn(flags_, out);
        for (const auto& side : box_) putColumn(side, out);
        putColumn(payload_bytes_, out);
        putColumn(payload_steps_, out);
        putColumn(checksums_, out);
        putColumn(value_min_, out);
        putColumn(value_max_, out);
        putColumn(bound_, out);
        putColumn(rms_, out);
        putColumn(constant_, out);
        putColumn(draft_bytes_, out);
        putColumn(draft_checksums_, out);
        putColumn(draft_bound_, out);
        putColumn(draft_rms_, out);
        putColumn(constants_, out);
        for (const ErrorGrid& grid : grids_) writer.put(grid);
        assert(out.size() <= kMaxBlockRawBytes);
        return out;
    }

    int components_;
    std::size_t head_nodes_;
    std::vector<TreeNode*> nodes_;
    std::vector<std::uint32_t> descriptors_, far_, payload_bytes_, constant_, draft_bytes_;
    std::vector<std::uint8_t> flags_;
    std::array<std::vector<std::uint8_t>, 6> box_;
    std::vector<std::uint64_t> payload_steps_, checksums_, draft_checksums_;
    std::vector<float> value_min_, value_max_, bound_, rms_, draft_bound_, draft_rms_;
    std::map<std::vector<ValueBits>, std::uint32_t> constant_indices_;
    std::vector<ValueBits> constants_;
    std::vector<ErrorGrid> grids_;
    std::uint64_t payload_end_ = 0;
};

}  // namespace

Result<void> encodeTree(const std::vector<std::unique_ptr<TreeNode>>& roots, int components,
                        const TreeLoader& load, const BlockSink& sink) {
    assert(roots.size() <= 8 && components >= 1 && components <= 3);
    if (roots.empty()) return {};

    CutParents cut;
    for (const auto& root : roots) cutBelow(*root, cut);

    // Blocks breadth-first as well: one that is referred to stands behind the one that refers, and the top
    // ones, which every picture needs, stand together. parents[b - 1] is the parent of the heads of block b.
    std::vector<const TreeNode*> parents;
    std::vector<std::byte> stored;
    for (std::size_t b = 0; b <= parents.size(); ++b) {
        BlockWriter writer(b == 0 ? roots : parents[b - 1]->children, components);
        const auto raw = writer.raw(cut, std::uint32_t(parents.size() + 1), parents, load);
        if (!raw) return tl::unexpected(raw.error());
        stored.clear();
        appendZstdFrame(*raw, stored);
        if (Result<void> taken = sink(stored, std::uint32_t(raw->size())); !taken) return taken;
    }
    return {};
}

std::vector<std::vector<std::byte>> encodeTree(const std::vector<std::unique_ptr<TreeNode>>& roots,
                                               int components, std::vector<std::uint32_t>& raw_bytes) {
    raw_bytes.clear();
    std::vector<std::vector<std::byte>> blocks;
    const auto encoded = encodeTree(
        roots, components, [](TreeNode&) -> Result<void> { return {}; },
        [&](std::span<const std::byte> stored, std::uint32_t raw) -> Result<void> {
            blocks.emplace_back(stored.begin(), stored.end());
            raw_bytes.push_back(raw);
            return {};
        });
    assert(encoded && "nothing here can fail");
    return blocks;
}

}  // namespace brickyard

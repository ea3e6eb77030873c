// One channel of a frame as a ray sees it: where it is in the world, and as much of its octree as has
// arrived. During a pass any thread may read; addBlock() belongs to one thread, between passes.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "core/affine.h"
#include "core/brick_shape.h"
#include "core/node_key.h"
#include "core/result.h"
#include "core/tree_block.h"
#include "proto/dataset.pb.h"

namespace brickyard {

struct NodeRef {
    std::uint32_t block = 0;
    std::uint32_t node = 0;
    bool operator==(const NodeRef&) const = default;
};

class PagedChannel {
public:
    // Errors: kCorrupt (numbers in the footer that cannot be); kUnsupported (values beyond the float range).
    static Result<PagedChannel> create(const ChannelFooter& footer, std::uint32_t index, int brick_edge,
                                       std::uint64_t file_bytes);

    std::uint32_t index() const { return index_; }
    BrickShape shape() const { return shape_; }
    SampleType type() const { return type_; }
    const Affine& transform() const { return transform_; }
    // Where a scene puts the channel, whatever has arrived of it. Errors: kCorrupt (no transform).
    Result<void> place(const ChannelFooter& footer);
    int components() const { return int(background_bits_.size()); }  // 1 or 3
    float background() const { return background_; }                 // of the first component
    // One value a component.
    std::span<const ValueBits> backgroundBits() const { return background_bits_; }
    // Least and greatest active value, of the worst component.
    double valueMin() const { return footer_.value_min(); }
    double valueMax() const { return footer_.value_max(); }
    // OpenVDB's "staggered": component c of index (i, j, k) lies half a voxel below it on axis c.
    bool staggered() const { return components() == 3 && footer_.grid_class() == "staggered"; }
    // The medium's closed box in index space: its active voxels and one sample beyond. REQUIRES: !empty().
    const glm::dvec3& clipLow() const { return clip_low_; }
    const glm::dvec3& clipHigh() const { return clip_high_; }
    // No active voxel: nothing to draw.
    bool empty() const { return empty_; }
    const std::string& name() const { return footer_.name(); }

    // Roots are nodes (0, i); known before block 0 is.
    const std::vector<NodeKey>& roots() const { return roots_; }
    std::uint32_t blockCount() const { return std::uint32_t(blocks_.size()); }
    // nullptr until it has arrived.
    const TreeBlock* block(std::uint32_t index) const { return blocks_[index].get(); }
    // Stored bytes as they came. Errors: kNotFound; kCorrupt (checksum, contents).
    Result<void> addBlock(std::uint32_t index, std::span<const std::byte> stored);
    // Level of a node. REQUIRES: its block has arrived.
    int levelOf(const NodeRef& ref) const { return levels_[ref.block][ref.node]; }
    std::uint64_t blockBytes(std::uint32_t index) const { return footer_.blocks(int(index)).bytes(); }
    // Memory of the blocks that have arrived.
    std::uint64_t treeBytes() const { return tree_bytes_; }

private:
    PagedChannel() = default;
    ChannelFooter footer_;
    std::uint32_t index_ = 0;
    BrickShape shape_;
    SampleType type_ = SampleType::kFloat32;
    Affine transform_;
    float background_ = 0;
    std::vector<ValueBits> background_bits_;
    glm::dvec3 clip_low_{0}, clip_high_{0};
    bool empty_ = true;
    std::uint64_t file_bytes_ = 0;
    std::uint64_t tree_bytes_ = 0;
    std::vector<NodeKey> roots_;
    std::vector<std::shared_ptr<const TreeBlock>> blocks_;
    std::vector<int> head_level_;  // of a block's first nodes; -1 until the parent's block tells
    std::vector<std::vector<std::int8_t>> levels_;  // by block, by node
};

}  // namespace brickyard

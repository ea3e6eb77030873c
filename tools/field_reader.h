// One channel of one frame as a field: the octree walked to a node by index position, its brick decoded, the
// field evaluated. For checking and exporting; the renderer has its own, faster way. Any thread may call any
// const member.
#pragma once

#include <array>
#include <glm/vec3.hpp>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "core/affine.h"
#include "core/brick_codec.h"
#include "core/brick_store.h"
#include "core/field_source.h"
#include "core/page_address.h"

namespace brickyard {

// A node of the octree, with its block kept alive.
struct FieldNode {
    NodeKey key;
    std::shared_ptr<const TreeBlock> tree;
    std::uint32_t block = 0, node = 0;

    const NodeRecord& record() const { return tree->record(node); }
    bool isLeaf() const { return tree->isLeaf(node); }
    std::uint8_t validMask() const { return tree->validMask(node); }
};

class FieldReader {
public:
    // Keeps about `cache_bytes` of decoded bricks, and every tree block it has met. REQUIRES: the channel
    // exists.
    FieldReader(std::shared_ptr<const BrickStore> store, std::uint32_t channel,
                std::size_t cache_bytes = std::size_t(256) << 20);

    const ChannelFooter& channel() const { return store_->footer().channels(int(channel_)); }
    const BrickStore& store() const { return *store_; }
    std::uint32_t channelIndex() const { return channel_; }
    SampleType type() const { return SampleType(int(channel().sample_type())); }
    int components() const { return int(channel().components()); }
    BrickShape shape() const { return {int(store_->footer().brick_edge())}; }
    const Affine& indexToWorld() const { return index_to_world_; }
    std::span<const ValueBits> background() const { return background_; }
    // "density L0(1,2,3)", for messages.
    std::string describe(const NodeKey& key) const;
    // Samples [begin, end) that a node owns: its cells' lower corners.
    IndexBox ownedRegion(const NodeKey& key) const;

    // Errors of all below: kCorrupt, kIo; file and node are named.
    Result<std::vector<FieldNode>> roots() const;
    // REQUIRES: the octant is valid.
    Result<FieldNode> child(const FieldNode& parent, int octant) const;
    // The node of `level` whose cells hold the position, or the leaf above it; nothing where no node is
    // stored.
    Result<std::optional<FieldNode>> find(const Index3& position, int level) const;
    // REQUIRES: the node has a brick.
    Result<std::shared_ptr<const DecodedBrick>> brick(const FieldNode& node) const;

    // The field of `level` at a position in index space: trilinear, in double; the background outside.
    Result<std::array<double, 3>> sample(const glm::dvec3& index, int level = 0) const;
    // A leaf's field at a position inside it. REQUIRES: `decoded` is the leaf's brick.
    std::array<double, 3> interpolate(const FieldNode& node, const DecodedBrick& decoded,
                                      const glm::dvec3& index) const;
    // Level-0 samples and states of a box, as FieldSource::read gives them; where a leaf is coarse,
    // interpolated.
    Result<void> read(const IndexBox& box, SampleBlock& out) const;

private:
    Result<std::shared_ptr<const TreeBlock>> loadBlock(std::uint32_t block) const;
    Result<void> readNode(const FieldNode& node, const IndexBox& box, SampleBlock& out) const;
    void fill(const IndexBox& box, const IndexBox& part, std::span<const ValueBits> value, bool active,
              SampleBlock& out) const;

    std::shared_ptr<const BrickStore> store_;
    std::uint32_t channel_;
    std::size_t cache_bytes_;
    Affine index_to_world_;
    std::vector<ValueBits> background_;

    struct CachedBrick {
        PageAddress page;
        std::shared_ptr<const DecodedBrick> brick;
    };
    mutable std::mutex mutex_;
    mutable std::unordered_map<std::uint32_t, std::shared_ptr<const TreeBlock>> blocks_;
    mutable std::list<CachedBrick> bricks_;  // most recently used first
    mutable std::unordered_map<PageAddress, std::list<CachedBrick>::iterator, PageAddressHash> index_;
    mutable std::size_t used_bytes_ = 0;
};

// The index of a channel by its name. Errors: kNotFound (says which there are).
Result<std::uint32_t> findChannel(const BrickStore& store, const std::string& name);

// One value of a planar array of samples. REQUIRES: `at` is inside.
ValueBits sampleBits(SampleType type, std::span<const std::byte> values, std::size_t at);

}  // namespace brickyard

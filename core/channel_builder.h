// One channel's way from field to octree: plan, coarse levels with their deviations, level-0 bricks, tree
// blocks. The steps are called in order; buildFrame interleaves those of several channels. Not thread-safe;
// uses the ParallelFor of its options inside a step.
#pragma once

#include <memory>
#include <unordered_map>
#include <vector>

#include "core/finite_field.h"
#include "core/octree_builder.h"
#include "core/octree_plan.h"
#include "core/tree_block_encoder.h"

namespace brickyard {

class ChannelBuilder {
public:
    // Errors: those of FiniteField::create; kInvalid (a region of one value that is not finite).
    static Result<std::unique_ptr<ChannelBuilder>> create(const FieldSource& source,
                                                          const BuildOptions& options);

    // Plans the tree and computes, encodes and measures every level above 0. Payloads stay in memory.
    Result<void> buildLevels();
    std::size_t brickCount() const { return plan_.levels().empty() ? 0 : plan_.levels()[0].size(); }
    // Encodes level 0 and appends it. `done` counts bricks over all channels.
    Result<void> writeFinest(FrameWriter& writer, std::size_t& done, std::size_t total);
    // Appends the payloads of one level >= 1; nothing where the channel has no such level.
    Result<void> writeLevel(FrameWriter& writer, int level);
    int levelCount() const { return int(plan_.levels().size()); }
    // Appends the tree blocks; gives the channel's part of the footer.
    Result<ChannelFooter> writeTree(FrameWriter& writer);

private:
    struct Node {
        NodeRecord record;
        std::vector<double> exact;    // unquantised samples of this level, planar; freed after the next level
        std::vector<double> decoded;  // what a reader gets; freed after its deviations are measured
        std::vector<std::byte> payload;  // levels above 0, until written
        std::vector<ValueBits> constant;
        ErrorGrid grid;
        double deviation = 0;         // largest, before rounding to the record's float
        bool states_uniform = false;  // every voxel in the region is active, or none is
        bool states_active = false;
        bool pruned = false;   // lies within the error bound: becomes a leaf, nothing below it is stored
        bool dropped = false;  // below a pruned node
    };

    ChannelBuilder(FiniteField field, const BuildOptions& options);

    std::vector<Node>& level(int l) { return nodes_[std::size_t(l)]; }
    Result<std::vector<double>> readBrick(const NodeKey& key, SampleBlock& block) const;
    Result<void> gatherFine(const NodeKey& key, std::vector<double>& fine) const;
    Result<void> buildNode(const PlannedNode& planned, Node& node);
    Result<void> measureLevel(int l);
    void collectParts(const PlannedNode& from, std::vector<NodeKey>& bricks,
                      std::vector<std::pair<NodeKey, UniformRegion>>& uniform) const;
    void summarise(const PlannedNode& planned, Node& node);
    Result<void> readStatistics();
    void prune();
    void encodeFinest(const SampleBlock& block, double parent_rms, Node& node,
                      std::vector<std::byte>& payload) const;
    std::unique_ptr<TreeNode> treeNode(const NodeKey& key);
    std::size_t componentCount() const { return std::size_t(field_.info().components); }

    FiniteField field_;
    BuildOptions options_;
    OctreePlan plan_;
    std::vector<std::vector<Node>> nodes_;  // beside plan_.levels()
    double scale_ = 1;                      // keeps squared deviations in range
    double value_min_ = 0, value_max_ = 0;
    bool any_active_ = false;
    double error_made_ = 0;
    std::uint64_t bricks_ = 0, payload_bytes_ = 0;
};

}  // namespace brickyard

// One chunk of a channel's octree (octree_plan.h): the nodes of the levels above its base, with their bricks,
// statistics and deviations, from the samples of the base alone. The base of the first tier is level 0; that
// of the next is the level that the first tier ended with, and so on.
//
// Steps, in this order: read, classify and reduce; encodeCoarse for each index (any order and thread);
// measure for each index (any order and thread); finish. The result does not depend on the order of indices.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "core/buffer_pool.h"
#include "core/deviation.h"
#include "core/finite_field.h"
#include "core/octree_plan.h"
#include "core/tree_block.h"

namespace brickyard {

// The same for all chunks of a channel. What it points to outlives them.
struct ChunkSettings {
    const FiniteField* field = nullptr;
    BrickShape shape;
    double max_error = 0;  // as BuildOptions
    bool drafts = true;    // as BuildOptions
    double scale = 1;      // keeps squared deviations in range
    std::vector<double> background;
    BufferPool* buffers = nullptr;

    const ChannelInfo& info() const { return field->info(); }
    std::size_t components() const { return background.size(); }
};

enum class NodeKind : std::uint8_t {
    kAbsent,   // inactive background all over
    kUniform,  // one value and one state in the closed region
    kSampled,  // values differ: it has a brick
};

// A node of a chunk.
struct ChunkNode {
    NodeKind kind = NodeKind::kAbsent;
    bool states_uniform = true;  // every voxel in the region is active, or none is
    bool states_active = false;
    bool pruned = false;   // lies within the error asked for: becomes a leaf, nothing below it is stored
    bool dropped = false;  // below a pruned node
    std::uint8_t valid_mask = 0;
    NodeRecord record;
    std::vector<ValueBits> constant;  // kUniform
    std::unique_ptr<ErrorGrid> grid;  // above the base
    double deviation = 0;             // largest, before rounding to the record's float
    std::vector<std::byte> payload;
};

// What a chunk of a higher tier is made of: nodes that chunks of the tier below ended with. Const members may
// be called from any thread.
class BaseLevel {
public:
    virtual ~BaseLevel() = default;
    // nullptr where there is no such node.
    virtual const ChunkNode* find(const NodeKey& key) const = 0;
    // The region of one value that is or holds a node of any level, or nullptr.
    virtual const UniformRegion* uniformAt(const NodeKey& key) const = 0;
    // Exact samples, planar, and residuals by component, of a sampled node. Errors: kIo.
    virtual Result<std::vector<double>> samples(const NodeKey& key) const = 0;
    virtual Result<std::vector<CellResidual>> residual(const NodeKey& key) const = 0;
};

// What a chunk found out about level 0.
struct ActiveSummary {
    std::uint64_t voxels = 0;
    IndexBox box;
    bool any = false;
    double min = 0, max = 0;

    void include(const ActiveSummary& other);
    // A region of one value. REQUIRES: it is active.
    void includeUniform(const IndexBox& owned, double min_value, double max_value);
};

class Chunk {
public:
    // `root` is chunkSteps() levels above the base. `for_next_tier`: the residual of the root is wanted.
    Chunk(const ChunkSettings& settings, const NodeKey& root, bool for_next_tier);
    ~Chunk();
    Chunk(const Chunk&) = delete;
    Chunk& operator=(const Chunk&) = delete;

    // The first tier: reads level 0 with the halo that reduction needs. Errors: the field's.
    Result<void> readField();
    // Another tier. Errors: those of `base`.
    Result<void> readBase(const BaseLevel& base);

    std::size_t coarseCount() const { return coarse_.size(); }
    void encodeCoarse(std::size_t index);
    std::size_t measureCount() const { return coarse_.empty() ? 0 : nodes_[1].size(); }
    void measure(std::size_t index);
    void finish();

    const NodeKey& root() const { return root_; }
    int steps() const { return steps_; }
    // Nodes `depth` levels above the base, (2^(steps - depth))^3 of them, x fastest.
    std::vector<ChunkNode>& nodesAt(int depth) { return nodes_[std::size_t(depth)]; }
    ChunkNode& node(int depth, int x, int y, int z) {
        return nodes_[std::size_t(depth)][slot(depth, x, y, z)];
    }
    NodeKey keyOf(int depth, std::size_t slot) const;
    std::size_t slot(int depth, int x, int y, int z) const {
        const std::size_t e = std::size_t(1) << (steps_ - depth);
        return std::size_t(x) + e * (std::size_t(y) + e * std::size_t(z));
    }
    const ActiveSummary& active() const { return active_; }
    // The root's samples and residual. REQUIRES: finished, kSampled.
    std::vector<double> topSamples() const;
    const std::vector<CellResidual>& topResidual() const { return residual_; }

private:
    struct Level {
        std::size_t edge = 0;                      // samples per axis
        int halo = 0;                              // of them in front of the chunk
        std::vector<std::vector<double>> samples;  // by component, x fastest; empty at level 0
    };
    // The part of level 0 that was read: nodes of depth 1, [begin, end) per axis. All else is inactive
    // background.
    struct ReadPart {
        std::array<int, 3> begin{}, end{};
        std::array<std::size_t, 3> extent{};  // samples per axis, halo included
    };
    bool findPart();
    SampleCube<std::uint8_t> activeOf(std::size_t slot) const;
    std::array<std::size_t, 3> baseAt(std::size_t slot) const;
    bool isRead(std::size_t slot) const;
    bool atLevel0() const { return root_.level == steps_; }
    template <class Visit>
    void visitBase(std::size_t component, std::size_t slot, Visit&& visit) const;
    void releaseSamples();
    void describeBricks();
    Result<void> copyBase(const BaseLevel& base, const NodeKey& key);
    void classify();
    void reduce();
    SampleCube<double> exact(int depth, std::size_t slot, std::size_t component) const;
    double valueOf(const ChunkNode& node, std::size_t component) const;
    void describeUniform(ChunkNode& node) const;
    std::size_t ancestorOf(std::size_t slot, int depth, int above) const;
    void measureChild(std::size_t child, std::size_t parent, std::vector<NodeDeviation>& own);
    void measureUniform(std::size_t slot);
    void settleDeviation(int depth, std::size_t slot, const std::vector<NodeDeviation>& components);
    void encodeFinest(std::size_t slot, double parent_rms);
    void summarise(int depth, std::size_t slot);
    void prune();

    const ChunkSettings& settings_;
    NodeKey root_;
    int steps_;
    bool for_next_tier_;
    ReadPart part_;
    SampleBlock block_;          // level 0 with its halo, in the channel's type
    std::vector<Level> levels_;  // [0] is the base: without samples at level 0
    std::vector<std::vector<ChunkNode>> nodes_;
    std::vector<std::vector<std::vector<double>>> decoded_;  // depth, slot, planar
    std::vector<std::pair<int, std::size_t>> coarse_;        // sampled nodes above the base
    // What each measured node adds to its ancestors: depth 2 and up, component.
    std::vector<std::vector<std::vector<NodeDeviation>>> shares_;
    // A base node's residual, tiers above the first.
    std::vector<std::vector<CellResidual>> base_residual_;
    std::vector<CellResidual> residual_;
    ActiveSummary active_;
};

}  // namespace brickyard

// One channel's way from field to octree: a plan, chunks of level 0, tiers of chunks above them, tree blocks.
// The steps are called in order; buildFrame interleaves those of several channels. Not thread-safe but where
// said.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <unordered_map>
#include <vector>

#include "core/chunk.h"
#include "core/finite_field.h"
#include "core/first_error.h"
#include "core/octree_builder.h"
#include "core/octree_plan.h"
#include "core/scratch_file.h"
#include "core/subtree_store.h"
#include "core/tree_block_encoder.h"

namespace brickyard {

class ChannelBuilder final : private BaseLevel {
public:
    // `source`, `scratch` and `buffers` outlive it. Errors: those of FiniteField::create.
    static Result<std::unique_ptr<ChannelBuilder>> create(const FieldSource& source,
                                                          const BuildOptions& options, ScratchFile& scratch,
                                                          BufferPool& buffers);

    // Finds the chunks. Errors: kInvalid (a region of one value that is not finite), the source's.
    Result<void> plan();
    std::size_t chunkCount() const { return plan_->chunks().size(); }
    // A chunk of level 0, not read yet. Any thread.
    std::unique_ptr<Chunk> chunk(std::size_t index) const;
    // What a chunk takes in memory, about.
    std::uint64_t chunkBytes() const;
    // Takes over a finished chunk of level 0: its bricks go to the writer. In the order of chunk indices.
    Result<void> commitFinest(Chunk& chunk, FrameWriter& writer);
    // After the last chunk: the levels above, and the roots.
    Result<void> buildTiers(const ParallelFor& parallel_for);

    int levelCount() const { return level_count_; }
    // Appends the payloads of one level >= 1; nothing where the channel has no such level.
    Result<void> writeLevel(FrameWriter& writer, int level);
    // Appends the tree blocks; gives the channel's part of the footer.
    Result<ChannelFooter> writeTree(FrameWriter& writer);

private:
    struct Base {
        ChunkNode node;  // without payload
        std::uint64_t samples_at = 0, residual_at = 0;
    };
    using Nodes = std::unordered_map<NodeKey, std::unique_ptr<TreeNode>, NodeKeyHash>;
    struct Level {
        std::vector<std::pair<std::uint64_t, std::uint64_t>>
            extents;  // of payloads in the scratch file, in order
        std::uint64_t bytes = 0, bricks = 0;
        std::uint64_t begin = 0;  // in the frame file, once written
    };

    ChannelBuilder(const FieldSource& source, FiniteField field, const BuildOptions& options,
                   ScratchFile& scratch, BufferPool& buffers);

    // BaseLevel: the tier that was finished last.
    const ChunkNode* find(const NodeKey& key) const override;
    const UniformRegion* uniformAt(const NodeKey& key) const override { return plan_->uniformAt(key); }
    Result<std::vector<double>> samples(const NodeKey& key) const override;
    Result<std::vector<CellResidual>> residual(const NodeKey& key) const override;

    Result<double> largestMagnitude() const;
    bool isTop(const std::vector<NodeKey>& keys, int level) const;
    std::vector<NodeKey> tierRoots(int base) const;
    Result<void> putPayloads(Chunk& chunk, int lowest_depth);
    Result<std::unique_ptr<TreeNode>> treeOf(Chunk& chunk, int depth, int x, int y, int z);
    Result<void> keepBase(Chunk& chunk, bool for_next_tier,
                          std::unordered_map<NodeKey, Base, NodeKeyHash>& bases);
    Result<void> trimRoots();
    void placePayloads(TreeNode& node, int level) const;
    Result<void> loadPlaced(TreeNode& stub) const;

    const FieldSource* source_;
    FiniteField field_;
    BuildOptions options_;
    ScratchFile* scratch_;
    SubtreeStore subtrees_;
    ChunkSettings settings_;
    std::optional<OctreePlan> plan_;
    bool several_tiers_ = false;
    std::unordered_map<NodeKey, Base, NodeKeyHash> bases_;
    Nodes tops_;  // of the same level as bases_
    std::vector<std::pair<NodeKey, std::unique_ptr<TreeNode>>> roots_;
    int level_count_ = 0;
    std::map<int, Level> levels_;
    ActiveSummary active_;
    double error_made_ = 0;
    std::uint64_t bricks_ = 0, payload_bytes_ = 0;
};

}  // namespace brickyard

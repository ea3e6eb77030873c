// A frame built from fields and read back whole: every node with its key, record and decoded samples.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <span>
#include <unordered_map>
#include <vector>

#include "core/brick_codec.h"
#include "core/brick_store.h"
#include "core/frame_writer.h"
#include "core/octree_builder.h"
#include "core/sample_conversion.h"
#include "frame_fixture.h"

namespace brickyard {

struct StoredNode {
    NodeKey key;
    NodeRecord record;
    bool leaf = false;
    std::uint8_t valid_mask = 0;
    std::vector<double> samples;  // planar, (N + 1)^3 a component
    std::optional<ErrorGrid> grid;
};

class StoredFrame {
public:
    StoredFrame(std::span<const FieldSource* const> fields, std::span<const BuildOptions> options) {
        auto writer = FrameWriter::create(folder_ / "frame.brk");
        EXPECT_TRUE(writer);
        auto footer = buildFrame(fields, options, **writer);
        EXPECT_TRUE(footer) << footer.error().message;
        EXPECT_TRUE((*writer)->finish(*footer));
        auto store = BrickStore::open(folder_ / "frame.brk");
        EXPECT_TRUE(store) << store.error().message;
        store_ = *store;
        shape_.edge_cells = int(store_->footer().brick_edge());
        for (int c = 0; c < store_->footer().channels_size(); ++c) load(std::uint32_t(c));
    }
    StoredFrame(const FieldSource& field, const BuildOptions& options)
        : StoredFrame(std::array{&field}, std::array{options}) {}

    const FrameFooter& footer() const { return store_->footer(); }
    const std::vector<StoredNode>& nodes(std::size_t channel = 0) const { return nodes_[channel]; }
    const StoredNode* find(const NodeKey& key, std::size_t channel = 0) const {
        const auto found = index_[channel].find(key);
        return found == index_[channel].end() ? nullptr : &nodes_[channel][found->second];
    }
    BrickShape shape() const { return shape_; }

    // The node's own field at a position of index space inside its closed region.
    double field(const StoredNode& node, double x, double y, double z, int component = 0) const {
        const double edge = std::ldexp(1.0, node.key.level);
        const double p[3] = {x / edge - double(node.key.x) * shape_.edge_cells,
                             y / edge - double(node.key.y) * shape_.edge_cells,
                             z / edge - double(node.key.z) * shape_.edge_cells};
        int cell[3];
        double t[3];
        for (int a = 0; a < 3; ++a) {
            cell[a] = std::clamp(int(std::floor(p[a])), 0, shape_.edge_cells - 1);
            t[a] = p[a] - cell[a];
        }
        double sum = 0;
        for (int q = 0; q < 8; ++q) {
            const double w =
                ((q & 1) ? t[0] : 1 - t[0]) * ((q & 2) ? t[1] : 1 - t[1]) * ((q & 4) ? t[2] : 1 - t[2]);
            if (w != 0)
                sum += w * node.samples[std::size_t(component) * shape_.samples() +
                                        shape_.sampleAt(cell[0] + (q & 1), cell[1] + (q >> 1 & 1),
                                                        cell[2] + (q >> 2))];
        }
        return sum;
    }

private:
    void load(std::uint32_t channel) {
        nodes_.emplace_back();
        index_.emplace_back();
        const ChannelFooter& footer = store_->footer().channels(int(channel));
        for (int b = 0; b < footer.blocks_size(); ++b) {
            auto block = store_->loadBlock(channel, std::uint32_t(b));
            ASSERT_TRUE(block) << block.error().message;
            blocks_.push_back(std::make_shared<TreeBlock>(std::move(*block)));
        }
        const std::size_t first = blocks_.size() - std::size_t(footer.blocks_size());
        for (int r = 0; r < footer.roots_size(); ++r) {
            const RootNode& root = footer.roots(r);
            visit(channel, first, 0, std::uint32_t(r),
                  {std::int32_t(root.level()), root.x(), root.y(), root.z()});
        }
    }
    void visit(std::uint32_t channel, std::size_t first, std::uint32_t block, std::uint32_t node,
               const NodeKey& key) {
        const TreeBlock& tree = *blocks_[first + block];
        const ChannelFooter& footer = store_->footer().channels(int(channel));
        const SampleType type = SampleType(int(footer.sample_type()));
        const int components = int(footer.components());
        StoredNode out;
        out.key = key;
        out.record = tree.record(node);
        out.leaf = tree.isLeaf(node);
        out.valid_mask = tree.validMask(node);
        if (const ErrorGrid* grid = tree.errorGrid(node)) out.grid = *grid;
        if (out.record.hasBrick()) {
            auto payload = store_->readPayload(out.record, toString(key));
            ASSERT_TRUE(payload) << payload.error().message;
            const SampleType stored = levelType(type, key.level);
            const std::vector<ValueBits> background(footer.background().begin(), footer.background().end());
            auto decoded = decodeBrick(*payload, shape_, stored, components, background);
            ASSERT_TRUE(decoded) << decoded.error().message;
            samplesToDouble(stored, decoded->values, out.samples);
        } else {
            for (const ValueBits bits : tree.constant(node))
                out.samples.insert(out.samples.end(), shape_.samples(), toDouble(type, bits));
        }
        index_[channel].emplace(key, nodes_[channel].size());
        nodes_[channel].push_back(std::move(out));
        if (tree.isLeaf(node)) return;
        ChildrenRef child = tree.children(node);
        for (int octant = 0; octant < 8; ++octant)
            if (tree.validMask(node) >> octant & 1)
                visit(channel, first, child.block, child.first++, key.child(octant));
    }

    ScratchFolder folder_;
    std::shared_ptr<const BrickStore> store_;
    BrickShape shape_;
    std::vector<std::shared_ptr<TreeBlock>> blocks_;
    std::vector<std::vector<StoredNode>> nodes_;
    std::vector<std::unordered_map<NodeKey, std::size_t, NodeKeyHash>> index_;
};

}  // namespace brickyard

// Which nodes a channel's octree has, before any brick is read: the field's regions of one value from the top
// down. Immutable once made: any thread.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "core/brick_shape.h"
#include "core/field_source.h"
#include "core/node_key.h"

namespace brickyard {

enum class PlannedKind : std::uint8_t {
    kInner,    // values differ; has children
    kBrick,    // level 0, values differ
    kUniform,  // one value and one state in the closed region; no children, no brick
};

struct PlannedNode {
    NodeKey key;
    PlannedKind kind = PlannedKind::kInner;
    std::uint8_t valid_mask = 0;  // children that exist; where one does not, the field is inactive background
    UniformRegion uniform;        // kUniform only
};

class OctreePlan {
public:
    // Asks `field` about boxes from all of int32 down to single bricks. The roots are one node, or up to
    // eight that meet at the origin (floor division never brings -1 and 0 together).
    static OctreePlan make(const FieldSource& field, BrickShape shape);

    // By level, each in Morton order; empty when the whole field is inactive background.
    const std::vector<std::vector<PlannedNode>>& levels() const { return levels_; }
    // nullptr where there is no such node: background, or inside a uniform node of a higher level.
    const PlannedNode* find(const NodeKey& key) const;
    // Index in levels()[key.level]. REQUIRES: find(key).
    std::size_t indexOf(const NodeKey& key) const;
    // The node or the nearest node above it that exists, or nullptr.
    const PlannedNode* findOrAbove(NodeKey key) const;

private:
    std::vector<std::vector<PlannedNode>> levels_;
    std::vector<std::unordered_map<NodeKey, std::uint32_t, NodeKeyHash>> index_;
};

// Samples of a node's closed region [k, k + N] * 2^level, faces included, as a half-open box of level-0
// positions.
IndexBox closedRegion(const NodeKey& key, BrickShape shape);

}  // namespace brickyard

// Which parts of index space a channel's octree is built over, before any sample is read: chunks that have to
// be looked into, and larger regions of one value. Immutable once made: any thread.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "core/brick_shape.h"
#include "core/field_source.h"
#include "core/node_key.h"
#include "core/result.h"

namespace brickyard {

// A chunk is a node with three levels of nodes below it (two with 32 cells a brick, one with 64), 128 voxels
// an edge or less: what is read, reduced, measured and encoded as one piece of work. The same count of levels
// lies between a chunk of a higher tier and the nodes that it is made of.
int chunkSteps(BrickShape shape);

class OctreePlan {
public:
    // Asks `field` about boxes from all of int32 down to single chunks. Errors: kInvalid (a region of one
    // value that is not finite).
    static Result<OctreePlan> make(const FieldSource& field, BrickShape shape);

    // Nodes of level chunkSteps() whose values differ or are not known yet; by rows (x fastest) or in Morton
    // order, as the field prefers.
    const std::vector<NodeKey>& chunks() const { return chunks_; }
    // Regions of one value and state that are not inactive background, of level chunkSteps() and above. None
    // lies in another.
    const std::vector<std::pair<NodeKey, UniformRegion>>& uniform() const { return uniform_; }
    // The region that is or holds `key`, or nullptr.
    const UniformRegion* uniformAt(NodeKey key) const;

private:
    std::vector<NodeKey> chunks_;
    std::vector<std::pair<NodeKey, UniformRegion>> uniform_;
    std::unordered_map<NodeKey, std::uint32_t, NodeKeyHash> index_;  // of uniform_
    int highest_uniform_ = 0;
};

// Samples of a node's closed region [k, k + N] * 2^level, faces included, as a half-open box of level-0
// positions.
IndexBox closedRegion(const NodeKey& key, BrickShape shape);

}  // namespace brickyard

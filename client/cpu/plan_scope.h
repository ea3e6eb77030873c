// What the rays of a picture meet, as page_order plans it: the nodes from the roots down to a few levels
// below what is drawn, and how much each part of them counts. Built by one thread; then a plain value.
#pragma once

#include <cstdint>
#include <vector>

#include "client/cpu/page_order.h"

namespace brickyard {

struct PlanNode {
    NodeRef ref;
    NodeKey key;
    const TreeBlock* block = nullptr;
    std::uint32_t parent = kNone;  // stands before the node
    std::uint32_t first_child = kNone, next_sibling = kNone;
    Residency residency = Residency::kNone;
    std::uint32_t missing_block = kNone;  // that of its children, where rays went no further for lack of it
    std::uint32_t begin = 0, end = 0;     // its units and those of nodes below

    static constexpr std::uint32_t kNone = 0xffffffffu;
    const NodeRecord& record() const { return block->record(ref.node); }
};

// A region that is planned as one: an octant of a node that rays were not followed below.
struct PlanUnit {
    std::uint32_t node = 0;
    NodeKey region;  // a level below the node's, level -1 included
    // Sum over rays of (transmittance x scale)^2 x length in it x length of an index unit: times a mean
    // square deviation and a level's cell edge it is squared error of alpha.
    double measure = 0;
    // What is drawn there: the page of a node at or above it.
    std::uint32_t drawn = 0;
    bool drawn_draft = false;
    double drawn_square = 0;

    double error() const { return measure * drawn_square; }
};

struct PlanScope {
    std::vector<PlanNode> nodes;  // parents before children
    std::vector<PlanUnit> units;  // those below a node are neighbours

    PlanScope(const PagedChannel& channel, const PinholeCamera& camera, const ResidentTree& tree,
              const PlanRequest& request);
};

// Mean square of the effective deviation of a node's brick (or its draft) over `region`, which is below it,
// times the cell edge of the node's level in index units.
double planSquare(const PlanNode& node, bool draft, const NodeKey& region);

// Of two pages above a point, the one of lower rank is drawn.
inline int planRank(const NodeKey& key, bool draft) { return 2 * key.level + (draft ? 1 : 0); }

}  // namespace brickyard

// Which nodes of the octree a tile of rays uses: the inner nodes that give way to their children, and the
// leaves whose whole brick takes their draft's place. Plain value.
#pragma once

#include <unordered_set>

#include "client/cpu/octree_walk.h"

namespace brickyard {

struct TileCut {
    bool finest = false;  // all leaves, whole: the two sets count for nothing
    std::unordered_set<std::uint64_t> split, whole;

    static std::uint64_t keyOf(const NodeRef& ref) { return std::uint64_t(ref.block) << 32 | ref.node; }
    // Whether the node's children take its place. REQUIRES: canDescend(node).
    bool descends(const WalkedNode& node) const { return finest || split.contains(keyOf(node.ref)); }
    bool usesDraft(const WalkedNode& node) const {
        return !finest && node.record().hasDraft() && !whole.contains(keyOf(node.ref));
    }
};

}  // namespace brickyard

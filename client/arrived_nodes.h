// The nodes of a channel's tree as far as it has arrived. Reads only; any thread between arrivals.
#pragma once

#include <vector>

#include "client/paged_channel.h"

namespace brickyard {

// Calls visit(ref, key) for nodes of the blocks that have arrived, parents first, and missing(block) for a
// block that has not, perhaps more than once. Goes below a node where visit says so.
template <class Visit, class Missing>
void forEachArrived(const PagedChannel& channel, Visit visit, Missing missing) {
    struct Place {
        NodeRef ref;
        NodeKey key;
    };
    std::vector<Place> open;
    for (std::size_t i = 0; i < channel.roots().size(); ++i)
        open.push_back({{0, std::uint32_t(i)}, channel.roots()[i]});
    while (!open.empty()) {
        const Place place = open.back();
        open.pop_back();
        if (place.ref.block >= channel.blockCount()) continue;
        const TreeBlock* block = channel.block(place.ref.block);
        if (!block) {
            missing(place.ref.block);
            continue;
        }
        // A block may lie about its roots, and level 0 has no children whatever it says.
        if (place.ref.node >= block->nodeCount()) continue;
        if (!visit(place.ref, place.key) || place.key.level == 0 || block->isLeaf(place.ref.node)) continue;
        const ChildrenRef first = block->children(place.ref.node);
        std::uint32_t at = first.first;
        for (int octant = 0; octant < 8; ++octant)
            if (block->validMask(place.ref.node) >> octant & 1)
                open.push_back({{first.block, at++}, place.key.child(octant)});
    }
}

}  // namespace brickyard

// The nodes along a ray, front to back, from the topology that has arrived. Reads only; any thread.
#pragma once

#include <cmath>

#include "client/cpu/index_ray.h"
#include "client/paged_channel.h"

namespace brickyard {

enum class WalkStatus {
    kNode,          // use this node
    kBackground,    // no node: the field is the channel's background
    kMissingBlock,  // the node's children stand in a block that has not arrived; `missing_block` says which
};

struct WalkedNode {
    WalkStatus status = WalkStatus::kNode;
    NodeRef ref;
    NodeKey key;
    RaySpan span;
    const TreeBlock* block =
        nullptr;  // of `ref`; nullptr for background, and for a root whose block is missing
    std::uint32_t missing_block = 0;
    const NodeRecord& record() const { return block->record(ref.node); }
};

// Level 0 has no children, whatever a hostile block says.
inline bool canDescend(const WalkedNode& node) {
    return node.key.level > 0 && !node.block->isLeaf(node.ref.node);
}

// Edge of a level's cells in index units.
inline double cellEdge(int level) { return double(std::uint64_t(1) << level); }
// Low corner and edge of a node's region in index space.
inline double nodeEdge(const NodeKey& key, BrickShape shape) {
    return shape.edge_cells * cellEdge(key.level);
}
inline glm::dvec3 nodeLow(const NodeKey& key, BrickShape shape) {
    return glm::dvec3(key.x, key.y, key.z) * nodeEdge(key, shape);
}

template <class Descend, class Emit>
class OctreeWalk {
public:
    OctreeWalk(const PagedChannel& channel, const IndexRay& ray, Descend& descend, Emit& emit)
        : channel_(channel), ray_(ray), descend_(descend), emit_(emit) {}

    // Up to eight roots meet at the origin; where they do not cover the ray, the field is background.
    bool roots(RaySpan span) {
        // Front to back: sorted by where the ray enters; a handful.
        WalkedNode nodes[8];
        int count = 0;
        for (std::size_t i = 0; i < channel_.roots().size() && i < 8; ++i) {
            WalkedNode node;
            node.key = channel_.roots()[i];
            node.ref = {0, std::uint32_t(i)};
            node.span = clipTo(node.key, span);
            if (node.span.empty()) continue;
            int at = count++;
            for (; at > 0 && nodes[at - 1].span.begin > node.span.begin; --at) nodes[at] = nodes[at - 1];
            nodes[at] = node;
        }
        double t = span.begin;
        for (int i = 0; i < count; ++i) {
            if (t < nodes[i].span.begin && !background({t, nodes[i].span.begin})) return false;
            if (!visit(nodes[i])) return false;
            t = nodes[i].span.end;
        }
        return t >= span.end || background({t, span.end});
    }

    // REQUIRES: `parent` is not a leaf.
    bool children(const WalkedNode& parent) {
        const ChildrenRef first = parent.block->children(parent.ref.node);
        if (!channel_.block(first.block)) {
            WalkedNode missing = parent;
            missing.status = WalkStatus::kMissingBlock;
            missing.missing_block = first.block;
            return emit_(missing);
        }
        const unsigned valid = parent.block->validMask(parent.ref.node);
        // The ray begins in one octant and changes it where it crosses a middle plane: four octants at most.
        const glm::dvec3 middle =
            nodeLow(parent.key, channel_.shape()) + 0.5 * nodeEdge(parent.key, channel_.shape());
        double crossing[3];
        int octant = 0;
        for (int a = 0; a < 3; ++a) {
            crossing[a] =
                ray_.parallel[a] ? std::numeric_limits<double>::infinity() : ray_.planeAt(a, middle[a]);
            const bool behind = crossing[a] <= parent.span.begin;
            const bool upper =
                ray_.parallel[a] ? ray_.origin[a] >= middle[a] : behind == (ray_.direction[a] > 0);
            if (behind) crossing[a] = std::numeric_limits<double>::infinity();
            if (upper) octant |= 1 << a;
        }
        double t = parent.span.begin;
        while (t < parent.span.end) {
            const int a = crossing[0] < crossing[1] ? (crossing[0] < crossing[2] ? 0 : 2)
                                                    : (crossing[1] < crossing[2] ? 1 : 2);
            const double end = std::min(crossing[a], parent.span.end);
            if (t < end) {
                WalkedNode child;
                child.span = {t, end};
                if (!(valid >> octant & 1)) {
                    if (!background(child.span)) return false;
                } else {
                    child.key = parent.key.child(octant);
                    const unsigned before = valid & ((1u << octant) - 1);
                    child.ref = {first.block, first.first + std::uint32_t(__builtin_popcount(before))};
                    if (!visit(child)) return false;
                }
                t = end;
            }
            crossing[a] = std::numeric_limits<double>::infinity();
            octant ^= 1 << a;
        }
        return true;
    }

private:
    RaySpan clipTo(const NodeKey& key, RaySpan span) const {
        const glm::dvec3 low = nodeLow(key, channel_.shape());
        return ray_.clip(low, low + glm::dvec3(nodeEdge(key, channel_.shape())), span);
    }
    bool background(RaySpan span) {
        WalkedNode none;
        none.status = WalkStatus::kBackground;
        none.span = span;
        return emit_(none);
    }
    bool visit(WalkedNode& node) {
        node.block = channel_.block(node.ref.block);
        if (!node.block) {
            node.status = WalkStatus::kMissingBlock;
            node.missing_block = node.ref.block;
            return emit_(node);
        }
        if (node.ref.node >= node.block->nodeCount())
            return true;  // a block that lies about its roots: nothing there
        if (canDescend(node) && descend_(static_cast<const WalkedNode&>(node))) return children(node);
        return emit_(node);
    }

    const PagedChannel& channel_;
    const IndexRay& ray_;
    Descend& descend_;
    Emit& emit_;
};

// From the roots. `descend(node)` decides for each inner node whether to go on to its children; `emit(node)`
// gets what the ray uses, front to back, and ends the walk by returning false. The spans tile `span`.
template <class Descend, class Emit>
void walkOctree(const PagedChannel& channel, const IndexRay& ray, RaySpan span, Descend descend, Emit emit) {
    OctreeWalk<Descend, Emit>(channel, ray, descend, emit).roots(span);
}

// The children of one node. REQUIRES: it is not a leaf, and node.block is set.
template <class Emit>
void walkChildren(const PagedChannel& channel, const IndexRay& ray, const WalkedNode& node, Emit emit) {
    auto stay = [](const WalkedNode&) { return false; };
    OctreeWalk<decltype(stay), Emit>(channel, ray, stay, emit).children(node);
}

}  // namespace brickyard

// The picture that the resident pages make: at every point the finest resident brick above it is drawn, whole
// before draft, so each page that arrives shows at once and none waits for its siblings. A level may be
// skipped: a brick can be resident where its parent's is not. Where a node has a resident page anywhere below
// it, its octants without a child are drawn as the background and its leaves of one value as that value:
// there topology is exact. (DESIGN.md, section 8: a miss renders the nearest resident ancestor.)
//
// Immutable once made: any thread. Made anew after pages have arrived or gone.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "client/cpu/octree_walk.h"
#include "client/paged_channel.h"
#include "core/page_address.h"

namespace brickyard {

enum class Residency : std::uint8_t { kNone, kDraft, kWhole };

class ResidentTree {
public:
    using Resident = std::function<bool(const PageAddress&)>;

    // One byte a node of the blocks that have arrived; asks `resident` twice a node at most, in the order of
    // blocks and nodes. Keeps neither argument.
    ResidentTree(const PagedChannel& channel, const Resident& resident);

    // kWhole for a node of one value. REQUIRES: the node's block had arrived.
    Residency at(const NodeRef& ref) const { return Residency(nodes_[ref.block][ref.node] & 3u); }
    // Whether a descendant's page is resident.
    bool below(const NodeRef& ref) const { return (nodes_[ref.block][ref.node] & kBelow) != 0; }

private:
    static constexpr std::uint8_t kBelow = 4;
    std::vector<std::vector<std::uint8_t>> nodes_;  // by block, by node; no nodes where it was missing
};

// A stretch of a ray and whose page draws it.
struct DrawnPiece {
    // kNode: `residency` of node's brick is drawn, or its one value where it has no brick; kBackground; or
    // kMissingBlock: nothing above the stretch is resident, not even a root.
    WalkStatus status = WalkStatus::kNode;
    Residency residency = Residency::kNone;
    WalkedNode node;  // its span is the node's own, as far as the ray was walked; `span` is the stretch
    RaySpan span;
};

template <class Emit>
class DrawnWalk {
public:
    DrawnWalk(const PagedChannel& channel, const ResidentTree& tree, const IndexRay& ray, Emit& emit)
        : channel_(channel), tree_(tree), ray_(ray), emit_(emit) {}

    void root(const WalkedNode& node) { visit(node, DrawnPiece{WalkStatus::kMissingBlock, {}, {}, {}}); }

private:
    void visit(const WalkedNode& node, const DrawnPiece& above) {
        if (node.status != WalkStatus::kNode) {
            DrawnPiece piece = above;
            if (node.status == WalkStatus::kBackground) piece.status = WalkStatus::kBackground;
            piece.span = node.span;
            emit_(piece);
            return;
        }
        DrawnPiece piece = above;
        if (const Residency residency = tree_.at(node.ref); residency != Residency::kNone)
            piece = {WalkStatus::kNode, residency, node, {}};
        piece.span = node.span;
        if (!canDescend(node) || !tree_.below(node.ref)) {
            emit_(piece);
            return;
        }
        walkChildren(channel_, ray_, node, [&](const WalkedNode& child) {
            visit(child, piece);
            return true;
        });
    }

    const PagedChannel& channel_;
    const ResidentTree& tree_;
    const IndexRay& ray_;
    Emit& emit_;
};

// Calls emit(const DrawnPiece&) for the pieces of `span`, front to back; they tile it.
template <class Emit>
void walkDrawn(const PagedChannel& channel, const ResidentTree& tree, const IndexRay& ray, RaySpan span,
               Emit emit) {
    DrawnWalk<Emit> walk(channel, tree, ray, emit);
    walkOctree(
        channel, ray, span, [](const WalkedNode&) { return false; },
        [&](const WalkedNode& root) {
            walk.root(root);
            return true;
        });
}

}  // namespace brickyard

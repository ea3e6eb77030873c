// Many packets of rays through the octree at once, node by node in an order that is front to back for each of
// them: a brick is in the processor's cache while all rays that meet it pass. Reads only the topology; one
// thread per walk.
//
// The order is by octant, nearest to the eye (or against the common direction of parallel rays) first. A ray
// crosses each of a node's middle planes once at most and away from the eye, so it meets the octants in that
// order.
#pragma once

#include <vector>

#include "client/cpu/octree_walk.h"
#include "client/cpu/packet_kernel.h"
#include "client/cpu/tile_cut.h"

namespace brickyard {

// What the rays of a walk have in common, in index space.
struct FrontToBack {
    enum class Kind { kFromPoint, kParallel } kind = Kind::kFromPoint;
    glm::dvec3 vector{0};  // the common origin, or the common direction

    // The octant around `middle` that comes first; bit a is set for the upper side of axis a.
    unsigned nearest(const glm::dvec3& middle) const {
        unsigned octant = 0;
        for (int a = 0; a < 3; ++a)
            if (kind == Kind::kFromPoint ? vector[a] >= middle[a] : vector[a] < 0) octant |= 1u << a;
        return octant;
    }
};

// Places of packets in the array that is walked.
struct PacketList {
    const std::uint16_t* places = nullptr;
    std::size_t count = 0;
    const std::uint16_t* begin() const { return places; }
    const std::uint16_t* end() const { return places + count; }
};

template <class Descend, class Emit>
class PacketWalk {
public:
    PacketWalk(const PagedChannel& channel, std::span<const RayPacket> packets, const FrontToBack& order,
               Descend& descend, Emit& emit)
        : channel_(channel), packets_(packets), order_(order), descend_(descend), emit_(emit) {}

    void roots() {
        std::vector<std::uint16_t> all(packets_.size());
        for (std::size_t i = 0; i < all.size(); ++i) all[i] = std::uint16_t(i);
        const std::vector<NodeKey>& roots = channel_.roots();
        const unsigned nearest = order_.nearest(glm::dvec3(0));
        for (unsigned k = 0; k < 8; ++k)
            for (std::size_t i = 0; i < roots.size() && i < 8; ++i) {
                const unsigned octant = unsigned(roots[i].x >= 0) | unsigned(roots[i].y >= 0) << 1 |
                                        unsigned(roots[i].z >= 0) << 2;
                if ((octant ^ nearest) != k) continue;
                WalkedNode root;
                root.key = roots[i];
                root.ref = {0, std::uint32_t(i)};
                visit(root, {all.data(), all.size()});
            }
    }

    // REQUIRES: `parent` is not a leaf, and parent.block is set.
    void children(const WalkedNode& parent, PacketList list) {
        const ChildrenRef first = parent.block->children(parent.ref.node);
        if (!channel_.block(first.block)) {
            WalkedNode missing = parent;
            missing.status = WalkStatus::kMissingBlock;
            missing.missing_block = first.block;
            emit_(missing, list);
            return;
        }
        const unsigned valid = parent.block->validMask(parent.ref.node);
        const double half = 0.5 * nodeEdge(parent.key, channel_.shape());
        const unsigned nearest = order_.nearest(nodeLow(parent.key, channel_.shape()) + half);
        for (unsigned k = 0; k < 8; ++k) {
            const unsigned octant = nearest ^ k;
            if (!(valid >> octant & 1)) continue;
            WalkedNode child;
            child.key = parent.key.child(int(octant));
            child.ref = {first.block,
                         first.first + std::uint32_t(__builtin_popcount(valid & ((1u << octant) - 1)))};
            visit(child, list);
        }
    }

private:
    void visit(WalkedNode& node, PacketList from) {
        const glm::dvec3 low = nodeLow(node.key, channel_.shape());
        const glm::dvec3 high = low + nodeEdge(node.key, channel_.shape());
        // Lists of the nodes on the way down lie one behind the other.
        const std::size_t depth = depth_++;
        if (lists_.size() <= depth) lists_.emplace_back(packets_.size());
        PacketList list{lists_[depth].data(), clipPackets(packets_.data(), from.places, from.count, &low[0],
                                                          &high[0], lists_[depth].data())};
        if (list.count > 0) reach(node, list);
        --depth_;
    }
    void reach(WalkedNode& node, PacketList list) {
        node.block = channel_.block(node.ref.block);
        if (!node.block) {
            node.status = WalkStatus::kMissingBlock;
            node.missing_block = node.ref.block;
            emit_(node, list);
        } else if (node.ref.node < node.block->nodeCount()) {  // else: a block that lies about its roots
            const PacketMask down = canDescend(node) ? descend_(static_cast<const WalkedNode&>(node)) : 0;
            std::uint16_t stay[kMostTilePackets], go[kMostTilePackets];
            std::size_t stays = 0, goes = 0;
            for (std::uint16_t packet : list) (down & maskOf(packet) ? go[goes++] : stay[stays++]) = packet;
            if (stays > 0) emit_(static_cast<const WalkedNode&>(node), PacketList{stay, stays});
            if (goes > 0) children(node, {go, goes});
        }
    }

    const PagedChannel& channel_;
    std::span<const RayPacket> packets_;
    const FrontToBack& order_;
    Descend& descend_;
    Emit& emit_;
    std::vector<std::vector<std::uint16_t>> lists_;
    std::size_t depth_ = 0;
};

// `descend(node)` gives the packets that go on to the children of an inner node that a live ray meets;
// `emit(node, packets)` gets the others, and all packets of nodes without children and of those whose block
// is missing (WalkedNode::span is not set). It may shorten the packets' live parts. REQUIRES: at most
// kMostTilePackets packets.
template <class Descend, class Emit>
void walkPackets(const PagedChannel& channel, std::span<const RayPacket> packets, const FrontToBack& order,
                 Descend descend, Emit emit) {
    PacketWalk<Descend, Emit>(channel, packets, order, descend, emit).roots();
}

}  // namespace brickyard

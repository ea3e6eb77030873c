// Which nodes of the octree the packets of a tile use: the inner nodes that give way to their children, and
// the leaves whose whole brick takes their draft's place. Each packet has a cut of its own, so that one ray
// that asks for more does not make the whole tile walk finer cells. Plain value.
#pragma once

#include <cstdint>
#include <unordered_map>

#include "client/cpu/octree_walk.h"

namespace brickyard {

// A set of packets of one tile.
using PacketMask = std::uint64_t;
inline constexpr std::size_t kMostTilePackets = 64;
inline constexpr PacketMask kAllPackets = ~PacketMask(0);
inline PacketMask maskOf(std::uint16_t packet) { return PacketMask(1) << packet; }

class TileCut {
public:
    // All leaves, whole, for every packet.
    static TileCut finest() {
        TileCut cut;
        cut.finest_ = true;
        return cut;
    }
    // Packets for which the node's children take its place. REQUIRES: canDescend(node).
    PacketMask descends(const WalkedNode& node) const { return finest_ ? kAllPackets : in(split_, node.ref); }
    // Packets that draw the draft of the node's brick.
    PacketMask usesDraft(const WalkedNode& node) const {
        return finest_ || !node.record().hasDraft() ? 0 : ~in(whole_, node.ref);
    }
    void split(const NodeRef& node, PacketMask packets) { split_[keyOf(node)] |= packets; }
    void useWhole(const NodeRef& node, PacketMask packets) { whole_[keyOf(node)] |= packets; }

private:
    using Masks = std::unordered_map<std::uint64_t, PacketMask>;
    static std::uint64_t keyOf(const NodeRef& ref) { return std::uint64_t(ref.block) << 32 | ref.node; }
    static PacketMask in(const Masks& masks, const NodeRef& ref) {
        const auto found = masks.find(keyOf(ref));
        return found == masks.end() ? 0 : found->second;
    }
    bool finest_ = false;
    Masks split_, whole_;
};

}  // namespace brickyard

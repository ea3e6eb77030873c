#include "core/node_key.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <vector>

namespace brickyard {
namespace {

TEST(NodeKeyTest, EveryChildFindsItsParent) {
    for (const NodeKey& parent : {NodeKey{1, 0, 0, 0}, NodeKey{5, -1, -2, 3}, NodeKey{31, -1, 0, -1}})
        for (int octant = 0; octant < 8; ++octant) {
            EXPECT_EQ(parent.child(octant).parent(), parent);
            EXPECT_EQ(parent.child(octant).octant(), octant);
        }
}

TEST(NodeKeyTest, MessagesShowLevelAndCoordinates) {
    EXPECT_EQ(toString(NodeKey{2, -1, 0, 3}), "L2(-1,0,3)");
}

// Bits of the three coordinates, sign flipped, highest first, z before y before x.
std::vector<int> interleaved(const NodeKey& key) {
    std::vector<int> bits;
    for (int b = 31; b >= 0; --b)
        for (const std::int32_t v : {key.z, key.y, key.x})
            bits.push_back(int((std::uint32_t(v) ^ 0x80000000u) >> b & 1));
    return bits;
}

TEST(NodeKeyTest, MortonOrderIsThatOfInterleavedBits) {
    std::mt19937 random(1);
    for (int i = 0; i < 20000; ++i) {
        // Small ranges as well, so that ties in one or two axes are common.
        const int shift = int(random() % 31);
        const auto coordinate = [&] { return std::int32_t(random()) >> shift; };
        const NodeKey a{0, coordinate(), coordinate(), coordinate()},
            b{0, coordinate(), coordinate(), coordinate()};
        ASSERT_EQ(mortonLess(a, b), interleaved(a) < interleaved(b)) << toString(a) << " " << toString(b);
        ASSERT_FALSE(mortonLess(a, a));
    }
}

TEST(NodeKeyTest, ChildrenInOctantOrderAreInMortonOrder) {
    const NodeKey parent{3, -1, 0, -2};
    for (int octant = 0; octant + 1 < 8; ++octant)
        EXPECT_TRUE(mortonLess(parent.child(octant), parent.child(octant + 1))) << octant;
}

}  // namespace
}  // namespace brickyard

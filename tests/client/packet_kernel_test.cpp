// What a kernel makes of a ray does not depend on which other rays are in its packet: those that were blocked
// by a missing page go on later, beside others or alone, and the picture has to be the same.
#include "client/cpu/packet_kernel.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

namespace brickyard {
namespace {

constexpr int kRays = RayPacket::kRays;
constexpr int kEdge = 8, kSamples = kEdge + 1;

class PacketKernelTest : public testing::Test {
protected:
    PacketKernelTest() : samples_(kSamples * kSamples * kSamples) {
        // Of all magnitudes: what comes late in a sum may be the most of it.
        for (float& sample : samples_) sample = std::exp2(uniform(-24, 0));
        brick_.samples = samples_.data();
        brick_.edge_samples = kSamples;
        for (int a = 0; a < 3; ++a) brick_.box_end[a] = kEdge;
    }
    float uniform(float low, float high) { return std::uniform_real_distribution<float>(low, high)(random_); }
    // Through the brick, anyhow: long ways beside short ones.
    RayPacket somePacket() {
        RayPacket packet;
        for (int lane = 0; lane < kRays; ++lane) {
            IndexRay ray;
            for (int a = 0; a < 3; ++a) {
                const double from = double(uniform(-4, 12)), to = double(uniform(0.5f, 7.5f));
                ray.origin[a] = from;
                ray.direction[a] = (to - from) / 8 + 1e-3;
                ray.inverse[a] = 1 / ray.direction[a];
            }
            packet.set(lane, ray, {0, 16});
        }
        return packet;
    }
    PacketSpans spansOf(const RayPacket& packet, int only = -1) const {
        const double low[3] = {0, 0, 0}, high[3] = {kEdge, kEdge, kEdge};
        PacketSpans spans;
        clipPacket(packet, low, high, spans);
        for (int lane = 0; lane < kRays && only >= 0; ++lane)
            if (lane != only) spans.end[lane] = -1;
        return spans;
    }

    std::mt19937 random_{1};
    std::vector<float> samples_;
    BrickCells brick_;
};

// Of some ten thousand rays a few end with a compensated sum that adding zeros, while a neighbour goes on,
// moves by a bit.
TEST_F(PacketKernelTest, ARayAloneHasTheIntegralThatItHasAmongOthers) {
    CornerQuads quads;
    for (int round = 0; round < 4000; ++round) {
        const RayPacket packet = somePacket();
        double together[kRays] = {};
        brick_.quads = nullptr;
        integrateBrick(packet, brick_, spansOf(packet), together);
        for (int lane = 0; lane < kRays; ++lane) {
            double alone[kRays] = {};
            brick_.quads = lane % 2 == 0 ? quads.of(brick_) : nullptr;
            integrateBrick(packet, brick_, spansOf(packet, lane), alone);
            ASSERT_EQ(alone[lane], together[lane]) << "round " << round << ", lane " << lane;
        }
    }
}

TEST_F(PacketKernelTest, ARayAloneScattersWhatItScattersAmongOthers) {
    const int points = 3;
    std::vector<float> depths(4 * points * points * points);
    for (float& depth : depths) depth = uniform(0, 2);
    LightCells light;
    light.quads = depths.data();
    for (int a = 0; a < 3; ++a) light.points[a] = points, light.per_cell[a] = float(points - 1) / kEdge;
    for (int round = 0; round < 2000; ++round) {
        const RayPacket packet = somePacket();
        PacketScatter together, alone;
        scatterInBrick(packet, brick_, light, spansOf(packet), /*scale=*/0.3, together);
        for (int lane = 0; lane < kRays; ++lane) {
            scatterInBrick(packet, brick_, light, spansOf(packet, lane), /*scale=*/0.3, alone);
            ASSERT_EQ(alone.depth[lane], together.depth[lane]) << "round " << round << ", lane " << lane;
            ASSERT_EQ(alone.weight[lane], together.weight[lane]) << "round " << round << ", lane " << lane;
            ASSERT_EQ(alone.passed[lane], together.passed[lane]) << "round " << round << ", lane " << lane;
        }
    }
}

}  // namespace
}  // namespace brickyard

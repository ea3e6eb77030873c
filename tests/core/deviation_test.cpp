#include "core/deviation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

namespace brickyard {
namespace {

constexpr BrickShape kShape{8};

std::vector<double> randomSamples(std::mt19937& random) {
    std::vector<double> samples(kShape.samples());
    for (double& v : samples) v = std::uniform_real_distribution(-1.0, 2.0)(random);
    return samples;
}

double interpolate(const std::vector<double>& samples, double x, double y, double z) {
    const int c[3] = {std::min(int(x), 7), std::min(int(y), 7), std::min(int(z), 7)};
    const double t[3] = {x - c[0], y - c[1], z - c[2]};
    double sum = 0;
    for (int q = 0; q < 8; ++q)
        sum += ((q & 1) ? t[0] : 1 - t[0]) * ((q & 2) ? t[1] : 1 - t[1]) * ((q & 4) ? t[2] : 1 - t[2]) *
               samples[kShape.sampleAt(c[0] + (q & 1), c[1] + (q >> 1 & 1), c[2] + (q >> 2))];
    return sum;
}

// Visits the level-0 samples of a closed part of a node: position in the node's cells, index in the part.
template <class Visit>
void forSamples(const NodeKey& node, const NodeKey& part, Visit&& visit) {
    const int edge = 8 << part.level;
    const double step = std::ldexp(1.0, -node.level);
    const int down = node.level - part.level;
    const double begin[3] = {(part.x - (node.x << down)) * double(edge) * step,
                             (part.y - (node.y << down)) * double(edge) * step,
                             (part.z - (node.z << down)) * double(edge) * step};
    for (int k = 0; k <= edge; ++k)
        for (int j = 0; j <= edge; ++j)
            for (int i = 0; i <= edge; ++i)
                visit(begin[0] + i * step, begin[1] + j * step, begin[2] + k * step, i, j, k,
                      i < edge && j < edge && k < edge);
}

struct Direct {
    double largest = 0, squares = 0;
};

// A region of one value is measured by a closed form: it must say what its samples say one by one.
TEST(DeviationTest, AUniformRegionEqualsTheSumOverItsSamples) {
    std::mt19937 random(3);
    const NodeKey node{3, -1, 0, 2};
    for (int level = 0; level < 3; ++level)
        for (int trial = 0; trial < 4; ++trial) {
            const std::vector<double> samples = randomSamples(random);
            const int side = 1 << (node.level - level);
            auto inside = [&](int at) {
                return at * side + std::uniform_int_distribution(0, side - 1)(random);
            };
            const NodeKey part{level, inside(node.x), inside(node.y), inside(node.z)};
            Direct direct;
            forSamples(node, part, [&](double x, double y, double z, int, int, int, bool owned) {
                const double d = interpolate(samples, x, y, z) - 0.7;
                direct.largest = std::max(direct.largest, std::abs(d));
                if (owned) direct.squares += d * d;
            });
            DeviationPart measured;
            addUniformDeviation(node, samples, part, 0.7, kShape, 1, measured);
            NodeDeviation whole;
            whole.merge(measured);
            const double volume = std::pow(8.0 * 8, 3);
            EXPECT_NEAR(whole.largest(), direct.largest, 1e-12) << toString(part);
            EXPECT_NEAR(whole.rms(node, kShape, 1), std::sqrt(direct.squares / volume), 1e-12)
                << toString(part);
        }
}

TEST(DeviationTest, ABrickEqualsTheSumOverItsSamples) {
    std::mt19937 random(4);
    for (int level = 1; level <= 4; ++level)
        for (int trial = 0; trial < 4; ++trial) {
            const NodeKey node{level, 0, -1, 1};
            const std::vector<double> samples = randomSamples(random), source = randomSamples(random);
            const int side = 1 << level;
            auto inside = [&](int at) {
                return at * side + std::uniform_int_distribution(0, side - 1)(random);
            };
            const NodeKey part{0, inside(node.x), inside(node.y), inside(node.z)};
            Direct direct;
            forSamples(node, part, [&](double x, double y, double z, int i, int j, int k, bool owned) {
                const double d = interpolate(samples, x, y, z) - source[kShape.sampleAt(i, j, k)];
                direct.largest = std::max(direct.largest, std::abs(d));
                if (owned) direct.squares += d * d;
            });
            DeviationPart measured;
            addBrickDeviation(node, samples, part, source, kShape, 1, measured);
            NodeDeviation whole;
            whole.merge(measured);
            EXPECT_NEAR(whole.largest(), direct.largest, 1e-12) << toString(part);
            EXPECT_NEAR(whole.rms(node, kShape, 1),
                        std::sqrt(direct.squares / std::pow(std::ldexp(8.0, level), 3)), 1e-12)
                << toString(part);
        }
}

// A region of 2^40 samples takes as long as one of eight.
TEST(DeviationTest, HugeRegionsAreMeasuredWithoutTheirSamples) {
    const NodeKey node{24, 0, 0, 0};
    const std::vector<double> ones(kShape.samples(), 1.0);
    DeviationPart measured;
    addUniformDeviation(node, ones, {23, 1, 1, 1}, 0, kShape, 1, measured);
    NodeDeviation whole;
    whole.merge(measured);
    EXPECT_DOUBLE_EQ(whole.largest(), 1);
    EXPECT_NEAR(whole.rms(node, kShape, 1), std::sqrt(1.0 / 8), 1e-9);
}

}  // namespace
}  // namespace brickyard

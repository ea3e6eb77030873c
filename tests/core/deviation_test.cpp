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
    for (int level = 1; level <= 3; ++level)
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
            addBrickDeviation(node, samples, part, wholeCube(source.data(), 9), kShape, 1, measured);
            NodeDeviation whole;
            whole.merge(measured);
            EXPECT_NEAR(whole.largest(), direct.largest, 1e-12) << toString(part);
            EXPECT_NEAR(whole.rms(node, kShape, 1),
                        std::sqrt(direct.squares / std::pow(std::ldexp(8.0, level), 3)), 1e-12)
                << toString(part);
        }
}

// Level 0 over a node of level 2 is 64 bricks of random samples. A node of level 4 is measured through that
// node's residual alone, and one of level 6 through that of the one of level 4.
TEST(DeviationTest, HigherLevelsAreMeasuredThroughTheResidualOfLowerOnes) {
    std::mt19937 random(5);
    const NodeKey low{2, 5, -3, 9};
    const std::vector<double> low_samples = randomSamples(random);
    std::vector<CellResidual> residual(kShape.cells());
    std::vector<std::pair<NodeKey, std::vector<double>>> bricks;
    for (int octant = 0; octant < 8; ++octant)
        for (int below = 0; below < 8; ++below) {
            const NodeKey key = low.child(octant).child(below);
            bricks.emplace_back(key, randomSamples(random));
            addBrickResidual(low, wholeCube(low_samples.data(), 9), key,
                             wholeCube(bricks.back().second.data(), 9), kShape, 1, residual);
        }
    const auto direct = [&](const NodeKey& node, const std::vector<double>& samples) {
        Direct sum;
        for (const auto& [key, source] : bricks)
            forSamples(node, key, [&](double x, double y, double z, int i, int j, int k, bool owned) {
                const double d = interpolate(samples, x, y, z) - source[kShape.sampleAt(i, j, k)];
                sum.largest = std::max(sum.largest, std::abs(d));
                if (owned) sum.squares += d * d;
            });
        return sum;
    };
    const auto expectMeasured = [&](const NodeKey& node, const std::vector<double>& samples,
                                    const MeasuredBrick& part) {
        DeviationPart measured;
        addMeasuredDeviation(node, samples, part, kShape, 1, measured);
        NodeDeviation whole;
        whole.merge(measured);
        const Direct expected = direct(node, samples);
        const double volume = std::pow(std::ldexp(8.0, node.level), 3);
        EXPECT_NEAR(whole.rms(node, kShape, 1), std::sqrt(expected.squares / volume),
                    1e-12 * std::sqrt(expected.squares / volume));
        EXPECT_GE(whole.largest(), expected.largest);
        EXPECT_LE(whole.largest(), 3 * expected.largest);
    };
    const NodeKey middle = low.parent().parent();
    const std::vector<double> middle_samples = randomSamples(random);
    const MeasuredBrick part{low, wholeCube(low_samples.data(), 9), residual};
    expectMeasured(middle, middle_samples, part);

    // Of the node in the middle only what lies over `low` has a residual: the rest of it counts as without
    // error.
    std::vector<CellResidual> above(kShape.cells());
    addMeasuredResidual(middle, wholeCube(middle_samples.data(), 9), part, kShape, 1, above);
    double squares = 0;
    for (const CellResidual& cell : above) squares += cell.squares;
    EXPECT_NEAR(squares, direct(middle, middle_samples).squares, 1e-9 * squares);
    const NodeKey high = middle.parent().parent();
    const std::vector<double> high_samples = randomSamples(random);
    // The whole of `middle` is measured, so what has no level 0 here has to be taken off: it is the field of
    // `middle`.
    std::vector<CellResidual> none(kShape.cells());
    DeviationPart with, without;
    addMeasuredDeviation(high, high_samples, {middle, wholeCube(middle_samples.data(), 9), above}, kShape, 1,
                         with);
    addMeasuredDeviation(high, high_samples, {middle, wholeCube(middle_samples.data(), 9), none}, kShape, 1,
                         without);
    Direct over_low = direct(high, high_samples), field_over_low;
    for (const auto& [key, source] : bricks)
        forSamples(high, key, [&](double x, double y, double z, int i, int j, int k, bool owned) {
            if (!owned) return;
            const double at[3] = {double(key.x * 8 + i) / 16 - middle.x * 8.0,
                                  double(key.y * 8 + j) / 16 - middle.y * 8.0,
                                  double(key.z * 8 + k) / 16 - middle.z * 8.0};
            const double d =
                interpolate(high_samples, x, y, z) - interpolate(middle_samples, at[0], at[1], at[2]);
            field_over_low.squares += d * d;
        });
    double difference = 0;
    for (int b = 0; b < with.count; ++b) difference += with.boxes[std::size_t(b)].squares;
    for (int b = 0; b < without.count; ++b) difference -= without.boxes[std::size_t(b)].squares;
    EXPECT_NEAR(difference, over_low.squares - field_over_low.squares, 1e-9 * over_low.squares);
}

// A uniform region leaves the same residual as bricks that say the same one by one.
TEST(DeviationTest, AUniformRegionLeavesTheResidualOfItsSamples) {
    std::mt19937 random(6);
    const NodeKey node{3, 0, 1, -1};
    const std::vector<double> samples = randomSamples(random), constant(kShape.samples(), 0.25);
    const NodeKey part = node.child(5).child(2);
    std::vector<CellResidual> once(kShape.cells()), piecewise(kShape.cells());
    addUniformResidual(node, wholeCube(samples.data(), 9), part, 0.25, kShape, 1, once);
    for (int octant = 0; octant < 8; ++octant)
        addBrickResidual(node, wholeCube(samples.data(), 9), part.child(octant),
                         wholeCube(constant.data(), 9), kShape, 1, piecewise);
    for (std::size_t i = 0; i < once.size(); ++i) {
        EXPECT_NEAR(once[i].squares, piecewise[i].squares, 1e-9);
        EXPECT_NEAR(once[i].largest, piecewise[i].largest, 1e-12);
        for (std::size_t q = 0; q < 8; ++q) EXPECT_NEAR(once[i].moments[q], piecewise[i].moments[q], 1e-9);
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

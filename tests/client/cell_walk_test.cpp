#include "client/cpu/cell_walk.h"

#include <gtest/gtest.h>

#include <random>

namespace brickyard {
namespace {

double cubic(const double* c, double s) { return c[0] + s * (c[1] + s * (c[2] + s * c[3])); }

// A sum over so many midpoints that it is right to the tolerance, sign changes and all.
double midpointPositive(const double* c) {
    constexpr int kSteps = 200000;
    double sum = 0;
    for (int i = 0; i < kSteps; ++i) sum += std::max(0.0, cubic(c, (i + 0.5) / kSteps));
    return sum / kSteps;
}

TEST(PositiveCubicTest, IsSplitAtItsRoots) {
    const double cases[][4] = {
        {1, 0, 0, 0},      {-1, 0, 0, 0},           {-0.5, 1, 0, 0}, {0.5, -1, 0, 0},  {1, -4, 4, 0},
        {0.06, -1, 5, -4}, {-0.03, 0.8, -2.4, 1.7}, {-1, 6, -6, 0},  {1e-9, -1, 1, 0}, {-1e30, 3e30, 0, 0},
        {0, 0, 0, 1},      {0, 1, -3, 2},
    };
    for (const auto& c : cases) {
        const double exact =
            integratePositiveCubic(cubic(c, 0), cubic(c, 1.0 / 3), cubic(c, 2.0 / 3), cubic(c, 1));
        const double size = std::abs(c[0]) + std::abs(c[1]) + std::abs(c[2]) + std::abs(c[3]);
        EXPECT_NEAR(exact, midpointPositive(c), 2e-9 * size)
            << c[0] << " " << c[1] << " " << c[2] << " " << c[3];
    }
}

TEST(MeanPositiveTest, TwoGaussPointsAreExactThroughATrilinearCell) {
    std::mt19937 random(1);
    std::uniform_real_distribution<double> unit(0, 1);
    for (int trial = 0; trial < 20; ++trial) {
        Cell cell;
        for (double& v : cell.corner) v = unit(random) + (trial % 2 ? 0 : -0.5);
        const glm::dvec3 from(unit(random), unit(random), unit(random)),
            to(unit(random), unit(random), unit(random));
        constexpr int kSteps = 20000;
        double sum = 0;
        for (int i = 0; i < kSteps; ++i)
            sum += std::max(0.0, cell.at(from + (to - from) * ((i + 0.5) / kSteps)));
        EXPECT_NEAR(meanPositive(cell, from, to), sum / kSteps, 1e-7);
    }
}

// The steps of a walk must tile the span whatever the ray: axis-parallel, through edges and corners,
// backwards.
TEST(WalkCellsTest, TilesTheSpanAlongAnyRay) {
    const BrickShape shape{8};
    std::vector<float> samples(shape.samples());
    std::mt19937 random(2);
    for (float& v : samples) v = std::uniform_real_distribution(0.1f, 1.0f)(random);
    NodeRecord record;
    record.box_end.fill(8);
    const NodeKey key{1, -1, 0, 2};  // region [-16, 0) x [0, 16) x [32, 48)
    const glm::dvec3 targets[] = {{-8, 8, 40}, {-16, 0, 32}, {-7.3, 2.9, 44.1}, {-8, 8, 40.5}};
    const glm::dvec3 ways[] = {{1, 0, 0}, {0, -1, 0},  {0, 0, 1},        {1, 1, 0},
                               {1, 1, 1}, {-1, 1, -1}, {0.3, -0.7, 0.2}, {1e-9, 1, 0}};
    for (const glm::dvec3& target : targets)
        for (const glm::dvec3& way : ways) {
            const glm::dvec3 direction = glm::normalize(way);
            const IndexRay ray({target - 100.0 * direction, direction}, Affine());
            const RaySpan span = ray.clip({-16, 0, 32}, {0, 16, 48}, {0, 1e9});
            if (span.empty()) continue;
            double t = span.begin;
            walkCells(
                samples.data(), shape, key, record, ray, span,
                [&](const Cell&, const glm::dvec3& from, const glm::dvec3& to, double begin, double end) {
                    EXPECT_EQ(begin, t);
                    EXPECT_LT(begin, end);
                    for (int a = 0; a < 3; ++a) {
                        // Cells have an edge of 2 here.
                        EXPECT_NEAR((to - from)[a], direction[a] * (end - begin) / 2, 1e-9);
                    }
                    t = end;
                });
            EXPECT_EQ(t, span.end) << "the last cells are lost";
        }
}

}  // namespace
}  // namespace brickyard

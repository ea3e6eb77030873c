#include "core/level_reduction.h"

#include <gtest/gtest.h>

#include <random>

namespace brickyard {
namespace {

constexpr int kEdge = 8, kFine = 2 * kEdge + 3, kCoarse = kEdge + 1;

std::vector<double> fineFrom(double (*value)(double, double, double)) {
    std::vector<double> fine;
    for (int k = -1; k < kFine - 1; ++k)
        for (int j = -1; j < kFine - 1; ++j)
            for (int i = -1; i < kFine - 1; ++i) fine.push_back(value(i, j, k));
    return fine;
}

std::vector<double> reduced(const std::vector<double>& fine) {
    std::vector<double> coarse(std::size_t(kCoarse * kCoarse * kCoarse));
    reduceLevel(wholeCube(fine.data(), kFine), {kCoarse, kCoarse, kCoarse},
                {coarse.data(), kCoarse, kCoarse * kCoarse});
    return coarse;
}

TEST(LevelReductionTest, ALinearFieldIsKeptExactlyAndLosesNothing) {
    const std::vector<double> fine =
        fineFrom([](double x, double y, double z) { return 1 + 2 * x - 3 * y + 0.5 * z; });
    const std::vector<double> coarse = reduced(fine);
    for (int k = 0; k < kCoarse; ++k)
        for (int j = 0; j < kCoarse; ++j)
            for (int i = 0; i < kCoarse; ++i)
                EXPECT_DOUBLE_EQ(coarse[std::size_t((k * kCoarse + j) * kCoarse + i)], 1 + 4 * i - 6 * j + k);
    EXPECT_NEAR(reductionRms(wholeCube(fine.data(), kFine).from(1, 1, 1), wholeCube(coarse.data(), kCoarse),
                             kEdge, 1),
                0, 1e-12);
}

// Full weighting spreads a sample over the coarse lattice without losing any of it: 8 fine cells make a
// coarse one.
TEST(LevelReductionTest, TheIntegralOfAnInnerSampleIsKept) {
    for (int shift = 0; shift < 8; ++shift) {
        std::vector<double> fine(std::size_t(kFine * kFine * kFine));
        const int x = 8 + (shift & 1), y = 8 + (shift >> 1 & 1), z = 8 + (shift >> 2);
        fine[std::size_t((z * kFine + y) * kFine + x)] = 1;
        double sum = 0;
        for (double v : reduced(fine)) sum += v;
        EXPECT_DOUBLE_EQ(8 * sum, 1) << shift;
    }
}

TEST(LevelReductionTest, NeighboursAgreeOnTheirSharedFace) {
    std::mt19937 random(5);
    const int wide = 4 * kEdge + 3;
    std::vector<double> row(std::size_t(wide * kFine * kFine));
    for (double& v : row) v = std::uniform_real_distribution(-1.0, 1.0)(random);
    std::vector<double> left, right;
    for (int k = 0; k < kFine; ++k)
        for (int j = 0; j < kFine; ++j)
            for (int i = 0; i < kFine; ++i) {
                left.push_back(row[std::size_t((k * kFine + j) * wide + i)]);
                right.push_back(row[std::size_t((k * kFine + j) * wide + i + 2 * kEdge)]);
            }
    const std::vector<double> a = reduced(left), b = reduced(right);
    for (int k = 0; k < kCoarse; ++k)
        for (int j = 0; j < kCoarse; ++j)
            EXPECT_EQ(a[std::size_t((k * kCoarse + j) * kCoarse + kEdge)],
                      b[std::size_t((k * kCoarse + j) * kCoarse)]);
}

}  // namespace
}  // namespace brickyard

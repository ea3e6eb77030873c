#include "core/sample_type.h"

#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <limits>

#include "core/half.h"

namespace brickyard {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

TEST(SampleTypeTest, IntegersRoundAndSaturate) {
    EXPECT_EQ(toDouble(SampleType::kInt32, fromDouble(SampleType::kInt32, -3.7)), -4);
    EXPECT_EQ(toDouble(SampleType::kInt32, fromDouble(SampleType::kInt32, 1e20)), 2147483647.0);
    EXPECT_EQ(toDouble(SampleType::kInt32, fromDouble(SampleType::kInt32, -1e20)), -2147483648.0);
    EXPECT_EQ(std::int64_t(fromDouble(SampleType::kInt64, 0x1p63)), std::numeric_limits<std::int64_t>::max());
    EXPECT_EQ(std::int64_t(fromDouble(SampleType::kInt64, -kInfinity)),
              std::numeric_limits<std::int64_t>::min());
    EXPECT_EQ(fromDouble(SampleType::kInt64, std::nan("")), 0u);
}

TEST(SampleTypeTest, BitsAreZeroExtended) {
    EXPECT_EQ(fromDouble(SampleType::kInt32, -1), 0xffffffffu);
    EXPECT_EQ(fromDouble(SampleType::kFloat32, -0.0), 0x80000000u);
    EXPECT_EQ(fromDouble(SampleType::kBool, 0.25), 1u);
}

TEST(SampleTypeTest, FloatsForRenderersAreFinite) {
    constexpr float kMax = std::numeric_limits<float>::max();
    EXPECT_EQ(toFloat(SampleType::kFloat64, std::bit_cast<ValueBits>(1e300)), kMax);
    EXPECT_EQ(toFloat(SampleType::kFloat64, std::bit_cast<ValueBits>(-kInfinity)), -kMax);
    EXPECT_EQ(toFloat(SampleType::kFloat32, 0x7f800000u), kMax);
    EXPECT_EQ(toFloat(SampleType::kFloat32, 0x7fc00000u), 0);
    EXPECT_EQ(toDouble(SampleType::kFloat32, fromDouble(SampleType::kFloat32, 1e300)), double(kMax));
}

// 2^54 + 2^30 + 1 lies just above the middle of two floats; by way of double it would be rounded to the lower
// one.
TEST(SampleTypeTest, A64BitIntegerIsRoundedOnce) {
    const std::int64_t value = (std::int64_t(1) << 54) + (std::int64_t(1) << 30) + 1;
    EXPECT_EQ(toFloat(SampleType::kInt64, ValueBits(value)), 0x1p54f + 0x1p31f);
}

TEST(HalfTest, EveryFiniteHalfSurvivesTheWayToFloatAndBack) {
    for (unsigned bits = 0; bits < 0x10000; ++bits) {
        if ((bits & 0x7fff) >= 0x7c00) continue;
        const float value = floatFromHalf(std::uint16_t(bits));
        const int exponent = int(bits >> 10 & 31);
        const double fraction = double(bits & 1023) / 1024;
        const double expected =
            (bits & 0x8000 ? -1 : 1) *
            (exponent == 0 ? std::ldexp(fraction, -14) : std::ldexp(1 + fraction, exponent - 15));
        ASSERT_EQ(double(value), expected) << bits;
        ASSERT_TRUE(isHalf(value)) << bits;
        ASSERT_EQ(halfFromFloat(value), bits);
    }
}

TEST(HalfTest, NeighboursOfHalvesAreNone) {
    for (unsigned bits = 0; bits < 0x10000; ++bits) {
        if ((bits & 0x7fff) >= 0x7c00) continue;
        const float value = floatFromHalf(std::uint16_t(bits));
        ASSERT_FALSE(isHalf(std::nextafter(value, 1e30f))) << bits;
        ASSERT_FALSE(isHalf(std::nextafter(value, -1e30f))) << bits;
    }
    EXPECT_FALSE(isHalf(65536.0f));
    EXPECT_FALSE(isHalf(std::numeric_limits<float>::infinity()));
    EXPECT_FALSE(isHalf(std::numeric_limits<float>::quiet_NaN()));
}

TEST(HalfTest, OrderedFormSortsAsNumbersDo) {
    const float rising[] = {-float(kInfinity), -1e30f, -1.0f, -1e-45f, -0.0f, 0.0f, 1e-45f, 1.0f, 1e30f,
                            float(kInfinity)};
    for (std::size_t i = 0; i + 1 < std::size(rising); ++i)
        EXPECT_LT(orderedFromBits(std::bit_cast<std::uint32_t>(rising[i])),
                  orderedFromBits(std::bit_cast<std::uint32_t>(rising[i + 1])));
    for (unsigned bits = 0; bits < 0x10000; ++bits)
        ASSERT_EQ(bitsFromOrdered(orderedFromBits(std::uint16_t(bits))), bits);
}

}  // namespace
}  // namespace brickyard

#include "client/shading/black_body.h"

#include <gtest/gtest.h>

#include <cmath>
#include <utility>

namespace brickyard {
namespace {

double luminance(const glm::dvec3& c) { return 0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z; }

// CIE x and y of linear sRGB.
std::pair<double, double> chromaticity(const glm::dvec3& c) {
    const double x = 0.4124564 * c.x + 0.3575761 * c.y + 0.1804375 * c.z;
    const double y = 0.2126729 * c.x + 0.7151522 * c.y + 0.0721750 * c.z;
    const double z = 0.0193339 * c.x + 0.1191920 * c.y + 0.9503041 * c.z;
    return {x / (x + y + z), y / (x + y + z)};
}

TEST(BlackBodyTest, LuminanceIsOneWhereItIsAskedToBe) {
    for (const double kelvin : {1000.0, 1500.0, 2000.0, 6500.0, 20000.0})
        EXPECT_NEAR(luminance(BlackBody(kelvin).radiance(kelvin)), 1, 0.01) << kelvin;
}

// Where no component is clipped, the Planckian locus is where the tables of the 1931 observer have it.
TEST(BlackBodyTest, ItsColoursLieOnThePlanckianLocus) {
    const BlackBody body(3000);
    const double known[][3] = {{2000, 0.5267, 0.4133},
                               {2856, 0.4476, 0.4074},
                               {4000, 0.3805, 0.3768},
                               {6500, 0.3135, 0.3237},
                               {10000, 0.2807, 0.2884}};
    for (const auto& [kelvin, x, y] : known) {
        const auto found = chromaticity(body.radiance(kelvin));
        EXPECT_NEAR(found.first, x, 0.005) << kelvin;
        EXPECT_NEAR(found.second, y, 0.005) << kelvin;
    }
    const glm::dvec3 white = BlackBody(6500).radiance(6500);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(white[c], 1, 0.08) << "component " << c;
    const glm::dvec3 orange = BlackBody(1500).radiance(1500);
    EXPECT_GT(orange.x, 3 * orange.y) << "more red than yellow";
    EXPECT_GT(orange.y, 0.3);
    EXPECT_EQ(orange.z, 0) << "outside sRGB, and clipped";
}

// Wien's law at 600 nm alone would say a factor of 14 from 1500 to 1800 kelvin.
TEST(BlackBodyTest, BrightnessRisesAsPlanckSays) {
    const BlackBody body(1500);
    double before = 0;
    for (double kelvin = 600; kelvin <= 40000; kelvin += 37) {
        const double now = luminance(body.radiance(kelvin));
        EXPECT_GT(now, before) << kelvin;
        before = now;
    }
    EXPECT_NEAR(luminance(body.radiance(1800)), 14, 2);
    // Where it is hot, one wave length in the middle of what is seen tells.
    const auto planck = [](double kelvin) { return 1 / std::expm1(1.438776877e7 / 560 / kelvin); };
    EXPECT_NEAR(luminance(body.radiance(40000)) / luminance(body.radiance(30000)),
                planck(40000) / planck(30000), 0.02);
}

TEST(BlackBodyTest, NeitherColdNorNotANumberGlowsAndHeatHasAnEnd) {
    const BlackBody body(1500);
    for (const double kelvin : {-5.0, 0.0, 1.0, std::nan("")})
        EXPECT_EQ(body.radiance(kelvin), glm::dvec3(0)) << kelvin;
    EXPECT_LT(luminance(body.radiance(500)), 1e-9);
    EXPECT_EQ(body.radiance(1e9), body.radiance(40000));
    EXPECT_EQ(body.radiance(HUGE_VAL), body.radiance(40000));
}

}  // namespace
}  // namespace brickyard

#include "client/shading/environment_map.h"

#include <gmock/gmock.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <numbers>
#include <random>

#include "client/picture.h"
#include "frame_fixture.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

constexpr double kPi = std::numbers::pi;

// A sky with a gradient, a small sun and a black stretch.
std::vector<glm::vec3> skyTexels(std::uint32_t width, std::uint32_t height) {
    std::vector<glm::vec3> texels;
    for (std::uint32_t y = 0; y < height; ++y)
        for (std::uint32_t x = 0; x < width; ++x) {
            const float down = float(y) / float(height);
            glm::vec3 texel(0.2f + 0.1f * down, 0.3f, 0.9f - 0.6f * down);
            if (y > height * 3 / 4) texel = glm::vec3(0);
            texels.push_back(texel);
        }
    texels[std::size_t(height / 4) * width + width / 3] = glm::vec3(900, 800, 600);
    return texels;
}

EnvironmentMap sky() { return {skyTexels(32, 16), 32, {0.3, 0.4, 0.9}, 25}; }

// Radiance integrated over the sphere: texels are constant, so their solid angles give it exactly.
glm::dvec3 integral(const std::vector<glm::vec3>& texels, std::uint32_t width) {
    const std::uint32_t height = std::uint32_t(texels.size()) / width;
    glm::dvec3 sum(0);
    for (std::uint32_t y = 0; y < height; ++y)
        for (std::uint32_t x = 0; x < width; ++x)
            sum += glm::dvec3(texels[std::size_t(y) * width + x]) *
                   (std::cos(kPi * y / height) - std::cos(kPi * (y + 1) / height)) * 2.0 * kPi /
                   double(width);
    return sum;
}

glm::dvec3 uniformDirection(std::mt19937_64& random) {
    std::uniform_real_distribution<double> unit(0, 1);
    const double z = 1 - 2 * unit(random), angle = 2 * kPi * unit(random), r = std::sqrt(1 - z * z);
    return {r * std::cos(angle), r * std::sin(angle), z};
}

TEST(EnvironmentMapTest, PicksAreDistributedAsTheirDensitySays) {
    std::mt19937_64 random(1);
    std::uniform_real_distribution<double> unit(0, 1);
    for (const EnvironmentMap& map : {sky(), EnvironmentMap(glm::dvec3(0.2, 0.5, 3))}) {
        // The mean of radiance / density over picks is the integral, of each component.
        glm::dvec3 estimate(0), uniform(0);
        double densities = 0;
        constexpr int kPicks = 200000;
        for (int i = 0; i < kPicks; ++i) {
            const EnvironmentMap::Pick pick = map.pick(unit(random), unit(random));
            ASSERT_GT(pick.density, 0);
            ASSERT_NEAR(glm::length(pick.direction), 1, 1e-12);
            EXPECT_EQ(map.radiance(pick.direction), pick.radiance);
            EXPECT_NEAR(map.density(pick.direction), pick.density, 1e-12 * pick.density);
            estimate += pick.radiance / pick.density / double(kPicks);
            const glm::dvec3 anywhere = uniformDirection(random);
            densities += map.density(anywhere) * 4 * kPi / kPicks;
            uniform += map.radiance(anywhere) * 4.0 * kPi / double(kPicks);
        }
        EXPECT_NEAR(densities, 1, 0.1) << "the density does not integrate to 1";
        for (int c = 0; c < 3; ++c)
            EXPECT_NEAR(estimate[c], uniform[c], 0.1 * uniform[c]) << "component " << c;
    }
}

TEST(EnvironmentMapTest, TheDensityIntegratesToOneExactlyOverTheTexels) {
    const std::uint32_t width = 32, height = 16;
    const EnvironmentMap map(skyTexels(width, height), width, {0, 0, 1}, 0);
    double sum = 0;
    for (std::uint32_t y = 0; y < height; ++y)
        for (std::uint32_t x = 0; x < width; ++x) {
            const double top = std::cos(kPi * y / height), bottom = std::cos(kPi * (y + 1) / height);
            const double z = 0.5 * (top + bottom), r = std::sqrt(1 - z * z);
            const double angle = (0.5 - (x + 0.5) / width) * 2 * kPi;
            sum +=
                map.density({r * std::cos(angle), r * std::sin(angle), z}) * (top - bottom) * 2 * kPi / width;
        }
    EXPECT_NEAR(sum, 1, 1e-12);
}

TEST(EnvironmentMapTest, ThePictureStandsAsInCycles) {
    // 4 columns, 2 rows, each its own red.
    std::vector<glm::vec3> texels;
    for (int i = 0; i < 8; ++i) texels.emplace_back(float(i + 1), 0, 0);
    const auto red = [](const EnvironmentMap& map, const glm::dvec3& direction) {
        return map.radiance(glm::normalize(direction)).x;
    };
    const EnvironmentMap z_up(texels, 4, {0, 0, 5}, 0);
    EXPECT_EQ(red(z_up, {1, 0.1, 1}), 2) << "left of the middle, above";
    EXPECT_EQ(red(z_up, {1, -0.1, 1}), 3) << "right of the middle, above";
    EXPECT_EQ(red(z_up, {1, -0.1, -1}), 7) << "right of the middle, below";
    EXPECT_EQ(red(z_up, {-1, 0.1, 1}), 1);
    EXPECT_EQ(red(z_up, {-1, -0.1, 1}), 4);
    // Turned by a quarter about up: the middle lies at +y.
    const EnvironmentMap turned(texels, 4, {0, 0, 1}, 90);
    EXPECT_EQ(red(turned, {-0.1, 1, 1}), 2);
    EXPECT_EQ(red(turned, {0.1, 1, 1}), 3);
    const EnvironmentMap y_up(texels, 4, {0, 1, 0}, 0);
    EXPECT_EQ(red(y_up, {1, 1, -0.1}), 2);
    EXPECT_EQ(red(y_up, {1, 1, 0.1}), 3);
    EXPECT_EQ(red(y_up, {1, -1, 0.1}), 7);
    EXPECT_GT(red(EnvironmentMap(texels, 4, {1, 0, 0}, 0), {1, 0.01, 0}), 0)
        << "up along the axis of reference";
}

TEST(EnvironmentMapTest, DistantLightsAddUpToTheWhole) {
    for (const std::uint32_t width : {1u, 3u, 32u}) {
        const std::vector<glm::vec3> texels =
            width == 32 ? skyTexels(32, 16) : std::vector<glm::vec3>(width, {1, 2, 3});
        const EnvironmentMap map(texels, width, {0, 1, 0}, 10);
        const glm::dvec3 whole = integral(texels, width);
        for (const std::size_t count : {1u, 2u, 7u, 24u, 64u, 5000u}) {
            const auto lights = map.distantLights(count);
            glm::dvec3 sum(0);
            for (const auto& light : lights) {
                EXPECT_NEAR(glm::length(light.to_light), 1, 1e-12);
                EXPECT_GT(light.irradiance.x, 0);
                sum += light.irradiance;
            }
            for (int c = 0; c < 3; ++c)
                EXPECT_NEAR(sum[c], whole[c], 1e-12 * whole[c]) << width << " " << count;
            EXPECT_LE(lights.size(), count);
            if (width == 32 && count <= 64) {
                EXPECT_EQ(lights.size(), count);
            }
        }
    }
    const auto even = EnvironmentMap(glm::dvec3(1, 2, 3)).distantLights(24);
    ASSERT_EQ(even.size(), 24u);
    glm::dvec3 sum(0), middle(0);
    for (const auto& light : even) sum += light.irradiance, middle += light.to_light;
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(sum[c], 4 * kPi * (c + 1), 1e-9);
    EXPECT_LT(glm::length(middle) / 24, 0.05) << "from all sides";
}

TEST(EnvironmentMapTest, CutsAreOfEqualPowerAndTheSunIsALightOfItsOwn) {
    // All the same: 16 regions within what whole texels allow.
    const EnvironmentMap flat(std::vector<glm::vec3>(256 * 128, {1, 1, 1}), 256, {0, 0, 1}, 0);
    for (const auto& light : flat.distantLights(16))
        EXPECT_NEAR(light.irradiance.x, 4 * kPi / 16, 0.1 * 4 * kPi / 16);

    const std::uint32_t width = 64, height = 32, x = 40, y = 9;
    std::vector<glm::vec3> texels(width * height, glm::vec3(0.1f));
    texels[y * width + x] = glm::vec3(5000);
    const EnvironmentMap map(texels, width, {0, 0, 1}, 0);
    const double angle = (0.5 - (x + 0.5) / width) * 2 * kPi;
    const double z = 0.5 * (std::cos(kPi * y / height) + std::cos(kPi * (y + 1) / height)),
                 r = std::sqrt(1 - z * z);
    const glm::dvec3 to_sun(r * std::cos(angle), r * std::sin(angle), z);
    const auto lights = map.distantLights(24);
    const auto strongest = std::max_element(lights.begin(), lights.end(), [](const auto& a, const auto& b) {
        return a.irradiance.x < b.irradiance.x;
    });
    EXPECT_GT(glm::dot(strongest->to_light, to_sun), 1 - 1e-9);
    EXPECT_EQ(lights.size(), 24u) << "the sky keeps its lights";
}

TEST(EnvironmentMapTest, NothingShinesInTheDark) {
    for (const EnvironmentMap& dark :
         {EnvironmentMap(glm::dvec3(0)), EnvironmentMap(std::vector<glm::vec3>(8), 4, {0, 0, 1}, 0)}) {
        EXPECT_EQ(dark.pick(0.3, 0.4).density, 0);
        EXPECT_EQ(dark.density({0, 0, 1}), 0);
        EXPECT_TRUE(dark.distantLights(24).empty());
    }
}

// Ends of the numbers included, no pick has no weight.
TEST(EnvironmentMapTest, NoPickFallsOnABlackTexel) {
    std::vector<glm::vec3> texels(64 * 32, glm::vec3(0));
    texels[5 * 64 + 0] = texels[20 * 64 + 63] = {0, 0, 1};
    const EnvironmentMap map(texels, 64, {0, 0, 1}, 0);
    for (const double u : {0.0, 1e-18, 0.5, 1 - 0x1p-53})
        for (const double v : {0.0, 1e-18, 0.5, 1 - 0x1p-53}) {
            const auto pick = map.pick(u, v);
            EXPECT_EQ(pick.radiance.z, 1) << u << " " << v;
            EXPECT_GT(pick.density, 0);
        }
}

class EnvironmentFileTest : public testing::Test {
protected:
    ScratchFolder folder_;

    std::filesystem::path write(const std::vector<glm::vec3>& texels, std::uint32_t width) {
        Picture picture(width, std::uint32_t(texels.size()) / width);
        for (std::size_t i = 0; i < texels.size(); ++i)
            for (int c = 0; c < 3; ++c) picture.pixels[i].radiance[std::size_t(c)] = texels[i][c];
        const std::filesystem::path file = folder_ / "sky.exr";
        EXPECT_TRUE(writeExr(picture, file));
        return file;
    }
};

TEST_F(EnvironmentFileTest, AFileIsReadAndScaled) {
    const auto texels = skyTexels(32, 16);
    const auto map = EnvironmentMap::read(write(texels, 32), {1, 2, 0.5}, {0, 0, 1}, 0);
    ASSERT_TRUE(map) << map.error().message;
    glm::dvec3 sum(0);
    for (const auto& light : map->distantLights(24)) sum += light.irradiance;
    const glm::dvec3 expected = integral(texels, 32) * glm::dvec3(1, 2, 0.5);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(sum[c], expected[c], 1e-6 * expected[c]);
}

TEST_F(EnvironmentFileTest, WhatIsNoLightIsRefusedInOneLine) {
    for (const float bad : {std::nanf(""), HUGE_VALF, -0.25f}) {
        auto texels = skyTexels(8, 4);
        texels[2 * 8 + 5].y = bad;
        const auto map = EnvironmentMap::read(write(texels, 8), glm::dvec3(1), {0, 0, 1}, 0);
        ASSERT_FALSE(map) << bad;
        EXPECT_EQ(map.error().code, ErrorCode::kInvalid);
        EXPECT_THAT(map.error().message, HasSubstr("texel 5, 2"));
        EXPECT_THAT(map.error().message, testing::Not(HasSubstr("\n")));
    }
    // Finite in the file, and no more when it is scaled.
    EXPECT_FALSE(EnvironmentMap::read(write({{3e38f, 0, 0}}, 1), glm::dvec3(10), {0, 0, 1}, 0));
    const auto none = EnvironmentMap::read(folder_ / "none.exr", glm::dvec3(1), {0, 0, 1}, 0);
    ASSERT_FALSE(none);
    EXPECT_EQ(none.error().code, ErrorCode::kNotFound);
    std::ofstream(folder_ / "text.exr") << "no picture";
    const auto text = EnvironmentMap::read(folder_ / "text.exr", glm::dvec3(1), {0, 0, 1}, 0);
    ASSERT_FALSE(text);
    EXPECT_EQ(text.error().code, ErrorCode::kCorrupt);
}

// A header is all that is read of it.
TEST_F(EnvironmentFileTest, AHugePictureIsRefusedBeforeItTakesMemory) {
    const auto file = write(skyTexels(8, 4), 8);
    std::string bytes = readFile(file);
    // dataWindow: name, type, length, then xMin yMin xMax yMax.
    const std::size_t at = bytes.find("dataWindow") + std::string("dataWindow\0box2i\0", 17).size() + 4;
    for (const std::size_t corner : {at + 8, at + 12})
        bytes[corner + 1] = char(0x40);  // 16 thousand each way
    bytes.append(1 << 17, '\0');         // where its table of lines would be
    std::ofstream(file, std::ios::binary) << bytes;
    const auto map = EnvironmentMap::read(file, glm::dvec3(1), {0, 0, 1}, 0);
    ASSERT_FALSE(map);
    EXPECT_THAT(map.error().message, HasSubstr("2^26"));
}

}  // namespace
}  // namespace brickyard

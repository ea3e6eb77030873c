#include "client/shading/color_ramp.h"

#include <gmock/gmock.h>

#include <cmath>

#include "client/scene.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

Ramp rampOf(const std::string& json) {
    const auto scene = readScene(R"({"medium":{"color_ramp":)" + json + "}}");
    EXPECT_TRUE(scene) << scene.error().message;
    return scene ? scene->medium().color_ramp() : Ramp();
}

void expectNear(const glm::dvec3& a, const glm::dvec3& b, double tolerance) {
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(a[c], b[c], tolerance) << "component " << c;
}

TEST(ColorRampTest, IsLinearBetweenItsPointsAndConstantBeyondThem) {
    const ColorRamp ramp({{1, {0, 0, 4}}, {2, {1, 0, 2}}, {4, {3, 8, 0}}});
    expectNear(ramp.at(1.25), {0.25, 0, 3.5}, 1e-12);
    expectNear(ramp.at(3), {2, 4, 1}, 1e-12);
    expectNear(ramp.at(-7), {0, 0, 4}, 0);
    expectNear(ramp.at(1e300), {3, 8, 0}, 0);
    expectNear(ramp.at(std::nan("")), {0, 0, 4}, 0);
    for (const ColorRamp::Point& point : ramp.points()) expectNear(ramp.at(point.value), point.color, 1e-12);
}

TEST(ColorRampTest, NothingInAnIntervalIsAboveItsMost) {
    const ColorRamp ramp({{0, {0, 0, 0}}, {1, {0, 5, 0}}, {2, {1, 0, 0}}, {3, {0, 0, 2}}});
    for (double low = -1; low < 4; low += 0.3)
        for (double high = low; high < 4; high += 0.3) {
            const double most = ramp.most(low, high);
            double seen = 0;
            for (int i = 0; i <= 1000; ++i) {
                const glm::dvec3 c = ramp.at(low + (high - low) * i / 1000);
                seen = std::max({seen, c.x, c.y, c.z});
            }
            EXPECT_GE(most, seen) << low << " " << high;
            EXPECT_NEAR(most, seen, 0.02) << "is more than there is, " << low << " " << high;
        }
}

// Matplotlib's own numbers, sRGB, at places between ours.
TEST(ColorRampTest, NamedMapsAreMatplotlibsInLinearLight) {
    const struct {
        const char* name;
        double at;
        glm::dvec3 srgb;
    } known[] = {
        {"viridis", 0.0, {0.267004, 0.004874, 0.329415}},  {"viridis", 0.25, {0.229739, 0.322361, 0.545706}},
        {"viridis", 0.75, {0.369214, 0.788888, 0.382914}}, {"viridis", 1.0, {0.993248, 0.906157, 0.143936}},
        {"magma", 0.25, {0.316654, 0.07169, 0.48538}},     {"magma", 0.75, {0.98693, 0.529346, 0.382051}},
        {"magma", 1.0, {0.987053, 0.991438, 0.749504}}};
    for (const auto& entry : known) {
        SCOPED_TRACE(std::string(entry.name) + " at " + std::to_string(entry.at));
        glm::dvec3 linear;
        for (int c = 0; c < 3; ++c)
            linear[c] = entry.srgb[c] <= 0.04045 ? entry.srgb[c] / 12.92
                                                 : std::pow((entry.srgb[c] + 0.055) / 1.055, 2.4);
        expectNear(ColorRamp(namedColors(entry.name)).at(entry.at), linear, 0.02);
    }
    EXPECT_TRUE(namedColors("jet").empty());
}

TEST(ColorRampTest, FireGlowsFromBlackOverRedToAboveOne) {
    const ColorRamp fire(namedColors("fire"));
    expectNear(fire.at(0), {0, 0, 0}, 0);
    double before = -1;
    for (double v = 0; v <= 1; v += 0.01) {
        const glm::dvec3 c = fire.at(v);
        EXPECT_GE(c.x, c.y) << v;
        EXPECT_GE(c.y, c.z) << v;
        EXPECT_GT(c.x + c.y + c.z, before) << v;
        before = c.x + c.y + c.z;
    }
    EXPECT_GT(fire.at(0.35).x, 8 * fire.at(0.35).y) << "deep red at first";
    EXPECT_GT(fire.at(1).z, 1) << "nearly white at last, and brighter than paper";
}

TEST(ColorRampTest, APresetIsSpreadOverItsRange) {
    const auto ramp = ColorRamp::create(rampOf(R"({"preset":"grey","low":10,"high":30})"), "ramp");
    ASSERT_TRUE(ramp);
    expectNear(ramp->at(10), glm::dvec3(0), 1e-12);
    expectNear(ramp->at(25), glm::dvec3(0.75), 1e-12);
    const auto unit = ColorRamp::create(rampOf(R"({"preset":"grey"})"), "ramp");
    ASSERT_TRUE(unit);
    expectNear(unit->at(0.5), glm::dvec3(0.5), 1e-12);
}

TEST(ColorRampTest, WhatCannotBeMeantIsNamed) {
    const std::pair<const char*, const char*> cases[] = {
        {"{}", "points or a preset"},
        {R"({"preset":"jet"})", "jet"},
        {R"({"preset":"grey","points":[{"color":[1,1,1]}]})", "leave one out"},
        {R"({"preset":"grey","low":3,"high":2})", ".low"},
        {R"({"preset":"grey","high":"Infinity"})", "finite"},
        {R"({"low":1,"points":[{"color":[1,1,1]}]})", "low and high"},
        {R"({"points":[{"color":[1,1]}]})", "points[0].color"},
        {R"({"points":[{"color":[1,1,-1]}]})", "points[0].color"},
        {R"({"points":[{"color":[1,1,"NaN"]}]})", "points[0].color"},
        {R"({"points":[{"value":"NaN","color":[1,1,1]}]})", "points[0].value"},
        {R"({"points":[{"value":1,"color":[1,1,1]},{"value":1,"color":[1,1,1]}]})", "points[1].value"},
    };
    for (const auto& [json, word] : cases) {
        const auto ramp = ColorRamp::create(rampOf(json), "medium.color_ramp");
        ASSERT_FALSE(ramp) << json;
        EXPECT_THAT(ramp.error().message, HasSubstr(word)) << json;
        EXPECT_THAT(ramp.error().message, HasSubstr("scene: medium.color_ramp")) << json;
    }
}

}  // namespace
}  // namespace brickyard

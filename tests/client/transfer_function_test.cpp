#include "client/shading/transfer_function.h"

#include <gmock/gmock.h>

#include <cmath>
#include <random>

#include "client/scene.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

Transfer transferOf(const std::string& json) {
    const auto scene = readScene(R"({"medium":{"transfer":)" + json + "}}");
    EXPECT_TRUE(scene) << json << scene.error().message;
    return scene ? scene->medium().transfer() : Transfer();
}

TransferFunction spiky() {
    return TransferFunction({{-2, {1, 0, 0}, 0.1},
                             {-1, {0, 1, 0}, 0},
                             {-0.99, {0, 4, 1}, 7},  // thinner than any step
                             {-0.98, {1, 1, 1}, 0},
                             {3, {0.2, 0.5, 0.1}, 0},
                             {4, {0.9, 0, 3}, 1}});
}

// The midpoint rule, with more steps than the sharpest corner needs.
TransferFunction::Sample numericMean(const TransferFunction& transfer, double a, double b) {
    constexpr int kSteps = 400000;
    double opacity = 0;
    glm::dvec3 emission(0);
    for (int i = 0; i < kSteps; ++i) {
        const auto here = transfer.at(a + (b - a) * (i + 0.5) / kSteps);
        opacity += here.opacity / kSteps;
        emission += here.opacity * here.color / double(kSteps);
    }
    return {opacity > 0 ? emission / opacity : glm::dvec3(0), opacity};
}

void expectNear(const TransferFunction::Sample& a, const TransferFunction::Sample& b, double tolerance) {
    EXPECT_NEAR(a.opacity, b.opacity, tolerance);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(a.color[c], b.color[c], tolerance) << "component " << c;
}

TEST(TransferFunctionTest, IsLinearInsideAndNothingOutside) {
    const TransferFunction transfer({{0, {1, 0, 0}, 1}, {2, {0, 0, 4}, 3}});
    expectNear(transfer.at(0.5), {{0.75, 0, 1}, 1.5}, 1e-12);
    expectNear(transfer.at(0), {{1, 0, 0}, 1}, 1e-12);
    expectNear(transfer.at(2), {{0, 0, 4}, 3}, 1e-12);
    for (const double outside : {-1e-9, 2.0001, std::nan(""), HUGE_VAL})
        expectNear(transfer.at(outside), {}, 0);
}

TEST(TransferFunctionTest, TheMeanIsTheIntegralsWhicheverWayAndHoweverWide) {
    const TransferFunction transfer = spiky();
    const double pairs[][2] = {{-3, 5},    {-1.5, -0.985}, {-0.995, -0.9905}, {3.2, 3.7}, {-10, -1.99},
                               {3.99, 40}, {-1, 3},        {-0.99, 3.5},      {0, 1},     {5, 9}};
    for (const auto& [a, b] : pairs) {
        SCOPED_TRACE(std::to_string(a) + " to " + std::to_string(b));
        const auto expected = numericMean(transfer, a, b);
        expectNear(transfer.mean(a, b), expected, 2e-5 * std::max(1.0, expected.opacity));
        expectNear(transfer.mean(b, a), transfer.mean(a, b), 0);
    }
}

// The mean of two neighbours is the mean of their means by width: no seam where it changes over to at().
TEST(TransferFunctionTest, MeansAddUpAndGoOverIntoTheValueItself) {
    const TransferFunction transfer = spiky();
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> place(-3, 5);
    for (int i = 0; i < 2000; ++i) {
        double a = place(random), b = place(random), m = place(random);
        if (a > b) std::swap(a, b);
        m = a + (b - a) * (m + 3) / 8;
        const auto left = transfer.mean(a, m), right = transfer.mean(m, b), whole = transfer.mean(a, b);
        const double sum = (m - a) * left.opacity + (b - m) * right.opacity;
        EXPECT_NEAR(whole.opacity * (b - a), sum, 1e-12);
        for (int c = 0; c < 3; ++c)
            EXPECT_NEAR(whole.opacity * whole.color[c] * (b - a),
                        (m - a) * left.opacity * left.color[c] + (b - m) * right.opacity * right.color[c],
                        1e-12);
        for (double width : {1e-6, 1e-9, 1e-12, 1e-15, 0.0})
            if (a > -1.999 && a < 3.999) {
                EXPECT_NEAR(transfer.mean(a, a + width).opacity, transfer.at(a).opacity, 800 * width + 1e-9);
            }
    }
}

TEST(TransferFunctionTest, NothingInAnIntervalIsAboveItsMost) {
    const TransferFunction transfer = spiky();
    for (double low = -3; low < 5; low += 0.37)
        for (double high = low; high < 5; high += 0.41) {
            double seen = 0;
            for (int i = 0; i <= 2000; ++i)
                seen = std::max(seen, transfer.at(low + (high - low) * i / 2000).opacity);
            EXPECT_GE(transfer.most(low, high), seen - 1e-12) << low << " " << high;
        }
    EXPECT_EQ(transfer.most(-1, 3), 7);
    EXPECT_EQ(transfer.most(-0.5, 2), 0);
    EXPECT_EQ(transfer.most(4.1, 9), 0);
}

TEST(TransferFunctionTest, AWindowStretchesPointsAndPresets) {
    const auto points =
        TransferFunction::create(transferOf(R"({"level":100,"width":40,"points":[{"value":0,"color":[0,0,0]},
                       {"value":1,"color":[1,1,1],"opacity":2}]})"),
                                 0, 255, "t");
    ASSERT_TRUE(points) << points.error().message;
    EXPECT_NEAR(points->at(100).opacity, 1, 1e-12);
    EXPECT_EQ(points->at(79.9).opacity, 0);
    EXPECT_EQ(points->at(120.1).opacity, 0) << "points end where they end";

    for (const char* name : {"bone", "skin", "viridis", "magma", "grey"}) {
        const std::string preset = std::string(R"({"preset":")") + name + "\"";
        const auto window =
            TransferFunction::create(transferOf(preset + R"(,"level":100,"width":40})"), 0, 255, "t");
        const auto range = TransferFunction::create(transferOf(preset + "}"), 50, 250, "t");
        ASSERT_TRUE(window && range) << name;
        EXPECT_EQ(window->at(80).opacity, 0) << name;
        EXPECT_EQ(range->at(50).opacity, 0) << name;
        EXPECT_NEAR(window->at(110).opacity, range->at(200).opacity, 1e-12) << name;
        EXPECT_EQ(window->at(120).opacity, 1) << name;
        EXPECT_EQ(window->at(255).opacity, 1) << name << ": what is densest stays";
        EXPECT_EQ(range->at(250.001).opacity, 1) << name << ": a little above what was measured";
    }
    // A constant channel has no range.
    EXPECT_TRUE(TransferFunction::create(transferOf(R"({"preset":"grey"})"), 7, 7, "t"));
}

TEST(TransferFunctionTest, BoneIsIvoryAndSkinIsAShellAroundSomethingSolid) {
    const auto bone = TransferFunction::create(transferOf(R"({"preset":"bone"})"), 0, 1, "t");
    const auto skin = TransferFunction::create(transferOf(R"({"preset":"skin"})"), 0, 1, "t");
    ASSERT_TRUE(bone && skin);
    EXPECT_LT(bone->at(0.45).opacity, 0.1) << "soft tissue";
    EXPECT_GT(bone->at(0.75).opacity, 0.8);
    EXPECT_GT(bone->at(0.75).color.x, bone->at(0.75).color.z) << "ivory";
    EXPECT_GT(skin->at(0.2).opacity, 3 * skin->at(0.35).opacity) << "the shell";
    EXPECT_LT(skin->most(0, 0.4), 0.3) << "one sees through it";
    EXPECT_GT(skin->at(0.8).opacity, 0.6) << "solid";
}

TEST(TransferFunctionTest, WhatCannotBeMeantIsNamed) {
    const std::pair<const char*, const char*> cases[] = {
        {"{}", "points or a preset"},
        {R"({"preset":"jet"})", "jet"},
        {R"({"preset":"bone","points":[{"color":[1,1,1]}]})", "leave one out"},
        {R"({"preset":"bone","level":3})", ".level"},
        {R"({"preset":"bone","width":-3})", ".width"},
        {R"({"preset":"bone","level":"NaN","width":3})", ".level"},
        {R"({"preset":"bone","level":1e30,"width":1e-3})", "window"},
        {R"({"points":[{"color":[1,1]}]})", "points[0].color"},
        {R"({"points":[{"color":[1,1,-1]}]})", "points[0].color"},
        {R"({"points":[{"value":"Infinity","color":[1,1,1]}]})", "points[0].value"},
        {R"({"points":[{"color":[1,1,1],"opacity":-0.1}]})", "points[0].opacity"},
        {R"({"points":[{"color":[1,1,1],"opacity":"NaN"}]})", "points[0].opacity"},
        {R"({"points":[{"value":1,"color":[1,1,1]},{"value":0.5,"color":[1,1,1]}]})", "points[1].value"},
    };
    for (const auto& [json, word] : cases) {
        const auto transfer = TransferFunction::create(transferOf(json), 0, 1, "medium.transfer");
        ASSERT_FALSE(transfer) << json;
        EXPECT_THAT(transfer.error().message, HasSubstr(word)) << json;
        EXPECT_THAT(transfer.error().message, HasSubstr("scene: medium.transfer")) << json;
    }
}

}  // namespace
}  // namespace brickyard

// What moves: shutters, moments, and what lies between two frames.
#include <cmath>

#include "client/trace/ray_march.h"
#include "marched_pictures.h"

namespace brickyard {
namespace {

class MotionTest : public RayMarchTest {
protected:
    // A ball that moves into what is empty in its own frame.
    static constexpr double kSpeed = 21;
    // `tight`: in a box that moves with it.
    void storeMoving(std::uint32_t frame, double at, bool tight = false) {
        const Position low = tight ? Position(at) - 11 : -16, high = tight ? Position(at) + 12 : 64;
        const IndexBox box{{low, -16, -16}, {high, 17, 17}};
        const FormulaField density("density", box, [=](Position x, Position y, Position z, int) {
            const glm::dvec3 p(double(x) - at, double(y), double(z));
            return std::clamp(9 - glm::length(p), 0.0, 2.0) *
                   (1 + 0.5 * std::sin(1.3 * p.x) * std::sin(1.1 * p.y));
        });
        const FormulaField velocity(
            "velocity", {{-20, -20, -20}, {70, 21, 21}},
            [](Position, Position, Position, int c) { return c == 0 ? kSpeed : 0; }, SampleType::kFloat32, 3);
        store({&density, &velocity}, 8, frame);
    }
    RenderRequest view(double moved, const std::string& more, double scale = 0.06) const {
        return request(cameraAt({20 - moved, 10, 130}, {20 - moved, 0, 0}, 30), 24,
                       R"({"media": [{"density": "density", "velocity": "velocity", "density_scale": )" +
                           std::to_string(scale) + "}]" + more + "}");
    }
};

TEST_F(MotionTest, ABlurIsTheMeanOfWhatIsSeenDuringTheShutter) {
    storeMoving(0, 0);
    RenderRequest blurred = view(0, R"(, "shutter": {"open": 0, "close": 1})");
    blurred.samples = 256;
    const Picture picture = draw(blurred);
    Picture mean(24, 24);
    constexpr int kMoments = 32;
    for (int i = 0; i < kMoments; ++i) {
        // The camera goes the other way.
        RenderRequest still = view(kSpeed * (i + 0.5) / kMoments, "");
        still.samples = 16;
        still.seed = std::uint64_t(i);  // other places in the pixels
        const Picture moment = draw(still);
        for (std::size_t p = 0; p < mean.pixels.size(); ++p)
            mean.pixels[p].alpha += moment.pixels[p].alpha / kMoments;
    }
    double most = 0, brightest = 0;
    for (std::size_t p = 0; p < mean.pixels.size(); ++p) {
        most = std::max(most, std::abs(double(mean.pixels[p].alpha - picture.pixels[p].alpha)));
        brightest = std::max(brightest, double(mean.pixels[p].alpha));
    }
    EXPECT_GT(brightest, 0.2);
    EXPECT_LE(most, 0.015);
}

TEST_F(MotionTest, AMomentIsTheBallWhereItThenIs) {
    storeMoving(0, 0);
    for (const double time : {0.3, 0.7, 1.0}) {
        const std::string at = std::to_string(time);
        // One ray is shot in the middle of the shutter.
        const Picture moved = draw(view(0, R"(, "shutter": {"open": )" + std::to_string(time - 0.01) +
                                               R"(, "close": )" + std::to_string(time + 0.01) + "}"));
        const Picture truth = draw(view(kSpeed * time, ""));
        EXPECT_LE(worstDifference(moved, truth), 0.01) << time;
    }
}

TEST_F(MotionTest, HalfwayBetweenTwoFramesTheBallIsHalfway) {
    storeMoving(0, 0);
    storeMoving(1, kSpeed);
    for (const double between : {0.25, 0.5}) {
        auto source = openSource(folder().string(), ""), after = openSource(folder().string(), "");
        ASSERT_TRUE(source && after);
        RenderRequest asked = view(0, "");
        asked.between = between;
        asked.next = {{"", after->get(), 1, nullptr}};
        const auto advected = makeCpuRenderer()->render(**source, asked);
        ASSERT_TRUE(advected) << advected.error().message;
        EXPECT_TRUE(advected->final);
        EXPECT_LE(worstDifference(advected->picture, draw(view(kSpeed * between, ""))), 0.015) << between;
        asked.between_by = BetweenFrames::kBlend;
        const auto blended = makeCpuRenderer()->render(**source, asked);
        ASSERT_TRUE(blended) << blended.error().message;
        RenderRequest second = view(0, "");
        second.frame = 1;
        const Picture a = draw(view(0, "")), b = draw(second);
        for (std::size_t i = 0; i < a.pixels.size(); ++i) {
            const double depth = -(1 - between) * std::log1p(-double(a.pixels[i].alpha)) -
                                 between * std::log1p(-double(b.pixels[i].alpha));
            ASSERT_NEAR(double(blended->picture.pixels[i].alpha), -std::expm1(-depth), 2e-3) << i;
        }
    }
}

// It is lit there, too, and shades itself.
TEST_F(MotionTest, WhatLeavesTheBoxOfItsFrameKeepsItsShadows) {
    storeMoving(0, 0, /*tight=*/true);
    storeMoving(1, kSpeed, /*tight=*/true);
    auto picture = [&](const std::string& shadows) {
        auto source = openSource(folder().string(), ""), after = openSource(folder().string(), "");
        RenderRequest asked =
            view(0,
                 R"(, "lights": [{"direction": [-1, -0.3, 0], "irradiance": [9, 9, 9], "shadows": ")" +
                     shadows + "\"}]",
                 0.2);
        asked.quality.reference = false;
        asked.between = 0.8;
        asked.next = {{"", after->get(), 1, nullptr}};
        const auto outcome = makeCpuRenderer()->render(**source, asked);
        EXPECT_TRUE(outcome && outcome->final);
        return outcome->picture;
    };
    const Picture exact = picture("exact");
    EXPECT_GT(worstDifference(picture("none"), exact), 0.2);
    EXPECT_LE(worstDifference(picture("deep"), exact), 0.03);
}

}  // namespace
}  // namespace brickyard

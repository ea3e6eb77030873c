// From a command line to what a renderer is asked for, and from its outcome to what is told.
#include "tools/render_options.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <nlohmann/json.hpp>

#include "tools/numbered_name.h"
#include "tools/render_report.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

// `words` behind a source and an output.
Result<RenderRequest> asked(std::vector<std::string> words) {
    RenderOptions options;
    CLI::App app;
    addRenderOptions(app, options);
    words.insert(words.begin(), {"a.bricks", "-o", "a.exr"});
    std::reverse(words.begin(), words.end());
    app.parse(words);
    return requestOf(options);
}

TEST(RenderOptionsTest, PathsAreSoManyAsIsSaidOrAsTheErrorNeeds) {
    EXPECT_FALSE(asked({})->path);
    EXPECT_EQ(asked({})->samples, 1u);
    EXPECT_EQ(asked({"--spp", "7"})->samples, 7u);
    EXPECT_FALSE(asked({"--spp", "7"})->path);
    EXPECT_TRUE(asked({"--quality", "path"})->path);
    EXPECT_EQ(asked({"--quality", "path"})->samples, 64u);
    EXPECT_EQ(asked({"--quality", "path"})->quality.max_error,
              asked({"--quality", "final"})->quality.max_error);
    EXPECT_EQ(asked({"--quality", "path", "--spp", "65536"})->samples, 65536u);
    EXPECT_EQ(asked({"--quality", "path", "--max-error", "0.05"})->samples, 0u);
    EXPECT_EQ(asked({"--quality", "path", "--max-error", "0.05"})->quality.max_error, 0.05);
    EXPECT_EQ(asked({"--quality", "path", "--max-error", "0.05", "--spp", "9"})->samples, 9u);
    EXPECT_EQ(asked({"--seed", "18446744073709551615"})->seed, UINT64_MAX);
    // A regular grid is a larger picture, drawn the fast way.
    EXPECT_EQ(asked({"--samples", "4", "--size", "8x6"})->width, 16u);
    EXPECT_EQ(asked({"--samples", "4"})->samples, 1u);
}

TEST(RenderOptionsTest, NamesBecomeWhatTheySay) {
    EXPECT_EQ(asked({})->filter, std::nullopt);
    EXPECT_EQ(asked({})->shadows, std::nullopt);
    EXPECT_EQ(asked({})->between_by, BetweenFrames::kAdvect);
    EXPECT_EQ(asked({"--filter", "catmull-rom"})->filter, FieldFilter::kCatmullRom);
    EXPECT_EQ(asked({"--filter", "gaussian"})->filter, FieldFilter::kGaussian);
    EXPECT_EQ(asked({"--shadows", "deep"})->shadows, ShadowMethod::kDeepMap);
    EXPECT_EQ(asked({"--shadows", "none"})->shadows, ShadowMethod::kNone);
    EXPECT_EQ(asked({"--between", "blend"})->between_by, BetweenFrames::kBlend);
}

TEST(RenderOptionsTest, RelativeNamesBeginBesideTheScene) {
    EXPECT_EQ(sceneFolder("shots/a/scene.json"), "shots/a");
    EXPECT_EQ(sceneFolder("scene.json"), "");
    EXPECT_EQ(sceneFolder("  {\"media\": []}"), "");
}

TEST(RenderOptionsTest, ANumberTakesItsPlaceInAName) {
    EXPECT_EQ(numberedName("frame.%04d.png", 7), "frame.0007.png");
    EXPECT_EQ(numberedName("a/%d.exr", 123456), "a/123456.exr");
    EXPECT_EQ(numberedName("50%.png", 7), "50%.png");
    EXPECT_TRUE(hasNumberPlace("%d.png"));
    EXPECT_FALSE(hasNumberPlace("d.png"));
}

std::string told(const RenderOutcome& outcome, bool json) {
    testing::internal::CaptureStdout();
    EXPECT_EQ(reportPicture(outcome, "a.exr", json), 0);
    return testing::internal::GetCapturedStdout();
}

TEST(RenderReportTest, ABoundThatIsInfiniteIsNoGuarantee) {
    RenderOutcome outcome;
    outcome.picture = Picture(2, 1);
    outcome.method = "path";
    outcome.samples = 64;
    outcome.picture.pixels[1].estimate_alpha = 0.25f;
    EXPECT_THAT(told(outcome, false), HasSubstr("at most 0;"));
    outcome.picture.pixels[0].bound_radiance = std::numeric_limits<float>::infinity();
    EXPECT_THAT(told(outcome, false), HasSubstr("no guarantee"));
    const nlohmann::json json = nlohmann::json::parse(told(outcome, true));
    EXPECT_TRUE(json["max_error_bound"].is_null());
    EXPECT_TRUE(json["mean_error_bound"].is_null());
    EXPECT_EQ(json["max_alpha_error_bound"], 0);
    EXPECT_EQ(json["max_error_estimate"], 0.25);
    EXPECT_EQ(json["method"], "path");
    EXPECT_EQ(json["samples"], 64);
}

}  // namespace
}  // namespace brickyard

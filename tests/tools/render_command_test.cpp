// `brickyard render`: what its options ask for, what they refuse, and sequences.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "client/picture.h"
#include "command_run.h"
#include "core/dataset_writer.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

// Balls that grow from frame to frame.
void makeBalls(const std::filesystem::path& folder, const std::vector<std::uint32_t>& frames) {
    Manifest settings;
    settings.set_format_major(kFormatMajor);
    settings.set_brick_edge(8);
    settings.set_nonfinite("reject");
    const auto writer = DatasetWriter::open(folder, settings, ExistingDataset::kOverwrite);
    ASSERT_TRUE(writer) << writer.error().message;
    for (const std::uint32_t frame : frames) {
        const auto temporary = (*writer)->temporaryFrame(frame);
        ASSERT_TRUE(temporary) << temporary.error().message;
        const FrameEntry entry = writeBallFrame(*temporary, frame, 8 + frame);
        ASSERT_TRUE((*writer)->commitFrame(*temporary, entry));
    }
    ASSERT_TRUE((*writer)->finish());
}

class RenderCommandTest : public testing::Test {
protected:
    void SetUp() override { makeBalls(folder_ / "balls.bricks", {3, 4, 5}); }

    Outcome render(const std::vector<std::string>& arguments) {
        std::vector<std::string> all{"render", "--size", "24x20"};
        all.insert(all.end(), arguments.begin(), arguments.end());
        return runCommand(folder_.path(), all);
    }
    nlohmann::json renderJson(std::vector<std::string> arguments) {
        arguments.push_back("--json");
        const Outcome outcome = render(arguments);
        EXPECT_EQ(outcome.status, 0) << outcome.err;
        return nlohmann::json::parse(outcome.out, nullptr, false);
    }
    std::string path(const std::string& name) const { return (folder_ / name).string(); }
    std::string balls() const { return path("balls.bricks"); }
    Picture picture(const std::string& name) const {
        const Result<Picture> read = readExr(folder_ / name);
        EXPECT_TRUE(read) << read.error().message;
        return read ? *read : Picture();
    }
    static void expectSame(const Picture& a, const Picture& b, const std::string& what) {
        ASSERT_EQ(a.pixels.size(), b.pixels.size()) << what;
        for (std::size_t i = 0; i < a.pixels.size(); ++i) {
            ASSERT_EQ(a.pixels[i].radiance, b.pixels[i].radiance) << what << ", pixel " << i;
            ASSERT_EQ(a.pixels[i].alpha, b.pixels[i].alpha) << what << ", pixel " << i;
            ASSERT_EQ(a.pixels[i].bound_alpha, b.pixels[i].bound_alpha) << what << ", pixel " << i;
        }
    }

    ScratchFolder folder_;
};

TEST_F(RenderCommandTest, WrongUsageIsOneLineThatNamesTheOption) {
    const std::string out = path("a.png");
    struct Case {
        std::vector<std::string> arguments;
        std::string named;
    };
    for (const Case& c : std::vector<Case>{
             {{balls(), "-o", out, "--quality", "path", "--max-error", "0.1", "--strict"}, "--strict"},
             {{balls(), "-o", out, "--samples", "4", "--spp", "4"}, "--spp"},
             {{balls(), "-o", out, "--samples", "4", "--quality", "path"}, "--spp"},
             {{balls(), "-o", out, "--spp", "0"}, "--spp"},
             {{balls(), "-o", out, "--bounces", "-1"}, "--bounces"},
             {{balls(), "-o", out, "--bounces", "65537"}, "--bounces"},
             {{balls(), "-o", out, "--spp", "65537"}, "--spp"},
             {{balls(), "-o", out, "--frame=-1"}, "--frame"},
             {{balls(), "-o", out, "--filter", "box"}, "--filter"},
             {{balls(), "-o", out, "--shadows", "soft"}, "--shadows"},
             {{balls(), "-o", out, "--between", "guess"}, "--between"},
             {{balls(), "-o", out, "--over", "a.png"}, "--over"},
             {{balls(), "-o", out, "--frames", "3-5"}, "%04d"},
             {{balls(), "-o", path("a.%04d.png"), "--frames", "3-"}, "'3-'"},
             {{balls(), "-o", path("a.%04d.png"), "--frames", "3", "--frame", "3"}, "--frame"},
             {{balls(), "-o", path("a.%04d.png"), "--frames", "3", "--follow", "1"}, "--frames"},
             {{"-o", out}, "dataset"}}) {
        const Outcome outcome = render(c.arguments);
        EXPECT_EQ(outcome.status, 2) << c.named << ": " << outcome.err;
        EXPECT_THAT(outcome.err, HasSubstr(c.named));
        EXPECT_EQ(outcome.err.find('\n'), outcome.err.size() - 1) << outcome.err;
    }
    EXPECT_FALSE(std::filesystem::exists(out));
}

TEST_F(RenderCommandTest, AFrameThatIsNotThereIsNamedWithThoseThatAre) {
    const std::string out = path("a.%04d.exr");
    expectOneLineOf(render({balls(), "-o", out, "--frame", "5.5"}), "has no frame 6; there are 3-5");
    expectOneLineOf(render({balls(), "-o", out, "--frame", "2.5"}), "has no frame 2; there are 3-5");
    expectOneLineOf(render({balls(), "-o", out, "--frames", "3-999999999"}), "has no frame 6; there are 3-5");
    expectOneLineOf(render({balls(), "-o", out, "--frames", "4,1,9"}), "has no frame 1; there are 3-5");
    EXPECT_FALSE(std::filesystem::exists(path("a.0004.exr")));
}

TEST_F(RenderCommandTest, ASequenceIsItsFramesDrawnAlone) {
    const Outcome outcome = render(
        {balls(), "-o", path("s.%04d.exr"), "--frames", "3-5x2,4", "--quality", "reference", "--json"});
    ASSERT_EQ(outcome.status, 0) << outcome.err;
    std::istringstream lines(outcome.out);
    int objects = 0;
    for (std::string line; std::getline(lines, line); ++objects)
        EXPECT_TRUE(nlohmann::json::parse(line, nullptr, false).contains("seconds_total")) << line;
    EXPECT_EQ(objects, 3);
    for (const std::string frame : {"3", "4", "5"}) {
        renderJson({balls(), "-o", path("alone.exr"), "--frame", frame, "--quality", "reference"});
        expectSame(picture("s.000" + frame + ".exr"), picture("alone.exr"), "frame " + frame);
    }
}

TEST_F(RenderCommandTest, ASceneMayNameDatasetAndFrame) {
    writeFile(folder_ / "scene.json",
              R"({"frame": 3, "datasets": [{"name": "ball", "source": "balls.bricks", "frame_offset": 1}]})");
    renderJson({"--scene", path("scene.json"), "-o", path("scene.exr")});
    renderJson({balls(), "-o", path("four.exr"), "--frame", "4"});
    renderJson({balls(), "-o", path("five.exr"), "--frame", "5"});
    expectSame(picture("scene.exr"), picture("four.exr"), "the scene's frame");
    renderJson({"--scene", path("scene.json"), "-o", path("scene.exr"), "--frame", "4"});
    expectSame(picture("scene.exr"), picture("five.exr"), "the command line's frame");

    // The command line's dataset takes the place of the first.
    makeBalls(folder_ / "other.bricks", {4});
    renderJson({path("other.bricks"), "--scene", path("scene.json"), "-o", path("scene.exr")});
    expectSame(picture("scene.exr"), picture("four.exr"), "another dataset");
    expectOneLineOf(
        render({path("other.bricks"), "--scene", path("scene.json"), "-o", path("a.exr"), "--frame", "9"}),
        "4");
    expectOneLineOf(render({"--scene", "{}", "-o", path("a.exr")}), "nothing to draw");
    expectOneLineOf(
        render({"--scene", R"({"datasets":[{"name":"a","source":"x"},{"name":"a"}]})", "-o", path("a.exr")}),
        "'a'");
    expectOneLineOf(render({balls(), "--scene", R"({"frame": -3})", "-o", path("a.exr")}), "frame is -3");
}

TEST_F(RenderCommandTest, APictureGoesOverAnother) {
    const std::string camera = R"({"eye":[0,0,60],"target":[0,0,0],"vertical_fov_degrees":40})";
    renderJson({balls(), "-o", path("front.exr"), "--camera", camera, "--density-scale", "0.1", "--quality",
                "reference"});
    Picture image(24, 20);
    for (Pixel& p : image.pixels) {
        p.radiance = {0.25f, 0.5f, 0.125f};
        p.alpha = 1;
        p.depth = std::numeric_limits<float>::infinity();
    }
    ASSERT_TRUE(writeExr(image, folder_ / "image.exr"));
    const nlohmann::json json =
        renderJson({balls(), "-o", path("over.exr"), "--camera", camera, "--density-scale", "0.1",
                    "--quality", "reference", "--over", path("image.exr"), "--over-depth", "ray"});
    EXPECT_EQ(json["mean_alpha"], 1);
    const Picture front = picture("front.exr"), over = picture("over.exr");
    for (std::size_t i = 0; i < over.pixels.size(); ++i) {
        const Pixel &f = front.pixels[i], &o = over.pixels[i];
        // Rays that may end early are traced another way.
        EXPECT_NEAR(double(o.radiance[1]), double(f.radiance[1] + (1 - f.alpha) * 0.5f), 1e-4) << i;
        if (f.alpha > 0.01f) EXPECT_NEAR(double(o.depth), double(f.depth), 0.05) << i;
        if (f.alpha == 0) EXPECT_EQ(o.alpha, 1) << i;
    }

    ASSERT_TRUE(writeExr(Picture(20, 24), folder_ / "turned.exr"));
    expectOneLineOf(render({balls(), "-o", path("a.exr"), "--over", path("turned.exr")}), "--size 20x24");
    expectOneLineOf(render({balls(), "-o", path("a.exr"), "--over", path("image.exr")}), "--camera");
    expectOneLineOf(render({balls(), "-o", path("a.exr"), "--over", path("none.exr")}), "none.exr");
    // A regular grid and a .png go with it, and so does a sequence with one image.
    EXPECT_EQ(render({balls(), "-o", path("a.%d.png"), "--camera", camera, "--over", path("image.exr"),
                      "--samples", "4", "--frames", "3,5"})
                  .status,
              0);
    EXPECT_TRUE(std::filesystem::exists(path("a.5.png")));
}

TEST_F(RenderCommandTest, TellsHowAPictureWasMade) {
    const nlohmann::json json = renderJson({balls(), "-o", path("a.exr")});
    EXPECT_TRUE(json.contains("method"));
    EXPECT_EQ(json["samples"], 1);
    EXPECT_TRUE(json["max_error_bound"].is_number());
}

}  // namespace
}  // namespace brickyard

// From a cache on disk to a picture over a real socket, through the command: what is streamed, what is drawn,
// and that a server and a folder give the same pixels.
#include <gmock/gmock.h>
#include <png.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "frame_fixture.h"

namespace brickyard {
namespace {

const std::string kPlume = std::string(BRICKYARD_TEST_DATA) + "/plume";
const std::string kScene = " --scene '" + kPlume + "/scene.json'";

class EndToEndTest : public testing::Test {
protected:
    static void SetUpTestSuite() {
        folder_ = std::make_unique<ScratchFolder>();
        ASSERT_EQ(run("convert '" + kPlume + "'/plume.*.vdb '" + path("plume.bricks") + "'"), 0) << out_;
        // The server's first line says where it listens.
        int pipe_ends[2];
        ASSERT_EQ(::pipe(pipe_ends), 0);
        server_ = ::fork();
        if (server_ == 0) {
            ::dup2(pipe_ends[1], STDOUT_FILENO);
            ::close(pipe_ends[0]);
            ::execl(BRICKYARD_COMMAND, "brickyard", "serve", path("plume.bricks").c_str(), "--listen",
                    "127.0.0.1:0", nullptr);
            ::_exit(127);
        }
        ::close(pipe_ends[1]);
        std::string line;
        for (char c; ::read(pipe_ends[0], &c, 1) == 1 && c != '\n';) line += c;
        ::close(pipe_ends[0]);
        const std::size_t begin = line.find("ws://");
        ASSERT_NE(begin, std::string::npos) << line;
        url_ = line.substr(begin, line.find_first_of(" )", begin) - begin);
    }
    static void TearDownTestSuite() {
        if (server_ > 0) {
            ::kill(server_, SIGTERM);
            int status = 0;
            ::waitpid(server_, &status, 0);
            EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << "SIGTERM ends a server in order";
        }
        folder_.reset();
    }

    static std::string path(const std::string& name) { return (*folder_ / name).string(); }
    static int run(const std::string& arguments) {
        const std::string line = std::string("'") + BRICKYARD_COMMAND + "' " + arguments + " >'" +
                                 path("out") + "' 2>'" + path("err") + "' </dev/null";
        const int status = std::system(line.c_str());
        out_ = readFile(path("out"));
        err_ = readFile(path("err"));
        return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    }
    static nlohmann::json render(const std::string& source, const std::string& picture,
                                 const std::string& arguments) {
        EXPECT_EQ(run("render '" + source + "' -o '" + path(picture) + "' --json --frame 30 " + arguments), 0)
            << err_;
        EXPECT_EQ(err_, "");
        return nlohmann::json::parse(out_);
    }
    static std::string dataset() { return path("plume.bricks"); }

    static inline std::unique_ptr<ScratchFolder> folder_;
    static inline pid_t server_ = -1;
    static inline std::string url_, out_, err_;
};

TEST_F(EndToEndTest, AServerAndAFolderGiveTheSamePixels) {
    int picture = 0;
    for (const char* arguments :
         {"--size 96x80 --quality reference --density-scale 5",
          "--size 96x80 --max-error 0.03 --density-scale 5", "--size 40x40 --max-error 0.05"}) {
        const std::string lit = ++picture == 3 ? kScene : "";
        const nlohmann::json local = render(dataset(), "a.exr", arguments + lit);
        const nlohmann::json remote = render(url_, "b.exr", arguments + lit);
        EXPECT_TRUE(local["final"].get<bool>() && remote["final"].get<bool>());
        EXPECT_EQ(readFile(path("a.exr")), readFile(path("b.exr"))) << arguments;
        EXPECT_EQ(local["pages_streamed"], remote["pages_streamed"]);
    }
}

TEST_F(EndToEndTest, OnlyTheChannelsOfTheSceneAreStreamed) {
    std::uint64_t density_bytes = 0;
    ASSERT_EQ(run("info '" + dataset() + "' --json"), 0);
    const nlohmann::json info = nlohmann::json::parse(out_);
    for (const nlohmann::json& frame : info["frames"])
        if (frame["frame"] == 30)
            for (const nlohmann::json& channel : frame["channels"])
                if (channel["name"] == "density") density_bytes = channel["payload_bytes"];
    ASSERT_GT(density_bytes, 0u);
    // All of density, no byte of velocity, temperature, flame or shadow; a few KiB of topology.
    const nlohmann::json json = render(url_, "a.exr", "--size 64x64 --quality reference");
    EXPECT_GT(json["bytes_streamed"].get<std::uint64_t>(), density_bytes / 2);
    EXPECT_LT(json["bytes_streamed"].get<std::uint64_t>(), density_bytes + 16384);
}

TEST_F(EndToEndTest, ACameraThatLooksAwayStreamsNoBrick) {
    const nlohmann::json json = render(
        url_, "a.exr",
        R"(--size 64x64 --camera '{"eye":[1.2,-5,2],"target":[1.2,-50,2],"up":[0,0,1],"vertical_fov_degrees":40}')");
    EXPECT_EQ(json["pages_streamed"], 0);
    EXPECT_EQ(json["mean_alpha"], 0);
    EXPECT_TRUE(json["final"].get<bool>());
}

TEST_F(EndToEndTest, AFarCameraStreamsCoarseLevelsOnly) {
    const nlohmann::json json = render(
        url_, "a.exr",
        R"(--size 64x64 --camera '{"eye":[1.2,-60,2],"target":[1.2,1.2,1.6],"up":[0,0,1],"vertical_fov_degrees":40}')");
    EXPECT_GT(json["mean_alpha"].get<double>(), 0);
    EXPECT_EQ(json["pages_streamed"], 1) << "the root says all that a pixel can show";
}

TEST_F(EndToEndTest, AnErrorCostsFewerBytesThanTheReference) {
    const std::string camera = "--size 128x128 --density-scale 5 ";
    const nlohmann::json reference = render(url_, "a.exr", camera + "--quality reference");
    const nlohmann::json loose = render(url_, "b.exr", camera + "--max-error 0.03");
    EXPECT_LT(loose["bytes_streamed"].get<double>(), 0.7 * reference["bytes_streamed"].get<double>());
    EXPECT_LE(loose["max_error_estimate"].get<double>(), 0.01 + 1e-6);
    const nlohmann::json strict = render(url_, "b.exr", camera + "--max-error 0.03 --strict");
    EXPECT_LE(strict["max_error_bound"].get<double>(), 0.03 + 1e-6);
}

TEST_F(EndToEndTest, AWorkingSetTenTimesTheCacheConvergesToTheSamePicture) {
    const std::string arguments = "--size 64x64 --density-scale 5 --quality reference";
    const nlohmann::json whole = render(url_, "a.exr", arguments);
    const auto budget = whole["cache_bytes"].get<std::uint64_t>() / 10;
    const nlohmann::json tight = render(url_, "b.exr", arguments + " --cache " + std::to_string(budget));
    EXPECT_TRUE(tight["final"].get<bool>());
    EXPECT_LE(tight["cache_bytes"].get<std::uint64_t>(), budget);
    EXPECT_GT(tight["cache_reloads"].get<std::uint64_t>(), 0u);
    EXPECT_EQ(readFile(path("a.exr")), readFile(path("b.exr")));
}

std::vector<std::uint8_t> readPng(const std::string& file, unsigned& width) {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    std::vector<std::uint8_t> bytes;
    if (!png_image_begin_read_from_file(&image, file.c_str())) return bytes;
    image.format = PNG_FORMAT_RGB;
    bytes.resize(PNG_IMAGE_SIZE(image));
    png_image_finish_read(&image, nullptr, bytes.data(), 0, nullptr);
    width = image.width;
    return bytes;
}

// The golden picture was looked at before it was stored. A failure leaves the picture beside the test for
// comparison.
TEST_F(EndToEndTest, ThePlumeLooksAsItDid) {
    render(url_, "plume.png", "--size 96x96 --quality reference" + kScene);
    unsigned width = 0, golden_width = 0;
    const std::vector<std::uint8_t> picture = readPng(path("plume.png"), width);
    const std::vector<std::uint8_t> golden =
        readPng(std::string(BRICKYARD_TEST_DATA) + "/golden/plume_030.png", golden_width);
    ASSERT_EQ(width, golden_width);
    ASSERT_EQ(picture.size(), golden.size());
    int worst = 0;
    for (std::size_t i = 0; i < picture.size(); ++i)
        worst = std::max(worst, std::abs(int(picture[i]) - int(golden[i])));
    if (worst > 2) {
        const std::string kept = testing::TempDir() + "plume_030_drawn.png";
        std::filesystem::copy_file(path("plume.png"), kept,
                                   std::filesystem::copy_options::overwrite_existing);
        FAIL() << "off by " << worst << " of 255; see " << kept;
    }
}

TEST_F(EndToEndTest, ComparePassesWhatIsNearAndFailsWhatIsFar) {
    const std::string files = "'" + path("a.exr") + "' '" + path("b.exr") + "' ";
    render(dataset(), "a.exr", "--size 32x32 --density-scale 5 --quality reference");
    render(dataset(), "b.exr", "--size 32x32 --density-scale 5 --quality reference --samples 4");
    ASSERT_EQ(run("compare " + files + "--json --background 1 1 1 --max-rms 0.1"), 0) << err_;
    const double rms = nlohmann::json::parse(out_)["rms_covered"];
    EXPECT_GT(rms, 0) << "a pixel's centre is not its mean";
    EXPECT_EQ(run("compare " + files + "--background 1 1 1 --max-rms " + std::to_string(rms / 2)), 1);
    EXPECT_THAT(err_, testing::HasSubstr("is above"));
    render(dataset(), "b.exr", "--size 32x31");
    EXPECT_EQ(run("compare " + files), 1);
    EXPECT_THAT(err_, testing::HasSubstr("32 x 31"));
}

TEST_F(EndToEndTest, EveryFailureIsOneLineAndTheRightStatus) {
    const struct {
        std::string arguments;
        int status;
        const char* word;
    } cases[] = {
        {"render '" + url_ + "x' -o a.png", 1, "plumex"},
        {"render ws://127.0.0.1:1/plume -o a.png", 1, "127.0.0.1:1"},
        {"render /no/such/folder -o a.png", 1, "/no/such/folder"},
        {"render '" + dataset() + "' -o a.png --frame 7", 1, "18"},
        {"render '" + dataset() + "' -o /no/such/folder/a.png", 1, "folder"},
        {"render '" + dataset() + "' -o a.jpg", 2, ".png"},
        {"render '" + dataset() + "' -o a.png --size 0x5", 2, "--size"},
        {"render '" + dataset() + "' -o a.png --max-error 2", 2, "--max-error"},
        {"render '" + dataset() + "' -o a.png --strict", 2, "--max-error"},
        {"render '" + dataset() + "' -o a.png --samples 5", 2, "--samples"},
        {"render '" + dataset() + "' -o a.png --size 60000x1 --samples 4", 2, "--samples"},
        {"render '" + dataset() + "' -o a.png --cache 12", 1, "less than one brick"},
        {"compare /no/such.exr /no/such.exr", 1, "/no/such.exr"},
        {"render '" + dataset() + "' -o a.png --camera '{\"eye\":[0,0,0],\"target\":[0,0,0]}'", 1, "eye"},
    };
    for (const auto& c : cases) {
        EXPECT_EQ(run(c.arguments), c.status) << c.arguments << ": " << err_;
        EXPECT_EQ(out_, "");
        EXPECT_EQ(std::count(err_.begin(), err_.end(), '\n'), 1) << err_;
        EXPECT_THAT(err_, testing::HasSubstr(c.word)) << c.arguments;
    }
}

}  // namespace
}  // namespace brickyard

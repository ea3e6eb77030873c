// `brickyard bench` at a size that takes seconds: the figures are there and the promises hold. How fast
// anything is no test can say.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <png.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "tools/bench/plot.h"
#include "tools/bench/plot_axis.h"

namespace brickyard {
namespace {

using namespace nlohmann::literals;

using testing::HasSubstr;
using testing::StartsWith;
using testing::UnorderedElementsAre;

std::string readFile(const std::filesystem::path& path) {
    std::ostringstream text;
    text << std::ifstream(path, std::ios::binary).rdbuf();
    return text.str();
}

// A folder of its own for each test, gone afterwards.
class BenchTest : public testing::Test {
protected:
    void SetUp() override {
        folder_ = std::filesystem::path(testing::TempDir()) / fmt::format("bench_test.{}", getpid());
        std::filesystem::create_directories(folder_ / "scratch");
    }
    void TearDown() override { std::filesystem::remove_all(folder_); }

    // Gives the exit status. The command's temporary folders go into our own.
    int bench(const std::string& arguments) {
        const std::string line =
            fmt::format("TMPDIR='{0}/scratch' '{1}' bench {2} >'{0}/out' 2>'{0}/err' </dev/null",
                        folder_.string(), BRICKYARD_COMMAND, arguments);
        const int status = std::system(line.c_str());
        out_ = readFile(folder_ / "out");
        err_ = readFile(folder_ / "err");
        return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    }
    // `arguments` begin with the benchmark's name.
    nlohmann::json figures(const std::string& arguments) {
        const std::string name = arguments.substr(0, arguments.find(' '));
        const int status = bench(fmt::format("{} --json --size 24 --repeat 1 --data '{}/plume' --output '{}'",
                                             arguments, BRICKYARD_TEST_DATA, folder_.string()));
        EXPECT_EQ(status, 0) << err_;
        EXPECT_EQ(err_, "");
        const nlohmann::json json = nlohmann::json::parse(out_, nullptr, /*allow_exceptions=*/false);
        EXPECT_TRUE(json.is_object() && json.contains(name)) << out_;
        EXPECT_TRUE(std::filesystem::is_empty(folder_ / "scratch")) << "temporary datasets are left behind";
        return json.is_object() ? json.value(name, nlohmann::json::object()) : nlohmann::json::object();
    }

    std::filesystem::path folder_;
    std::string out_, err_;
};

TEST_F(BenchTest, RenderComparesWithPeersAndItsReferenceIsExact) {
    const nlohmann::json render = figures("render");
    ASSERT_EQ(render["views"].size(), 3u);
    for (const auto& view : render["views"]) {
        EXPECT_GT(view["median_optical_depth"].get<double>(), 0) << view["view"];
        EXPECT_EQ(view["equal_rms"].size(), 3u);
        EXPECT_TRUE(view.contains("cell_walk_over_reference"));
        EXPECT_TRUE(view["lit"].contains("vdb_render_over_reference") || view["lit"].contains("skipped"));
        for (const auto& picture : view["pictures"]) {
            EXPECT_GT(picture["seconds"].get<double>(), 0) << picture["name"];
            // Two programs that share no code agree to the rounding of a float.
            if (picture["name"] == "reference") {
                EXPECT_LT(picture["worst"].get<double>(), 1e-6);
            }
            EXPECT_EQ(picture.value("/error/bounds_broken"_json_pointer, 0), 0) << picture["name"];
        }
    }
    EXPECT_TRUE(render["summary"].contains("nanovdb_step_1_over_ours_at_equal_rms"));
}

// A finer step of the peer is nearer to the truth: it marches the same rays as the walk it is held to.
TEST_F(BenchTest, TheMarcherConvergesToTheCellWalk) {
    for (const auto& view : figures("render")["views"]) {
        std::map<std::string, double> rms;
        for (const auto& picture : view["pictures"]) rms[picture["name"]] = picture["rms"];
        EXPECT_LT(rms["NanoVDB step 0.5"], rms["NanoVDB step 2"]) << view["view"];
        EXPECT_LT(rms["NanoVDB step 0.5"], 0.01) << view["view"];
    }
}

TEST_F(BenchTest, TradeWritesItsFilesAndNoBoundBreaks) {
    const nlohmann::json trade = figures("trade");
    EXPECT_EQ(trade["calibration"]["bounds_broken"], 0);
    EXPECT_TRUE(trade["calibration"].contains("within_3_holds"));
    EXPECT_TRUE(trade["calibration"].contains("mean_estimate_holds"));
    for (const char* preset : {"draft", "preview", "final", "reference"})
        EXPECT_TRUE(trade["presets"][preset].contains("on_bytes_front")) << preset;
    EXPECT_THAT(readFile(folder_ / "trade.csv"), StartsWith("cache,view,setting,"));
    EXPECT_THAT(readFile(folder_ / "trade.svg"), HasSubstr("</svg>"));
    EXPECT_THAT(readFile(folder_ / "trade.png"), StartsWith("\x89PNG"));
}

TEST_F(BenchTest, EveryModeOfAPictureHasItsCostAndItsError) {
    const nlohmann::json trade = figures("trade --modes presets,shadows,kernels,surface,path");
    EXPECT_FALSE(trade.contains("calibration"));  // those alone
    std::set<std::string> seen;
    for (const auto& group : trade["modes"]["groups"]) {
        seen.insert(group["group"]);
        for (const auto& row : group["rows"]) {
            EXPECT_TRUE(row["final"]) << row;
            EXPECT_GT(row["seconds_over_baseline"], 0) << row;
            if (row["mode"] == "reference" && group["of"] == "alpha") EXPECT_LT(row["worst"], 1e-6) << row;
        }
    }
    EXPECT_THAT(seen, UnorderedElementsAre("presets", "shadows", "kernels", "surface", "path"));
    EXPECT_TRUE(trade["modes"]["estimates_that_fail"].is_array());
}

TEST_F(BenchTest, AZoomFlickersLessThanItsPictureChanges) {
    const nlohmann::json zoom = figures("zoom");
    ASSERT_GT(zoom["zooms"].size(), 0u);
    for (const auto& one : zoom["zooms"]) {
        EXPECT_GT(one["own_change"], 0) << one;
        if (one["mode"] == "final, fast, samples 4") EXPECT_LT(one["flicker_over_own_change"], 1) << one;
    }
    EXPECT_THAT(readFile(folder_ / "zoom.csv"), StartsWith("cache,lit,mode,frame,"));
}

TEST_F(BenchTest, PayShowsThatUnreadChannelsCostNoPage) {
    const nlohmann::json pay = figures("pay");
    ASSERT_GE(pay["features"].size(), 4u);
    EXPECT_EQ(pay["features"][0]["pages_streamed"],
              pay["absorption_of_a_dataset_of_density_alone"]["pages_streamed"]);
    for (const auto& feature : pay["features"])
        for (const char* key : {"bytes_streamed", "pages_streamed", "seconds"})
            EXPECT_TRUE(feature.contains(key)) << feature["name"] << " " << key;
}

TEST_F(BenchTest, AFlightKeepsItsBudgetAndEndsWithTheRightPicture) {
    const nlohmann::json fly = figures("fly");
    ASSERT_EQ(fly["flights"].size(), 2u);
    for (const auto& flight : fly["flights"]) {
        EXPECT_TRUE(flight["budget_holds"].get<bool>()) << flight;
        EXPECT_TRUE(flight["all_final"].get<bool>()) << flight;
        EXPECT_EQ(flight["pixels_unlike_a_fresh_picture"], 0) << flight;
        EXPECT_GT(flight["reloads"].get<int>(), 0) << "the cache was not tight: " << flight;
        EXPECT_GT(flight["hit_rate"].get<double>(), 0.1) << flight;
        EXPECT_LT(flight["heap_last_over_middle_third"].get<double>(), 1.01) << "memory leaks: " << flight;
    }
    EXPECT_THAT(readFile(folder_ / "fly.csv"), StartsWith("scene,frame,"));
}

// Whether a figure is there and is what a measurement can give.
void expectAboveZero(const nlohmann::json& object, const std::string& key) {
    ASSERT_TRUE(object.contains(key) && object[key].is_number()) << key << " of " << object;
    EXPECT_TRUE(std::isfinite(object[key].get<double>())) << key << " of " << object;
    EXPECT_GT(object[key].get<double>(), 0) << key << " of " << object;
}

void expectConversion(const nlohmann::json& program) {
    for (const char* key :
         {"seconds", "cpu_seconds", "cores_busy", "peak_bytes", "output_bytes", "output_over_input"})
        expectAboveZero(program, key);
    // No program runs in less than a megabyte, or on more processors than there could be.
    EXPECT_GT(program.value("peak_bytes", 0.0), 1e6) << program;
    EXPECT_LT(program.value("cores_busy", 0.0), 1024) << program;
}

TEST_F(BenchTest, ConvertMeasuresItselfAndThePeersThatAreInstalled) {
    const nlohmann::json convert = figures("convert");
    ASSERT_EQ(convert["caches"].size(), 1u);
    const nlohmann::json& cache = convert["caches"][0];
    expectConversion(cache["ours"]);
    EXPECT_TRUE(cache["notes"].empty()) << cache["notes"];
    for (const char* peer : {"zip", "blosc"})
        if (cache.contains(peer) && !cache[peer].contains("skipped")) {
            expectConversion(cache[peer]);
            expectAboveZero(cache, fmt::format("ours_over_{}", peer));
            expectAboveZero(cache, fmt::format("ours_over_{}_cpu", peer));
        } else {
            EXPECT_FALSE(convert["skipped"].empty()) << "left out, and nobody says why";
        }
    EXPECT_LT(cache["ours_at_error"]["output_bytes"], cache["ours"]["output_bytes"]);

    const nlohmann::json& raw = convert["raw"];
    EXPECT_EQ(raw["input_bytes"], 24 * 24 * 24 * 2);
    expectConversion(raw["ours"]);
    if (raw.contains("zstd")) {
        expectConversion(raw["zstd"]);
        expectAboveZero(raw, "ours_over_zstd");
    }
    ASSERT_GE(convert["goals"].size(), 2u);
    for (const auto& goal : convert["goals"]) {
        expectAboveZero(goal, "worst");
        expectAboveZero(goal, "limit");
        EXPECT_NE(goal["goal"], "raw_speed_over_zstd") << "held to a goal that is meant for gigabytes";
        EXPECT_EQ(goal["met"].get<bool>(), goal["worst"] <= goal["limit"]) << goal;
    }
}

TEST_F(BenchTest, CodecsAreComparedAtErrorsThatTheyKeep) {
    const nlohmann::json codec = figures("codec --brick 8");
    EXPECT_EQ(codec["brick"], 8);
    ASSERT_EQ(codec["caches"].size(), 1u);
    ASSERT_EQ(codec["caches"][0]["modes"].size(), 3u);
    for (const auto& mode : codec["caches"][0]["modes"]) {
        const double asked = mode["error_of_range"];
        std::map<std::string, double> error;
        for (const auto& it : mode["codecs"]) {
            for (const char* key :
                 {"bytes_per_sample", "of_raw", "encode_megabytes_per_second", "decode_megabytes_per_second",
                  "ours_over_it_bytes", "ours_over_it_encode_speed", "ours_over_it_decode_speed"})
                expectAboveZero(it, key);
            error[it["key"]] = it["error_over_range"];
            // A float's own rounding comes on top of what was asked for.
            EXPECT_LE(error[it["key"]], asked * 1.001) << it;
        }
        for (const char* key : {"ours", "zfp", "zfp_without_face", "blosc_lz4", "blosc_zstd", "zstd"})
            EXPECT_TRUE(error.contains(key)) << key;
        EXPECT_LE(error["zfp"], error["ours"]);
        EXPECT_EQ(error.contains("ours_at_zfp"), asked > 0);
        if (asked > 0) {
            EXPECT_LE(error["ours_at_zfp"], error["zfp"]);
            expectAboveZero(mode, "ours_at_zfp_over_zfp_bytes");
        }
    }
    // Five peers at three errors.
    EXPECT_EQ(codec["summary"].size(), 15u);
}

#ifdef BRICKYARD_WITH_SERVER
void expectSoundServer(const nlohmann::json& server) {
    EXPECT_EQ(server.value("errors", -1), 0) << server;
    EXPECT_EQ(server.value("refused", -1), 0) << server;
    expectAboveZero(server, "resident_bytes");
    expectAboveZero(server, "peak_bytes");
}

TEST_F(BenchTest, ViewersAreServedAlsoBesideIdleConnections) {
    const nlohmann::json viewers = figures("viewers --viewers 4 --seconds 1.5 --idle 30");
    const nlohmann::json& streaming = viewers["streaming"];
    EXPECT_EQ(streaming.value("errors", -1), 0) << streaming;
    expectAboveZero(streaming, "pages");
    expectAboveZero(streaming["cold_first_page_ms"], "p99");
    expectSoundServer(streaming["server"]);
    const nlohmann::json& idle = viewers["idle"];
    EXPECT_EQ(idle.value("connections", -1), 30);
    EXPECT_EQ(idle.value("alive_at_the_end", -1), 30);
    EXPECT_TRUE(idle.value("memory_holds", false));
    EXPECT_EQ(idle["viewers_beside"].value("errors", -1), 0) << idle;
    expectAboveZero(idle["viewers_beside"], "pages");
    expectSoundServer(idle["server"]);
}

TEST_F(BenchTest, TheFirstPictureTakesFewerRoundTripsWhereTheServerFindsThePages) {
    const nlohmann::json picture = figures("first-picture --delay-ms 20 --mbit 100");
    ASSERT_EQ(picture["networks"].size(), 2u);
    for (const auto& network : picture["networks"]) {
        EXPECT_GE(network["round_trip_ms_measured"].get<double>(), network["round_trip_ms"].get<double>());
        ASSERT_EQ(network["runs"].size(), 18u);  // three views, six clients
        for (const auto& run : network["runs"]) {
            expectAboveZero(run["first_picture"], "seconds");
            const std::string client = run["client"];
            if (client == "camera wish" || client.starts_with("overview")) {
                EXPECT_EQ(run["first_picture"]["round_trips"], 1) << run;
            } else {
                EXPECT_GE(run["first_picture"]["round_trips"], 3) << run;
            }
        }
    }
    expectSoundServer(picture["server"]);
}

TEST_F(BenchTest, NobodyStarvesBesideAGreedyClientAndAReplacedWishEnds) {
    const nlohmann::json fairness = figures("fairness --normal 5 --seconds 3 --mbit 50");
    for (const char* phase : {"alone", "busy", "greedy", "flood", "alone_again"}) {
        const nlohmann::json& figure = fairness["shares"][phase];
        EXPECT_EQ(figure.value("errors", -1), 0) << phase << " " << figure;
        expectAboveZero(figure, "pages");
        expectSoundServer(figure["server"]);
    }
    for (const char* greed : {"greedy", "flood"})
        expectAboveZero(fairness["shares"][greed], "greedy_wishes_per_second");
    for (const char* reader : {"reads_slowly", "slow_network"})
        expectAboveZero(fairness["current"][reader]["first_new_ms"], "p50");
}
#endif

TEST_F(BenchTest, RefusesWhatIsNotThereInOneLine) {
    EXPECT_EQ(bench("nonsense"), 2);
    EXPECT_THAT(err_, HasSubstr("--help"));
    for (const char* arguments : {"--data /nonexistent", "--output /nonexistent"}) {
        EXPECT_EQ(bench(arguments), 1);
        EXPECT_EQ(out_, "");
        EXPECT_THAT(err_, HasSubstr("/nonexistent"));
        EXPECT_EQ(err_.find('\n'), err_.size() - 1) << err_;
    }
    EXPECT_EQ(bench(fmt::format("pay --data '{}/scratch'", folder_.string())), 1);
    EXPECT_THAT(err_, HasSubstr("no .vdb files"));
}

std::vector<PlotPanel> somePanels() {
    PlotSeries line{"measured",
                    {{1, 1e-3, "", false}, {10, 1e-5, "best", true}, {100, 0, "no place", false}}};
    return {{"Left", "x", "y", true, true, {line}}, {"Right", "x", "y", false, false, {line, {"other", {}}}}};
}

TEST_F(BenchTest, APlotIsWrittenAsSvgAndAsPngOfTwiceItsWidth) {
    const std::vector<PlotPanel> panels = somePanels();
    const Result<void> written = writePlot(panels, folder_ / "plot", /*width=*/600);
    ASSERT_TRUE(written) << written.error().message;
    EXPECT_THAT(readFile(folder_ / "plot.svg"), HasSubstr("width=\"600"));
    EXPECT_THAT(readFile(folder_ / "plot.svg"), HasSubstr("</svg>"));
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    ASSERT_TRUE(png_image_begin_read_from_file(&image, (folder_ / "plot.png").c_str())) << image.message;
    EXPECT_EQ(image.width, 1200u);
    png_image_free(&image);
}

TEST_F(BenchTest, APlotThatCannotBeWrittenSaysWhere) {
    const Result<void> written = writePlot(somePanels(), folder_ / "absent" / "plot");
    ASSERT_FALSE(written);
    EXPECT_EQ(written.error().code, ErrorCode::kIo);
    EXPECT_THAT(written.error().message, HasSubstr("absent/plot.svg"));
}

TEST(PlotAxis, HoldsItsValuesAndNumbersSomeTicks) {
    for (const bool logarithmic : {false, true}) {
        for (const std::vector<double>& values : {std::vector<double>{},
                                                  {3},
                                                  {0.2, 0.3},
                                                  {1e-6, 1e3},
                                                  {0, -1, NAN, INFINITY, 5},
                                                  {1e-300, 1e300}}) {
            const PlotAxis axis(values, logarithmic);
            for (const double value : values) {
                if (!axis.shows(value)) continue;
                EXPECT_GE(axis.place(value), 0) << value;
                EXPECT_LE(axis.place(value), 1) << value;
            }
            std::size_t numbered = 0;
            for (const PlotAxis::Tick& tick : axis.ticks()) numbered += !tick.label.empty();
            EXPECT_GE(numbered, 1u) << values.size() << " values, logarithmic " << logarithmic;
            EXPECT_LT(axis.ticks().size(), 10000u);
        }
    }
}

}  // namespace
}  // namespace brickyard

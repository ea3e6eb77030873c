#include "tools/conversion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openvdb/tools/Interpolation.h>

#include "core/dataset.h"
#include "frame_fixture.h"
#include "sample_grids.h"
#include "tools/dataset_check.h"
#include "tools/field_reader.h"
#include "tools/source_check.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

const fs::path kPlume = fs::path(BRICKYARD_TEST_DATA) / "plume";

class ConversionTest : public testing::Test {
protected:
    ConversionTest() {
        openvdb::initialize();
        options_.output = scratch_ / "out.bricks";
        options_.probe_program = BRICKYARD_COMMAND;
        options_.note = [this](const std::string& note) { notes_.push_back(note); };
    }
    ConversionReport run() {
        const auto report = convert(options_);
        EXPECT_TRUE(report) << report.error().message;
        return report.value_or(ConversionReport());
    }
    std::string runToFail() {
        const auto report = convert(options_);
        EXPECT_FALSE(report);
        if (report) return {};
        EXPECT_EQ(report.error().message.find('\n'), std::string::npos);
        return report.error().message;
    }
    void write(const std::string& name, const openvdb::GridPtrVec& grids) {
        writeGrids(scratch_ / name, grids);
    }
    std::string path(const std::string& name) const { return (scratch_ / name).string(); }
    static InputOptions reading() {
        InputOptions options;
        options.probe_program = BRICKYARD_COMMAND;
        return options;
    }
    SourceReport compare(std::uint64_t points = 20'000) {
        const auto report = checkAgainst(options_.output, options_.inputs, serialFor, points, reading());
        EXPECT_TRUE(report) << report.error().message;
        if (!report) return {};
        EXPECT_EQ(report->fault_count, 0u) << report->faults.front();
        return *report;
    }
    void expectSound() {
        for (const CheckFault& fault : checkDataset(options_.output, serialFor, nullptr).faults)
            ADD_FAILURE() << fault.message;
    }
    std::string frames() const { return describeFrames(Dataset::open(options_.output)->manifest()); }

    ScratchFolder scratch_;
    ConversionOptions options_;
    std::vector<std::string> notes_;
};

TEST_F(ConversionTest, APlumeIsBitExactAndSamplesAsOpenVdbDoes) {
    options_.inputs = {(kPlume / "plume.*.vdb").string()};
    const ConversionReport report = run();
    EXPECT_EQ(report.converted, 3u);
    EXPECT_EQ(frames(), "18, 24, 30");
    expectSound();
    const SourceReport same = compare(100'000);
    EXPECT_EQ(same.worst.deviation, 0) << "error 0 is bit-exact";
    EXPECT_EQ(same.channels, 15u);
    EXPECT_EQ(same.points, 1'500'000u);
}

// Not through our own importer: OpenVDB reads the file, OpenVDB samples the grid.
TEST_F(ConversionTest, AnIndependentReadingOfTheSourceAgreesAtRandomPoints) {
    options_.inputs = {(kPlume / "plume.0030.vdb").string()};
    run();
    const auto store = Dataset::open(options_.output)->openFrame(30);
    ASSERT_TRUE(store) << store.error().message;
    openvdb::io::File file(options_.inputs[0]);
    file.open(false);
    const auto grid = openvdb::gridPtrCast<openvdb::FloatGrid>(file.readGrid("density"));
    const FieldReader reader(*store, *findChannel(**store, "density"));
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> coordinate(-40, 100);
    for (int i = 0; i < 100'000; ++i) {
        glm::dvec3 at(coordinate(random), coordinate(random), coordinate(random));
        for (int a = 0; a < 3; ++a)
            if (random() % 6 == 0) at[a] = 16 * std::round(at[a] / 16);  // borders of bricks and octants
        const float expected =
            openvdb::tools::BoxSampler::sample(grid->constTree(), openvdb::Vec3R(at.x, at.y, at.z));
        const auto value = reader.sample(at);
        ASSERT_TRUE(value) << value.error().message;
        ASSERT_NEAR((*value)[0], double(expected), 1e-6) << at.x << " " << at.y << " " << at.z;
        // World space, through both transforms.
        const glm::dvec3 world = reader.indexToWorld().point(at);
        const openvdb::Vec3d theirs = grid->indexToWorld(openvdb::Vec3d(at.x, at.y, at.z));
        ASSERT_NEAR(world.x, theirs.x(), 1e-12);
        ASSERT_NEAR(world.z, theirs.z(), 1e-12);
    }
}

TEST_F(ConversionTest, EveryTypeOfGridIsBitExactWithItsStates) {
    write("all.7.vdb", gridsOfAllTypes(3));
    options_.inputs = {path("all.7.vdb")};
    for (const int edge : {8, 16, 32, 64}) {
        options_.brick_edge = edge;
        options_.existing = ExistingDataset::kOverwrite;
        EXPECT_EQ(run().frames.at(0).channels_size(), 10);
        expectSound();
        const SourceReport same = compare(3000);
        EXPECT_EQ(same.worst.deviation, 0) << "brick edge " << edge;
    }
}

TEST_F(ConversionTest, AnErrorIsKeptAndTheOneMadeIsTheTrueOne) {
    options_.inputs = {(kPlume / "plume.0024.vdb").string()};
    options_.max_error = 0.004;
    options_.channel_errors = {{"velocity", 0.3}, {"shadow", 0}};
    const ConversionReport report = run();
    expectSound();
    for (const ChannelSummary& channel : report.frames.at(0).channels()) {
        const double bound = channel.name() == "velocity" ? 0.3 : channel.name() == "shadow" ? 0 : 0.004;
        EXPECT_EQ(channel.error_bound(), bound) << channel.name();
        EXPECT_LE(channel.error_made(), bound) << channel.name();
    }
    const SourceReport near = compare();
    double made = 0;
    for (const ChannelSummary& channel : report.frames.at(0).channels())
        made = std::max(made, channel.error_made());
    // The worst voxel of all channels is that of velocity; rounding to float may add an ulp of 80.
    EXPECT_NEAR(near.worst.deviation, made, 1e-5);
}

TEST_F(ConversionTest, ExportedGridsComeBackAsTheyWere) {
    write("all.1.vdb", gridsOfAllTypes(9));
    options_.inputs = {path("all.1.vdb")};
    run();
    const std::string exported = path("back.1.vdb");
    const std::string command = std::string("'") + BRICKYARD_COMMAND + "' export '" +
                                options_.output.string() + "' '" + exported + "' >/dev/null";
    ASSERT_EQ(std::system(command.c_str()), 0);
    const auto same = checkAgainst(options_.output, {exported}, serialFor, 1000, reading());
    ASSERT_TRUE(same) << same.error().message;
    EXPECT_EQ(same->fault_count, 0u) << same->faults.front();
}

TEST_F(ConversionTest, TheSameCommandAgainConvertsNothingAndCompletesWhatIsMissing) {
    options_.inputs = {(kPlume / "plume.0018.vdb").string()};
    EXPECT_EQ(run().converted, 1u);
    const auto written = fs::last_write_time(options_.output / "frames/000018.brk");
    options_.inputs = {(kPlume / "plume.0018.vdb").string(), (kPlume / "plume.0024.vdb").string()};
    EXPECT_EQ(run().converted, 1u);
    EXPECT_EQ(run().converted, 0u);
    EXPECT_EQ(fs::last_write_time(options_.output / "frames/000018.brk"), written);
    EXPECT_EQ(frames(), "18, 24");
}

TEST_F(ConversionTest, AddingToADatasetMustBeAskedFor) {
    options_.inputs = {(kPlume / "plume.0018.vdb").string()};
    run();
    options_.inputs = {(kPlume / "plume.0024.vdb").string()};
    EXPECT_THAT(runToFail(), HasSubstr("--append"));
    EXPECT_EQ(frames(), "18");
    options_.existing = ExistingDataset::kAppend;
    run();
    EXPECT_EQ(frames(), "18, 24");
    options_.existing = ExistingDataset::kOverwrite;
    run();
    EXPECT_EQ(frames(), "24");
}

TEST_F(ConversionTest, OtherSettingsOrSourcesAreRefused) {
    write("a.1.vdb", {lumpyGrid<openvdb::FloatGrid>("density", 1)});
    options_.inputs = {path("a.1.vdb")};
    run();
    options_.max_error = 0.5;
    EXPECT_THAT(runToFail(), HasSubstr("--error 0, not 0.5"));
    options_.max_error = 0;
    write("a.1.vdb", {lumpyGrid<openvdb::FloatGrid>("density", 2)});
    EXPECT_THAT(runToFail(), HasSubstr("--overwrite"));
    options_.existing = ExistingDataset::kOverwrite;
    run();
    compare(100);
}

TEST_F(ConversionTest, FilesOfOneNumberMakeOneFrame) {
    write("density.0005.vdb", {lumpyGrid<openvdb::FloatGrid>("density", 1)});
    write("heat.0005.vdb", {lumpyGrid<openvdb::FloatGrid>("heat", 2)});
    options_.inputs = {path("density.0005.vdb"), path("heat.0005.vdb")};
    const ConversionReport report = run();
    ASSERT_EQ(report.frames.size(), 1u);
    EXPECT_EQ(report.frames[0].channels_size(), 2);
    EXPECT_EQ(report.frames[0].sources_size(), 2);
    compare(100);
}

TEST_F(ConversionTest, AChannelInTwoFilesOfAFrameIsAClashThatNamesBoth) {
    write("a.0005.vdb", {lumpyGrid<openvdb::FloatGrid>("density", 1)});
    write("b.0005.vdb", {lumpyGrid<openvdb::FloatGrid>("density", 2)});
    options_.inputs = {path("a.0005.vdb"), path("b.0005.vdb")};
    const std::string message = runToFail();
    EXPECT_THAT(message, HasSubstr("a.0005.vdb"));
    EXPECT_THAT(message, HasSubstr("b.0005.vdb"));
    EXPECT_THAT(message, HasSubstr("density"));
    EXPECT_FALSE(fs::exists(options_.output)) << "a failed first conversion leaves no folder";
}

TEST_F(ConversionTest, OnlyTheChannelsThatWereNamed) {
    options_.inputs = {(kPlume / "plume.0018.vdb").string()};
    options_.channels = {"density", "flame"};
    EXPECT_EQ(run().frames.at(0).channels_size(), 2);
    compare(100);
    options_.channels = {"density", "smoke"};
    options_.output = scratch_ / "other.bricks";
    const std::string message = runToFail();
    EXPECT_THAT(message, HasSubstr("'smoke'"));
    EXPECT_THAT(message, HasSubstr("temperature")) << "it says which there are";
    options_.channels = {"density"};
    options_.channel_errors = {{"dencity", 0.1}};
    EXPECT_THAT(runToFail(), HasSubstr("dencity"));
    EXPECT_FALSE(fs::exists(options_.output));
}

TEST_F(ConversionTest, FramesBeforeAFailureStay) {
    write("a.1.vdb", {lumpyGrid<openvdb::FloatGrid>("density", 1)});
    writeFile(scratch_ / "a.2.vdb", "not a vdb");
    options_.inputs = {path("a.1.vdb"), path("a.2.vdb")};
    EXPECT_THAT(runToFail(), HasSubstr("a.2.vdb"));
    EXPECT_EQ(frames(), "1");
    expectSound();
}

TEST_F(ConversionTest, WhatIsNotFiniteIsRefusedOrReplaced) {
    auto grid = lumpyGrid<openvdb::FloatGrid>("density", 1);
    grid->tree().setValueOn(openvdb::Coord(1, 2, 3), std::nanf(""));
    grid->tree().setValueOn(openvdb::Coord(1, 2, 4), -INFINITY);
    write("a.1.vdb", {grid});
    options_.inputs = {path("a.1.vdb")};
    const std::string message = runToFail();
    EXPECT_THAT(message, HasSubstr("(1, 2, 3)"));
    EXPECT_THAT(message, HasSubstr("--nonfinite"));
    for (const NonFinite policy : {NonFinite::kZero, NonFinite::kClamp}) {
        options_.nonfinite = policy;
        options_.existing = ExistingDataset::kOverwrite;
        run();
        expectSound();
        compare(1000);
    }
}

TEST_F(ConversionTest, VerifyFindsAnyFlippedByteAndNamesWhatItBelongsTo) {
    write("a.1.vdb",
          {lumpyGrid<openvdb::FloatGrid>("density", 1), lumpyGrid<openvdb::Vec3SGrid>("velocity", 2)});
    options_.inputs = {path("a.1.vdb")};
    run();
    expectSound();
    const fs::path frame = options_.output / "frames/000001.brk";
    const std::string bytes = readFile(frame);
    // All of the head and the tail, and places in between.
    for (std::size_t at = 0; at < bytes.size(); at += at < 64 || at + 3000 > bytes.size()
                                                          ? (at + 3000 > bytes.size() ? 13 : 1)
                                                          : 1 + random() % 1000) {
        std::string changed = bytes;
        changed[at] = char(changed[at] ^ (1 << random() % 8));
        writeFile(frame, changed);
        const CheckReport report = checkDataset(options_.output, serialFor, nullptr);
        ASSERT_FALSE(report.faults.empty()) << "byte " << at << " of " << bytes.size() << " went unnoticed";
        const CheckFault& fault = report.faults[0];
        EXPECT_THAT(fault.message, HasSubstr(frame.string()));
        EXPECT_EQ(fault.message.find('\n'), std::string::npos);
        if (!fault.node.empty() && fault.end > fault.begin)
            EXPECT_TRUE(at >= fault.begin && at < fault.end) << at << ": " << fault.message;
    }
    writeFile(frame, bytes);
    expectSound();
    for (const std::string& suffix : {std::string("x"), std::string(4096, '\0')}) {
        writeFile(frame, bytes + suffix);
        EXPECT_FALSE(checkDataset(options_.output, serialFor, nullptr).faults.empty());
    }
    fs::remove(frame);
    EXPECT_FALSE(checkDataset(options_.output, serialFor, nullptr).faults.empty());
}

TEST_F(ConversionTest, AManifestThatLostItsChecksumIsReported) {
    options_.inputs = {(kPlume / "plume.0018.vdb").string()};
    options_.channels = {"flame"};
    run();
    const fs::path manifest = options_.output / kManifestName;
    const std::string text = readFile(manifest);
    std::mt19937 random(2);
    for (std::size_t at = 0; at < text.size(); at += 1 + random() % 20) {
        std::string changed = text;
        changed[at] = char(changed[at] ^ (1 << random() % 7));
        writeFile(manifest, changed);
        EXPECT_FALSE(checkDataset(options_.output, serialFor, nullptr).faults.empty()) << "byte " << at;
    }
}

}  // namespace
}  // namespace brickyard

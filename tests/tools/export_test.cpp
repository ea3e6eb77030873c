// What went in comes out: files converted, exported, and read by OpenVDB and NanoVDB beside their sources.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "command_run.h"
#include "grid_comparison.h"
#include "sample_grids.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class ExportTest : public testing::Test {
protected:
    ExportTest() { openvdb::initialize(); }

    Outcome brickyard(const std::vector<std::string>& arguments) {
        return runProgram(logs_.path(), BRICKYARD_COMMAND, arguments);
    }
    std::string path(const std::string& name) const { return (scratch_ / name).string(); }
    static openvdb::GridPtrVecPtr gridsOf(openvdb::io::File& file) {
        file.setCopyMaxBytes(0);
        file.open(/*delayLoad=*/false);
        return file.getGrids();
    }

    // Converts `source` and exports it again; false where convert refuses it. Empty `difference`: the same.
    bool roundTrip(const fs::path& source, std::string& difference) {
        fs::remove_all(path("a.bricks"));
        if (brickyard({"convert", source.string(), path("a.bricks"), "--nonfinite", "reject"}).status != 0)
            return false;
        const Outcome exported = brickyard({"export", path("a.bricks"), path("back.vdb")});
        difference = exported.err;
        if (exported.status != 0) return true;
        openvdb::io::File file(source.string()), back_file(path("back.vdb"));
        const auto grids = gridsOf(file), back = gridsOf(back_file);
        if (metadataOf(*file.getMetadata()) != metadataOf(*back_file.getMetadata()))
            difference = "the file's metadata";
        // Grids that convert leaves out (points, frustums) are not in the copy.
        std::size_t next = 0;
        for (const auto& grid : *back) {
            while (next < grids->size() && !isConverted(*(*grids)[next])) ++next;
            if (next == grids->size()) return difference = "a grid too many", true;
            const std::string here = compareGrids(*(*grids)[next++], *grid);
            if (!here.empty()) difference = "grid '" + grid->getName() + "': " + here;
        }
        while (next < grids->size() && !isConverted(*(*grids)[next])) ++next;
        if (next != grids->size()) difference = "a grid too few";
        return true;
    }
    static bool isConverted(const openvdb::GridBase& grid) {
        const std::string type = " " + grid.valueType() + " ";
        return grid.transform().isLinear() &&
               std::string(" float double int32 int64 bool mask vec3s vec3d vec3i ").find(type) !=
                   std::string::npos;
    }

    ScratchFolder scratch_, logs_;
};

TEST_F(ExportTest, EveryTypeComesBackWithNamesClassesTransformsAndMetadata) {
    openvdb::GridPtrVec grids = gridsOfAllTypes(9);
    grids[2]->setName("");
    grids[3]->setName("a_float");
    grids[4]->setName("");
    grids[5]->insertMeta("shot", openvdb::StringMetadata("12b"));
    grids[5]->insertMeta("wind", openvdb::Vec3SMetadata({1, 2.5f, -3}));
    grids[6]->setIsInWorldSpace(false);
    grids[7]->setCreator("a test");
    openvdb::MetaMap about;
    about.insertMeta("solver", openvdb::StringMetadata("none"));
    about.insertMeta("time", openvdb::DoubleMetadata(0.1));
    openvdb::io::File file(path("all.1.vdb"));
    file.write(grids, about);
    std::string difference;
    ASSERT_TRUE(roundTrip(path("all.1.vdb"), difference));
    EXPECT_EQ(difference, "");
}

TEST_F(ExportTest, ABoxIsCutOutExactlyAndTheRestIsBackground) {
    auto grid = lumpyGrid<openvdb::FloatGrid>("density", 4);
    writeGrids(path("a.1.vdb"), {grid});
    ASSERT_EQ(brickyard({"convert", path("a.1.vdb"), path("a.bricks")}).status, 0);
    const openvdb::CoordBBox box(openvdb::Coord(-13, -3, 5), openvdb::Coord(66, 9, 17));
    ASSERT_EQ(brickyard({"export", path("a.bricks"), path("b.vdb"), "--box=-13,-3,5,66,9,17"}).status, 0);
    openvdb::io::File file(path("b.vdb"));
    const auto cut = openvdb::gridPtrCast<openvdb::FloatGrid>(gridsOf(file)->front());
    auto expected = grid->deepCopy();
    expected->tree().clear();
    for (auto at = box.begin(); at != box.end(); ++at) {
        const float value = grid->tree().getValue(*at);
        if (grid->tree().isValueOn(*at))
            expected->tree().setValueOn(*at, value);
        else if (value != grid->background())
            expected->tree().setValueOff(*at, value);
    }
    EXPECT_EQ(compareTree(expected->tree(), cut->tree()), "");
    EXPECT_EQ(compareTree(cut->tree(), expected->tree()), "");

    // The same box, dense.
    const Outcome raw = brickyard({"export", path("a.bricks"), path("b.raw"), "--box", "-13,-3,5,66,9,17"});
    ASSERT_EQ(raw.status, 0) << raw.err;
    EXPECT_THAT(raw.out, HasSubstr("--raw 80x13x13:float32"));
    const std::string bytes = readFile(path("b.raw"));
    ASSERT_EQ(bytes.size(), 80u * 13 * 13 * 4);
    std::size_t next = 0;
    for (int z = 5; z <= 17; ++z)
        for (int y = -3; y <= 9; ++y)
            for (int x = -13; x <= 66; ++x, next += 4) {
                float value = 0;
                std::memcpy(&value, bytes.data() + next, 4);
                ASSERT_EQ(value, grid->tree().getValue(openvdb::Coord(x, y, z))) << x << " " << y << " " << z;
            }
}

TEST_F(ExportTest, ACoarserLevelLiesAtTheSamePlaceInTheWorld) {
    // A ramp, so that a shift shows: full weighting keeps it, but at its border.
    auto grid = openvdb::FloatGrid::create(0);
    grid->setName("ramp");
    for (int z = 0; z < 64; ++z)
        for (int y = 0; y < 64; ++y)
            for (int x = 0; x < 64; ++x)
                grid->tree().setValueOn(openvdb::Coord(x, y, z), float(1 + x + 2 * y + 3 * z));
    grid->setTransform(openvdb::math::Transform::createLinearTransform(0.25));
    grid->transform().postTranslate(openvdb::Vec3d(1, -7, 1e6));
    writeGrids(path("a.1.vdb"), {grid});
    ASSERT_EQ(brickyard({"convert", path("a.1.vdb"), path("a.bricks")}).status, 0);
    ASSERT_EQ(brickyard({"export", path("a.bricks"), path("b.vdb"), "--level", "2"}).status, 0);
    openvdb::io::File file(path("b.vdb"));
    const auto coarse = openvdb::gridPtrCast<openvdb::FloatGrid>(gridsOf(file)->front());
    // A level is quantised, so single voxels lie off the ramp; all of them do only when they are moved.
    double deviation = 0;
    for (int i = 2; i < 14; ++i) {
        const openvdb::Vec3d world = coarse->indexToWorld(openvdb::Coord(i, 4, 9));
        EXPECT_EQ(world, grid->indexToWorld(openvdb::Coord(4 * i, 16, 36)));
        deviation +=
            (coarse->tree().getValue(openvdb::Coord(i, 4, 9)) - float(1 + 4 * i + 2 * 16 + 3 * 36)) / 12;
    }
    EXPECT_NEAR(deviation, 0, 1);
    const Outcome above = brickyard({"export", path("a.bricks"), path("c.vdb"), "--level", "20"});
    EXPECT_EQ(above.status, 1);
    EXPECT_THAT(above.err, HasSubstr("--level 0 to "));
    EXPECT_FALSE(fs::exists(path("c.vdb")));
}

TEST_F(ExportTest, NanoVdbTakesWhatItHasAndNamesWhatItLacks) {
    writeGrids(path("all.1.vdb"), gridsOfAllTypes(2));
    ASSERT_EQ(brickyard({"convert", path("all.1.vdb"), path("a.bricks")}).status, 0);
    const Outcome refused = brickyard({"export", path("a.bricks"), path("a.nvdb")});
    EXPECT_EQ(refused.status, 1);
    EXPECT_THAT(refused.err, HasSubstr("float64 for channel 'a_vec3d'"));
    EXPECT_FALSE(fs::exists(path("a.nvdb")));
    const std::string channels = "a_float,a_half,a_double,an_int32,an_int64,a_bool,a_mask,a_vec3s";
    for (const char* codec : {"none", "zip", "blosc"}) {
        const Outcome written =
            brickyard({"export", path("a.bricks"), path("a.nvdb"), "--channel", channels, "--codec", codec});
        ASSERT_EQ(written.status, 0) << written.err;
        EXPECT_THAT(written.out, HasSubstr("8 grids"));
        if (!isInstalled("nanovdb_validate")) continue;
        const Outcome valid = runProgram(logs_.path(), "nanovdb_validate", {path("a.nvdb")});
        EXPECT_EQ(valid.status, 0) << codec << ": " << valid.out << valid.err;
        const Outcome printed = runProgram(logs_.path(), "nanovdb_print", {path("a.nvdb")});
        EXPECT_EQ(printed.status, 0) << codec;
        EXPECT_THAT(printed.out, HasSubstr("a_vec3s")) << codec;
    }
}

// Each converts and comes back the same, or is refused by convert, which other tests look into.
TEST_F(ExportTest, SharedCachesComeBackBitForBit) {
    const char* set = std::getenv("BRICKYARD_SHARED_DATA");
    const fs::path shared = set ? set : BRICKYARD_TEST_DATA "/../../../shared/data";
    if (!fs::is_directory(shared)) GTEST_SKIP() << "no shared data at " << shared;
    int same = 0;
    const bool prints = isInstalled("vdb_print");
    for (const char* folder : {"vdb", "sim/plume_fire_64", "sim/plume_fire", "sim/liquid", "extremes"}) {
        int taken = 0;
        for (const auto& entry : fs::directory_iterator(shared / folder)) {
            const std::string name = entry.path().filename();
            if (entry.path().extension() != ".vdb") continue;
            // Minutes of work in the faces of tiles.
            if (name == "tiles_only_all_levels.vdb") continue;
            // A frame or two of a simulation say what the others would.
            if (std::string(folder).starts_with("sim") && ++taken > 2) continue;
            std::string difference;
            if (!roundTrip(entry.path(), difference)) continue;
            // OpenVDB reads such a transform, but makes none.
            if (name == "voxel_1e-9.vdb")
                EXPECT_THAT(difference, HasSubstr("Non-zero scale values required"));
            else
                EXPECT_EQ(difference, "") << folder << "/" << name;
            ++same;
            if (!prints || name == "voxel_1e-9.vdb") continue;
            const Outcome printed = runProgram(logs_.path(), "vdb_print", {"-l", path("back.vdb")});
            EXPECT_EQ(printed.status, 0) << name << ": " << printed.err;
        }
    }
    EXPECT_GT(same, 40);
}

}  // namespace
}  // namespace brickyard

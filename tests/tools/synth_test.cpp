// `brickyard synth`: its files are the same for the same seed, and other programs' libraries read them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openvdb/openvdb.h>

#include <cstring>

#include "command_run.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

class Synth : public testing::Test {
protected:
    Outcome brickyard(const std::vector<std::string>& arguments) {
        return runCommand(logs_.path(), arguments);
    }
    std::string path(const std::string& name) const { return (scratch_ / name).string(); }
    std::string make(std::vector<std::string> arguments) {
        arguments.insert(arguments.begin(), "synth");
        const auto outcome = brickyard(arguments);
        EXPECT_EQ(outcome.status, 0) << outcome.err;
        return outcome.out;
    }
    static openvdb::GridPtrVecPtr readAll(const std::string& file) {
        openvdb::initialize();
        openvdb::io::File input(file);
        input.open();
        return input.getGrids();
    }
    ScratchFolder scratch_, logs_;
};

TEST_F(Synth, AScanIsTheSameForAnySeedAndJobsAndHasAnEmptyMargin) {
    const std::string said = make({"raw", path("a.raw"), "--size", "130", "--jobs", "1"});
    EXPECT_THAT(said, HasSubstr("2197000 active"));
    EXPECT_THAT(said, HasSubstr("--raw 130x130x130:uint16"));
    make({"raw", path("b.raw"), "--size", "130", "--jobs", "3"});
    make({"raw", path("c.raw"), "--size", "130", "--seed", "2"});
    const std::string bytes = readFile(scratch_ / "a.raw");
    ASSERT_EQ(bytes.size(), 2u * 130 * 130 * 130);
    EXPECT_EQ(bytes, readFile(scratch_ / "b.raw"));
    EXPECT_NE(bytes, readFile(scratch_ / "c.raw"));
    std::vector<std::uint16_t> voxels(bytes.size() / 2);
    std::memcpy(voxels.data(), bytes.data(), bytes.size());
    std::size_t nonzero = 0;
    for (const std::uint16_t voxel : voxels) nonzero += voxel != 0;
    EXPECT_THAT(said, HasSubstr(std::to_string(nonzero) + " of them not 0"));
    EXPECT_GT(nonzero, voxels.size() / 5);
    EXPECT_LT(nonzero, voxels.size() * 4 / 5);
    for (std::size_t i = 0; i < 130 * 130; ++i) ASSERT_EQ(voxels[i], 0) << "the first plane is air";
}

TEST_F(Synth, ACloudscapeIsAVdbThatOpenVdbReadsAndCompressionDoesNotChange) {
    const std::string said =
        make({"cloudscape", path("a.vdb"), "--size", "20000", "--voxels", "200000", "--jobs", "1"});
    make({"cloudscape", path("b.vdb"), "--size", "20000", "--voxels", "200000", "--jobs", "2"});
    make({"cloudscape", path("c.vdb"), "--size", "20000", "--voxels", "200000", "--compression", "none"});
    EXPECT_EQ(readFile(scratch_ / "a.vdb"), readFile(scratch_ / "b.vdb"));
    EXPECT_LT(std::filesystem::file_size(path("a.vdb")), std::filesystem::file_size(path("c.vdb")));
    const auto packed = openvdb::gridPtrCast<openvdb::FloatGrid>(readAll(path("a.vdb"))->at(0));
    const auto plain = openvdb::gridPtrCast<openvdb::FloatGrid>(readAll(path("c.vdb"))->at(0));
    ASSERT_TRUE(packed && plain);
    EXPECT_EQ(packed->getName(), "density");
    EXPECT_EQ(packed->getGridClass(), openvdb::GRID_FOG_VOLUME);
    EXPECT_GE(packed->activeVoxelCount(), 200'000u);
    EXPECT_EQ(packed->activeVoxelCount(), plain->activeVoxelCount());
    EXPECT_THAT(said, HasSubstr(std::to_string(packed->activeVoxelCount()) + " active"));
    EXPECT_EQ(packed->metaValue<std::int64_t>("file_voxel_count"), std::int64_t(packed->activeVoxelCount()));
    const openvdb::CoordBBox box = packed->evalActiveVoxelBoundingBox();
    EXPECT_EQ(packed->metaValue<openvdb::Vec3i>("file_bbox_min"), box.min().asVec3i());
    EXPECT_EQ(packed->metaValue<openvdb::Vec3i>("file_bbox_max"), box.max().asVec3i());
    const auto accessor = plain->getConstAccessor();
    for (auto it = packed->cbeginValueOn(); it; ++it) {
        ASSERT_EQ(accessor.getValue(it.getCoord()), *it);
        ASSERT_TRUE(*it > 0 && *it <= 1);
    }
}

TEST_F(Synth, ManyGridsConvertAndAreTheirSource) {
    const std::string said =
        make({"grids", path("a.vdb"), "--grids", "40", "--size", "32", "--voxels", "500"});
    EXPECT_EQ(readAll(path("a.vdb"))->size(), 40u);
    ASSERT_EQ(brickyard({"convert", path("a.vdb"), path("a.bricks")}).status, 0);
    const auto same = brickyard({"verify", path("a.bricks"), "--against", path("a.vdb")});
    EXPECT_EQ(same.status, 0) << same.err;
    EXPECT_THAT(same.out, HasSubstr("40 channels"));
}

TEST_F(Synth, WrongUsageAndAnUnwritableFileSaySo) {
    EXPECT_EQ(brickyard({"synth", "mesh", path("a")}).status, 2);
    EXPECT_EQ(brickyard({"synth", "raw", path("a"), "--size", "0"}).status, 2);
    expectOneLineOf(brickyard({"synth", "raw", path("none/a.raw"), "--size", "16"}), "none/a.raw");
    expectOneLineOf(brickyard({"synth", "grids", path("none/a.vdb")}), "none/a.vdb");
}

}  // namespace
}  // namespace brickyard

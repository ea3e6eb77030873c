// Our reader against libopenvdb: every type, compression and kind of node, and every sound file of the shared
// data.
#include "tools/importers/vdb_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openvdb/io/Stream.h>
#include <openvdb/tools/PointIndexGrid.h>

#include <algorithm>

#include "frame_fixture.h"
#include "read_everything.h"
#include "sample_grids.h"
#include "tools/importers/vdb_reader_guard.h"
#include "vdb_comparison.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::IsEmpty;

const fs::path kData = fs::path(BRICKYARD_TEST_DATA) / "../../../shared/data";

class VdbSourceTest : public testing::Test {
protected:
    VdbSourceTest() { openvdb::initialize(); }
    void write(const openvdb::GridPtrVec& grids, std::uint32_t compression,
               const openvdb::MetaMap& notes = {}) {
        openvdb::io::File output(file_.string());
        output.setCompression(compression);
        output.write(grids, notes);
        output.close();
    }
    InputContents open(const InputOptions& options = {}) {
        auto contents = openVdb(file_, options);
        EXPECT_TRUE(contents) << contents.error().message;
        return contents ? std::move(*contents) : InputContents();
    }

    ScratchFolder scratch_;
    fs::path file_ = scratch_ / "grids.vdb";
};

// Nodes of each code: no inactive values but the background, one other, two, many.
template <class GridT>
typename GridT::Ptr gridOfAllCodes(const std::string& name) {
    using Value = typename GridT::ValueType;
    auto grid = GridT::create(gridValue<Value>(3));
    grid->setName(name);
    const Value values[] = {gridValue<Value>(3), gridValue<Value>(-3),
                            gridValue<Value>(5), gridValue<Value>(7),
                            gridValue<Value>(9), openvdb::math::negative(gridValue<Value>(3))};
    // Pairs and sets of inactive values, by leaf and again by tiles of lower and upper nodes.
    const std::vector<std::vector<int>> sets{{0},    {5},    {2},    {0, 5},    {5, 0},
                                             {0, 2}, {2, 0}, {2, 3}, {2, 3, 4}, {2, 5}};
    for (std::size_t s = 0; s < sets.size(); ++s) {
        const int x = int(s) * 8;
        auto* leaf = grid->tree().touchLeaf(openvdb::Coord(x, 0, 0));
        for (openvdb::Index n = 0; n < 512; ++n) {
            leaf->setValueOff(n, values[std::size_t(sets[s][n % sets[s].size()])]);
            if (n % 5 == 0 && s % 2 == 0) leaf->setValueOn(n, gridValue<Value>(double(n)));
        }
        // Lower nodes at x = 128 s, upper ones at 4096 s, with the same sets as tiles beside one leaf.
        for (int i = 0; i < 40; ++i) {
            const Value& value = values[std::size_t(sets[s][std::size_t(i) % sets[s].size()])];
            grid->tree().addTile(1, openvdb::Coord(128 * (int(s) + 2), 8 * (i % 16), 8 * (i / 16)), value,
                                 i % 7 == 3);
            grid->tree().addTile(2, openvdb::Coord(-4096 * (int(s) + 1), 128 * (i % 16), 128 * (i / 16)),
                                 value, i % 7 == 3);
        }
        grid->tree().setValueOn(openvdb::Coord(128 * (int(s) + 2) + 64, 64, 100), gridValue<Value>(4));
    }
    grid->tree().addTile(3, openvdb::Coord(8192, 8192, -4096), gridValue<Value>(6), true);
    grid->tree().addTile(3, openvdb::Coord(8192, 8192, -8192), gridValue<Value>(8), false);
    return grid;
}

TEST_F(VdbSourceTest, ReadsEveryTypeUnderEveryCompressionAsOpenVdbDoes) {
    using namespace openvdb;
    for (const std::uint32_t codec : {0u, 1u, 4u})
        for (const std::uint32_t mask : {0u, 2u})
            for (const bool half : {false, true}) {
                GridPtrVec grids{gridOfAllCodes<FloatGrid>("float"), gridOfAllCodes<DoubleGrid>("double"),
                                 gridOfAllCodes<Int32Grid>("int32"), gridOfAllCodes<Int64Grid>("int64"),
                                 gridOfAllCodes<BoolGrid>("bool"),   lumpyMask("mask"),
                                 gridOfAllCodes<Vec3SGrid>("vec3s"), gridOfAllCodes<Vec3DGrid>("vec3d"),
                                 gridOfAllCodes<Vec3IGrid>("vec3i"), lumpyGrid<FloatGrid>("lumps", 1)};
                for (auto& grid : grids) grid->setSaveFloatAsHalf(half);
                write(grids, codec | mask);
                EXPECT_THAT(differencesToOpenVdb(file_, {80, 60}), IsEmpty())
                    << "codec " << codec << ", mask " << mask << ", half " << half;
            }
}

TEST_F(VdbSourceTest, ReadsInfoTransformsAndNotes) {
    openvdb::GridPtrVec grids = gridsOfAllTypes(1);
    for (int i = 0; i < 7; ++i) {
        auto grid = openvdb::FloatGrid::create(0.5f);
        grid->setName("map " + std::to_string(i));
        using namespace openvdb::math;
        const MapBase::Ptr maps[] = {
            MapBase::Ptr(new UniformScaleMap(0.25)),
            MapBase::Ptr(new ScaleMap(openvdb::Vec3d(1, -2, 3))),
            MapBase::Ptr(new TranslationMap(openvdb::Vec3d(1, -2, 3e9))),
            MapBase::Ptr(new ScaleTranslateMap(openvdb::Vec3d(1, 2, 3), openvdb::Vec3d(4))),
            MapBase::Ptr(new UniformScaleTranslateMap(0.1, openvdb::Vec3d(1e12))),
            MapBase::Ptr(new UnitaryMap(openvdb::Vec3d(1, 1, 0), 0.7)),
            MapBase::Ptr(new AffineMap(openvdb::Mat4d(1, 2, 0, 0, 0, 3, 4, 0, 5, 0, 6, 0, 7, 8, 9, 1)))};
        // Transform's constructor would simplify the map.
        grid->setTransform(Transform::Ptr(new Transform(MapBase::Ptr(new UniformScaleMap(1.0)))));
        grid->setTransform(Transform::Ptr(new Transform(maps[i])));
        grid->insertMeta("a number", openvdb::FloatMetadata(2.5f));
        grid->insertMeta("a matrix", openvdb::Mat4DMetadata(openvdb::Mat4d::identity()));
        grid->insertMeta("a word", openvdb::StringMetadata("smoke"));
        grids.push_back(grid);
    }
    openvdb::MetaMap notes;
    notes.insertMeta("creator", openvdb::StringMetadata("a test"));
    notes.insertMeta("take", openvdb::Int32Metadata(7));
    write(grids, openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK, notes);
    EXPECT_THAT(differencesToOpenVdb(file_), IsEmpty());
    EXPECT_EQ(open().metadata.size(), 2u);
}

TEST_F(VdbSourceTest, ReadsInstancesAndNamesThatRepeat) {
    auto density = lumpyGrid<openvdb::FloatGrid>("density", 1);
    density->setSaveFloatAsHalf(true);
    auto twin = density->copy();  // shares the tree
    twin->setName("twin");
    twin->setTransform(openvdb::math::Transform::createLinearTransform(3));
    openvdb::GridPtrVec grids{density,
                              twin,
                              lumpyGrid<openvdb::Int32Grid>("density", 2),
                              lumpyGrid<openvdb::FloatGrid>("", 3),
                              lumpyGrid<openvdb::FloatGrid>("", 4),
                              lumpyGrid<openvdb::FloatGrid>("bad\xff", 5),
                              lumpyGrid<openvdb::FloatGrid>("a[0]", 6)};
    write(grids, openvdb::io::COMPRESS_ACTIVE_MASK);
    EXPECT_THAT(differencesToOpenVdb(file_), IsEmpty());
    InputOptions only;
    only.channels = {"density[1]"};
    const InputContents contents = open(only);
    ASSERT_EQ(contents.fields.size(), 1u);
    EXPECT_EQ(contents.fields[0]->info().type, SampleType::kInt32);
    EXPECT_EQ(contents.names.size(), grids.size());
}

TEST_F(VdbSourceTest, ReadsFilesWithoutOffsets) {
    const openvdb::GridPtrVec grids = gridsOfAllTypes(2);
    {
        std::ofstream out(file_, std::ios::binary);
        openvdb::io::Stream(out).write(grids);
    }
    EXPECT_THAT(differencesToOpenVdb(file_), IsEmpty());
    // Points cannot be passed over: then libopenvdb has to read the file.
    auto points = openvdb::tools::PointIndexGrid::create();
    points->setName("points");
    {
        std::ofstream out(file_, std::ios::binary);
        openvdb::io::Stream(out).write(openvdb::GridPtrVec{points, grids[0]});
    }
    const auto refused = openVdb(file_, {});
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kUnsupported);
    InputOptions options;
    options.probe_program = BRICKYARD_COMMAND;
    const auto read = openInput(file_, options);
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_EQ(read->fields.size(), 1u);
}

TEST_F(VdbSourceTest, GridsThatCannotBeConvertedAreNamedWithTheReason) {
    auto points = openvdb::tools::PointIndexGrid::create();
    points->setName("points");
    auto frustum = openvdb::FloatGrid::create();
    frustum->setName("view");
    frustum->setTransform(openvdb::math::Transform::createFrustumTransform(
        openvdb::BBoxd(openvdb::Vec3d(0.0), openvdb::Vec3d(10.0)), 0.5, 10.0));
    write({points, frustum, lumpyGrid<openvdb::FloatGrid>("good", 1)}, 2);
    EXPECT_THAT(differencesToOpenVdb(file_), IsEmpty());
    const InputContents contents = open();
    ASSERT_EQ(contents.skipped.size(), 2u);
    EXPECT_THAT(contents.skipped[0].reason, HasSubstr("ptidx32"));
    EXPECT_THAT(contents.skipped[1].reason, HasSubstr("frustum"));
}

// Every file that libopenvdb reads. Where it does not see damage that we refuse, the manifest says "corrupt".
TEST_F(VdbSourceTest, ReadsTheSharedFilesAsOpenVdbDoes) {
    if (!fs::is_directory(kData)) GTEST_SKIP() << kData << " is not there";
    std::vector<fs::path> files;
    for (const auto& entry : fs::recursive_directory_iterator(kData))
        if (entry.path().extension() == ".vdb") files.push_back(entry.path());
    std::ranges::sort(files);
    int compared = 0;
    for (const fs::path& file : files) {
        const std::string name = file.filename().string();
        const auto ours = openVdb(file, {});
        const auto theirs = checkVdb(file, {}, {}, BRICKYARD_COMMAND);
        const bool damaged = name.starts_with("corrupt_") || name.starts_with("truncated_");
        const std::vector<Error> errors =
            ours ? readEverything(*ours, 300) : std::vector<Error>{ours.error()};
        for (const Error& error : errors)
            EXPECT_EQ(error.message.find('\n'), std::string::npos) << error.message;
        if (!errors.empty()) {
            // Trees of other levels are left out by us, and stop libopenvdb.
            if (!damaged) EXPECT_FALSE(theirs) << name << ": " << errors[0].message;
            if (!errors.empty() && theirs) std::cout << "refused by us alone: " << errors[0].message << "\n";
            continue;
        }
        if (!theirs) {
            std::cout << "read by us alone: " << theirs.error().message << "\n";
            continue;
        }
        EXPECT_THAT(differencesToOpenVdb(file, {60, 400}), IsEmpty()) << name;
        ++compared;
    }
    EXPECT_GT(compared, 90);
}

}  // namespace
}  // namespace brickyard

#include "tools/importers/openvdb_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openvdb/tools/PointIndexGrid.h>

#include "core/printable_name.h"
#include "frame_fixture.h"
#include "sample_grids.h"
#include "tools/importers/vdb_reader_guard.h"

namespace brickyard {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

class OpenVdbSourceTest : public testing::Test {
protected:
    OpenVdbSourceTest() { openvdb::initialize(); }
    VdbContents read(const std::vector<std::string>& channels = {}) {
        auto contents = readVdb(file_, channels);
        EXPECT_TRUE(contents) << contents.error().message;
        return contents ? std::move(*contents) : VdbContents();
    }
    static const VdbField& find(const VdbContents& contents, const std::string& name) {
        for (const auto& field : contents.fields)
            if (field->info().name == name) return *field;
        ADD_FAILURE() << "no field " << name;
        return *contents.fields.front();
    }
    static std::vector<std::string> names(const VdbContents& contents) {
        std::vector<std::string> result;
        for (const auto& field : contents.fields) result.push_back(field->info().name);
        return result;
    }

    ScratchFolder scratch_;
    std::filesystem::path file_ = scratch_ / "grids.vdb";
};

// Bits of a component of OpenVDB's own answer, by the slowest and plainest way.
template <class GridT>
ValueBits expectedBits(const GridT& grid, const openvdb::Coord& at, int component) {
    const auto value = grid.tree().getValue(at);
    ValueBits bits = 0;
    if constexpr (std::is_arithmetic_v<std::decay_t<decltype(value)>>)
        std::memcpy(&bits, &value, sizeof value);
    else {
        const auto part = value[component];
        std::memcpy(&bits, &part, sizeof part);
    }
    return bits;
}

template <class GridT>
void expectSameField(const VdbField& field, const openvdb::GridBase& base) {
    const auto& grid = dynamic_cast<const GridT&>(base);
    EXPECT_EQ(field.info().active_voxels, grid.activeVoxelCount()) << grid.getName();
    const openvdb::CoordBBox box = grid.evalActiveVoxelBoundingBox();
    for (int a = 0; a < 3; ++a) {
        EXPECT_EQ(field.info().active_box.begin[std::size_t(a)], box.min()[a]) << grid.getName();
        EXPECT_EQ(field.info().active_box.end[std::size_t(a)], std::int64_t(box.max()[a]) + 1)
            << grid.getName();
    }
    std::mt19937 random(3);
    std::size_t uniform = 0;
    for (int round = 0; round < 300; ++round) {
        const std::int64_t edge = 1 + std::int64_t(random() % (round % 3 == 0 ? 40 : 18));
        IndexBox region;
        for (std::size_t a = 0; a < 3; ++a) {
            region.begin[a] = std::int64_t(random() % 150) - 75;
            region.end[a] = region.begin[a] + edge;
        }
        SampleBlock block;
        ASSERT_TRUE(field.read(region, block));
        const auto one = field.uniformOver(region);
        uniform += one.has_value();
        bool same = true;
        std::size_t i = 0;
        const std::size_t count = block.active.size(), bytes = sampleBytes(field.info().type);
        const auto bitsAt = [&](int c, std::size_t at) {
            ValueBits bits = 0;
            std::memcpy(&bits, block.values.data() + (std::size_t(c) * count + at) * bytes, bytes);
            return bits;
        };
        for (std::int64_t z = region.begin[2]; z < region.end[2]; ++z)
            for (std::int64_t y = region.begin[1]; y < region.end[1]; ++y)
                for (std::int64_t x = region.begin[0]; x < region.end[0]; ++x, ++i) {
                    const openvdb::Coord at{int(x), int(y), int(z)};
                    ASSERT_EQ(block.active[i], grid.tree().isValueOn(at)) << grid.getName() << at;
                    for (int c = 0; c < field.info().components; ++c) {
                        ASSERT_EQ(bitsAt(c, i), expectedBits(grid, at, c)) << grid.getName() << at;
                        same = same && bitsAt(c, i) == bitsAt(c, 0) && block.active[i] == block.active[0];
                        if (one) {
                            ASSERT_EQ(bitsAt(c, i), one->value[std::size_t(c)]) << grid.getName() << at;
                            ASSERT_EQ(bool(block.active[i]), one->active) << grid.getName() << at;
                        }
                    }
                }
        EXPECT_EQ(one.has_value(), same) << grid.getName() << ": uniformOver and read disagree";
    }
    EXPECT_GT(uniform, 5u) << "the test met too few regions of one value";
}

TEST_F(OpenVdbSourceTest, ReadsEveryTypeAsOpenVdbDoes) {
    const openvdb::GridPtrVec grids = gridsOfAllTypes(1);
    writeGrids(file_, grids);
    const VdbContents contents = read();
    ASSERT_EQ(contents.fields.size(), grids.size());
    // Halves are rounded by writing, so the reference is what OpenVDB reads back.
    openvdb::io::File input(file_.string());
    input.open(false);
    const auto reference = [&](const char* name) { return input.readGrid(name); };
    expectSameField<openvdb::FloatGrid>(find(contents, "a_float"), *reference("a_float"));
    expectSameField<openvdb::FloatGrid>(find(contents, "a_half"), *reference("a_half"));
    expectSameField<openvdb::DoubleGrid>(find(contents, "a_double"), *reference("a_double"));
    expectSameField<openvdb::Int32Grid>(find(contents, "an_int32"), *reference("an_int32"));
    expectSameField<openvdb::Int64Grid>(find(contents, "an_int64"), *reference("an_int64"));
    expectSameField<openvdb::BoolGrid>(find(contents, "a_bool"), *reference("a_bool"));
    expectSameField<openvdb::MaskGrid>(find(contents, "a_mask"), *reference("a_mask"));
    expectSameField<openvdb::Vec3SGrid>(find(contents, "a_vec3s"), *reference("a_vec3s"));
    expectSameField<openvdb::Vec3DGrid>(find(contents, "a_vec3d"), *reference("a_vec3d"));
    expectSameField<openvdb::Vec3IGrid>(find(contents, "a_vec3i"), *reference("a_vec3i"));
}

TEST_F(OpenVdbSourceTest, KeepsTransformClassVectorTypeAndHalf) {
    const openvdb::GridPtrVec grids = gridsOfAllTypes(1);
    writeGrids(file_, grids);
    const VdbContents contents = read();
    for (const auto& grid : grids) {
        const ChannelInfo& info = find(contents, grid->getName()).info();
        EXPECT_EQ(info.grid_class, openvdb::GridBase::gridClassToString(grid->getGridClass()));
        EXPECT_EQ(info.saved_as_half, grid->saveFloatAsHalf());
        const openvdb::Vec3d world = grid->indexToWorld(openvdb::Vec3d(10, -20, 30));
        const glm::dvec3 ours = info.index_to_world.point({10, -20, 30});
        for (int a = 0; a < 3; ++a)
            EXPECT_NEAR(ours[a], world[a], 1e-9 * std::abs(world[a])) << grid->getName();
    }
    EXPECT_EQ(find(contents, "a_vec3s").info().vector_type, "contravariant relative");
    EXPECT_EQ(find(contents, "a_float").info().vector_type, "");
}

TEST_F(OpenVdbSourceTest, PositionsOutsideInt32AreInactiveBackground) {
    auto grid = openvdb::FloatGrid::create(0.5f);
    grid->setName("corner");
    constexpr int kMax = std::numeric_limits<int>::max(), kMin = std::numeric_limits<int>::min();
    grid->tree().setValueOn(openvdb::Coord(kMax, kMax, kMax), 2.0f);
    grid->tree().setValueOn(openvdb::Coord(kMin, kMin, kMin), 3.0f);
    writeGrids(file_, {grid});
    const VdbContents contents = read();
    const VdbField& field = *contents.fields.at(0);
    const auto bits = [](float v) { return ValueBits(std::bit_cast<std::uint32_t>(v)); };

    SampleBlock block;
    ASSERT_TRUE(field.read(
        {{kMax, kMax, kMax}, {std::int64_t(kMax) + 2, std::int64_t(kMax) + 2, std::int64_t(kMax) + 2}},
        block));
    EXPECT_THAT(block.active, ElementsAre(1, 0, 0, 0, 0, 0, 0, 0));
    float last = 0;
    std::memcpy(&last, block.values.data() + 7 * sizeof last, sizeof last);
    EXPECT_EQ(last, 0.5f);

    constexpr std::int64_t kFar = std::int64_t(1) << 33;
    const auto beyond = field.uniformOver({{kFar, kFar, kFar}, {kFar + 9, kFar + 9, kFar + 9}});
    ASSERT_TRUE(beyond);
    EXPECT_EQ(beyond->value, std::vector<ValueBits>{bits(0.5f)});
    EXPECT_FALSE(beyond->active);
    EXPECT_FALSE(field.uniformOver({{-kFar, -kFar, -kFar}, {kFar, kFar, kFar}}));
    EXPECT_FALSE(field.uniformOver({{kMin, kMin, kMin}, {kMin + 1, kMin + 1, kMin + 2}}));
    EXPECT_TRUE(field.uniformOver({{kMin, kMin, kMin}, {kMin + 1, kMin + 1, kMin + 1}}));
    EXPECT_TRUE(field.uniformOver({{0, kMin, kMin}, {kMax, kMax, kMax}}));
}

TEST_F(OpenVdbSourceTest, MinusZeroAndZeroAreNotOneValue) {
    auto grid = openvdb::FloatGrid::create(0.0f);
    grid->setName("zero");
    // Active, all of them: files drop the sign of an inactive zero.
    grid->fill(openvdb::CoordBBox(openvdb::Coord(0), openvdb::Coord(15)), 0.0f, true);
    grid->tree().touchLeaf(openvdb::Coord(0))->setValueOn(openvdb::Coord(3, 3, 3), -0.0f);
    writeGrids(file_, {grid});
    const VdbContents contents = read();
    EXPECT_FALSE(contents.fields.at(0)->uniformOver({{0, 0, 0}, {8, 8, 8}}));
    EXPECT_TRUE(contents.fields.at(0)->uniformOver({{8, 8, 8}, {16, 16, 16}}));
}

TEST_F(OpenVdbSourceTest, NamesAreUniqueAndValidUtf8) {
    openvdb::GridPtrVec grids;
    for (const char* name :
         {"density", "density", "density", "", "", "bad\xff\xfe", "new\nline", "d\xc3\xbc"}) {
        grids.push_back(openvdb::FloatGrid::create());
        grids.back()->setName(name);
    }
    writeGrids(file_, grids);
    EXPECT_THAT(names(read()),
                testing::UnorderedElementsAre("density", "density[1]", "density[2]", "unnamed", "unnamed[1]",
                                              "bad%FF%FE", "new\nline", "d\xc3\xbc"));
    EXPECT_THAT(names(read({"density[1]", "bad%FF%FE"})),
                testing::UnorderedElementsAre("density[1]", "bad%FF%FE"));
    EXPECT_EQ(read({"unnamed"}).names.size(), 8u) << "those that are not wanted are named, too";
}

TEST_F(OpenVdbSourceTest, GridsThatCannotBeConvertedAreNamedWithTheReason) {
    auto points = openvdb::tools::PointIndexGrid::create();
    points->setName("points");
    auto frustum = openvdb::FloatGrid::create();
    frustum->setName("view");
    frustum->setTransform(openvdb::math::Transform::createFrustumTransform(
        openvdb::BBoxd(openvdb::Vec3d(0.0), openvdb::Vec3d(10.0)), 0.5, 10.0));
    auto good = openvdb::FloatGrid::create();
    good->setName("good");
    writeGrids(file_, {points, frustum, good});
    const VdbContents contents = read();
    EXPECT_THAT(names(contents), ElementsAre("good"));
    ASSERT_EQ(contents.skipped.size(), 2u);
    EXPECT_EQ(contents.skipped[0].name, "points");
    EXPECT_THAT(contents.skipped[0].reason, HasSubstr("ptidx32"));
    EXPECT_EQ(contents.skipped[1].name, "view");
    EXPECT_THAT(contents.skipped[1].reason, HasSubstr("frustum"));
}

TEST(PrintableName, IsOneShortLineOfUtf8) {
    EXPECT_EQ(printableName("density"), "density");
    EXPECT_EQ(printableName("a\nb"), "a\\x0ab");
    EXPECT_EQ(printableName("\xff"), "%FF");
    EXPECT_LT(printableName(std::string(5000, 'L')).size(), 100u);
    EXPECT_EQ(validUtf8("\xe2\x82\xac \xf0\x9f\x92\xa8 \xc0\x80 \xed\xa0\x80 \xf4\x90\x80\x80"),
              "\xe2\x82\xac \xf0\x9f\x92\xa8 %C0%80 %ED%A0%80 %F4%90%80%80");
}

class GuardTest : public OpenVdbSourceTest {
protected:
    GuardTest() {
        writeGrids(file_, {lumpyGrid<openvdb::FloatGrid>("density", 1),
                           lumpyGrid<openvdb::Vec3SGrid>("velocity", 2)});
        bytes_ = readFile(file_);
    }
    std::string bytes_;
};

TEST_F(GuardTest, EveryTruncationIsRefusedByShapeAlone) {
    ASSERT_TRUE(checkVdbShape(file_));
    for (std::size_t size = 0; size < bytes_.size(); size += size < 400 ? 1 : 97) {
        writeFile(scratch_ / "cut.vdb", bytes_.substr(0, size));
        const auto shape = checkVdbShape(scratch_ / "cut.vdb");
        ASSERT_FALSE(shape) << "accepted the first " << size << " of " << bytes_.size();
        EXPECT_THAT(shape.error().message, HasSubstr("cut.vdb"));
    }
}

TEST_F(GuardTest, TheChildAcceptsWhatIsSoundAndPassesOnTheReason) {
    const auto sound = checkVdb(file_, {}, {}, BRICKYARD_COMMAND);
    EXPECT_TRUE(sound) << sound.error().message;
    // The last grid's leaves made noise: its descriptor stays sound.
    std::string damaged = bytes_;
    for (std::size_t i = damaged.size() / 2; i < damaged.size(); ++i) damaged[i] = char(i * 7919 >> 3);
    writeFile(file_, damaged);
    const auto refused = checkVdb(file_, {}, {}, BRICKYARD_COMMAND);
    ASSERT_FALSE(refused);
    EXPECT_THAT(refused.error().message, HasSubstr(file_.string()));
    EXPECT_EQ(refused.error().message.find('\n'), std::string::npos);
}

TEST_F(GuardTest, AReaderThatTakesTooLongIsStopped) {
    // The program that hangs is a shell: what matters is that we come back.
    const std::filesystem::path program = scratch_ / "hang";
    writeFile(program, "#!/bin/sh\nexec sleep 1000\n");
    std::filesystem::permissions(program, std::filesystem::perms::owner_all);
    VdbLimits limits;
    limits.cpu_time = std::chrono::seconds(1);
    const auto refused = checkVdb(file_, {}, limits, program);
    ASSERT_FALSE(refused);
    EXPECT_THAT(refused.error().message, HasSubstr("did not end"));
}

TEST_F(GuardTest, AReaderThatCrashesIsReported) {
    const std::filesystem::path program = scratch_ / "crash";
    writeFile(program, "#!/bin/sh\nkill -SEGV $$\n");
    std::filesystem::permissions(program, std::filesystem::perms::owner_all);
    const auto refused = checkVdb(file_, {}, {}, program);
    ASSERT_FALSE(refused);
    EXPECT_THAT(refused.error().message, HasSubstr("Segmentation fault"));
}

}  // namespace
}  // namespace brickyard

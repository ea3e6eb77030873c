// NanoVDB files against the OpenVDB files that nanovdb_convert made them of, and against what it makes of
// them again.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nanovdb/util/GridBuilder.h>
#include <nanovdb/util/IO.h>

#include <cmath>
#include <cstdlib>
#include <random>

#include "command_run.h"
#include "sample_grids.h"
#include "tools/importers/input_file.h"
#include "tools/importers/openvdb_source.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

const fs::path kPlume = fs::path(BRICKYARD_TEST_DATA) / "plume";

class NanoInput : public testing::Test {
protected:
    void SetUp() override {
        if (std::system("command -v nanovdb_convert >/dev/null") != 0)
            GTEST_SKIP() << "nanovdb_convert is not installed (package libnanovdb-tools)";
        openvdb::initialize();
    }
    Outcome brickyard(const std::vector<std::string>& arguments) {
        return runCommand(logs_.path(), arguments);
    }
    std::string path(const std::string& name) const { return (scratch_ / name).string(); }
    std::string write(const std::string& name, const std::string& bytes) const {
        writeFile(scratch_ / name, bytes);
        return path(name);
    }
    std::string nano(const std::string& options, const std::string& input, const std::string& output) const {
        const std::string command =
            "nanovdb_convert -f " + options + " '" + input + "' '" + path(output) + "' >/dev/null 2>&1";
        EXPECT_EQ(std::system(command.c_str()), 0) << command;
        return path(output);
    }
    static InputContents open(const std::string& file, std::uint64_t memory = 0) {
        InputOptions options;
        options.memory_bytes = memory;
        auto contents = openInput(file, options);
        EXPECT_TRUE(contents) << contents.error().message;
        return contents ? std::move(*contents) : InputContents();
    }
    static void expectSame(const FieldSource& a, const FieldSource& b) {
        const ChannelInfo &i = a.info(), &j = b.info();
        SCOPED_TRACE(j.name);
        EXPECT_EQ(i.name, j.name);
        ASSERT_EQ(i.type, j.type);
        ASSERT_EQ(i.components, j.components);
        EXPECT_EQ(i.background, j.background);
        EXPECT_EQ(i.index_to_world.matrix(), j.index_to_world.matrix());
        EXPECT_EQ(i.grid_class, j.grid_class);
        EXPECT_EQ(i.active_voxels, j.active_voxels);
        EXPECT_EQ(i.active_box, j.active_box);
        std::vector<IndexBox> boxes;
        const IndexBox around = j.active_box.empty() ? IndexBox{{-20, -20, -20}, {20, 20, 20}} : j.active_box;
        // The whole box where it is small, else its corners.
        const auto starts = [&](std::size_t axis) {
            std::vector<std::int64_t> at;
            for (std::int64_t i = around.begin[axis] - 9; i < around.end[axis] + 9 && at.size() < 3; i += 121)
                at.push_back(i);
            at.push_back(around.end[axis] - 100);
            return at;
        };
        for (const std::int64_t z : starts(2))
            for (const std::int64_t y : starts(1))
                for (const std::int64_t x : starts(0))
                    boxes.push_back({{x, y, z}, {x + 121, y + 121, z + 121}});
        SampleBlock p, q;
        for (const IndexBox& box : boxes) {
            ASSERT_TRUE(a.read(box, p));
            ASSERT_TRUE(b.read(box, q));
            EXPECT_EQ(p.values, q.values) << box.begin[0] << " " << box.begin[1] << " " << box.begin[2];
            EXPECT_EQ(p.active, q.active);
        }
        // Never uniform where it is not; and not known only where leaves are.
        std::mt19937 random(1);
        std::vector<IndexBox> asked = {
            {{-(1ll << 33), -(1ll << 33), -(1ll << 33)}, {1ll << 33, 1ll << 33, 1ll << 33}}};
        for (int k = 0; k < 300; ++k) {
            IndexBox box;
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const std::int64_t span = around.end[axis] - around.begin[axis] + 40;
                box.begin[axis] = around.begin[axis] - 20 + std::int64_t(random() % std::uint64_t(span));
                box.end[axis] = box.begin[axis] + 1 + std::int64_t(random() % 40);
            }
            asked.push_back(box);
        }
        for (const IndexBox& box : asked) {
            const auto one = a.uniformOver(box);
            if (!one) continue;
            const auto other = b.uniformOver(box);
            ASSERT_TRUE(other);
            EXPECT_EQ(one->value, other->value);
            EXPECT_EQ(one->active, other->active);
        }
    }
    static void expectSame(const InputContents& ours, const std::vector<std::unique_ptr<VdbField>>& theirs) {
        ASSERT_EQ(ours.fields.size(), theirs.size());
        for (std::size_t i = 0; i < theirs.size(); ++i) expectSame(*ours.fields[i], *theirs[i]);
    }
    // Every type that nanovdb_convert takes, with tiles, inactive values and its own transform.
    std::string allTypes() const {
        openvdb::GridPtrVec grids;
        for (const auto& grid : gridsOfAllTypes(7))
            if (grid->getName() != "a_vec3i" && grid->getName() != "a_vec3d" && grid->getName() != "a_half")
                grids.push_back(grid);
        auto large = lumpyGrid<openvdb::FloatGrid>("far", 3);
        large->tree().addTile(3, openvdb::Coord(1 << 30, -4096, 8192), 5.0f, true);
        large->tree().setValue(openvdb::Coord(-(1 << 29), 77, 1 << 28), 2.0f);
        grids.push_back(large);
        grids.push_back(openvdb::FloatGrid::create(4.0f));
        grids.back()->setName("nothing");
        writeGrids(scratch_ / "types.vdb", grids);
        return path("types.vdb");
    }
    ScratchFolder scratch_, logs_;
};

TEST_F(NanoInput, EveryTypeAndCodecIsItsOpenVdbSource) {
    const std::string source = allTypes();
    const auto expected = readVdb(source, {});
    ASSERT_TRUE(expected) << expected.error().message;
    for (const char* codec : {"", "-z", "-b"})
        expectSame(open(nano(codec, source, "a.nvdb")), expected->fields);
}

TEST_F(NanoInput, TheTestCachesAreTheirSourceThroughTheCommand) {
    const std::string source = (kPlume / "plume.0024.vdb").string();
    const auto expected = readVdb(source, {});
    ASSERT_TRUE(expected);
    for (const char* codec : {"", "-z", "-b"}) {
        const std::string file = nano(codec, source, "plume.0024.nvdb"), out = path("out.bricks");
        expectSame(open(file, 16 << 20), expected->fields);
        const auto converted = brickyard({"convert", file, out, "--overwrite"});
        ASSERT_EQ(converted.status, 0) << converted.err;
        const auto same = brickyard({"verify", out, "--against", file});
        EXPECT_EQ(same.status, 0) << same.err;
        EXPECT_THAT(same.out, HasSubstr("every voxel is bit-exact"));
    }
}

TEST_F(NanoInput, QuantisedFloatsAreWhatNanoVdbItselfDecodes) {
    writeGrids(scratch_ / "f.vdb",
               {lumpyGrid<openvdb::FloatGrid>("a", 1), lumpyGrid<openvdb::FloatGrid>("b", 2)});
    for (const char* how : {"--fp4", "--fp8", "--fp16", "--fpN -r 0.0001", "--fpN -r 0.1 -b"}) {
        const std::string file = nano(how, path("f.vdb"), "f.nvdb");
        const auto expected = readVdb(nano("", file, "back.vdb"), {});
        ASSERT_TRUE(expected) << expected.error().message;
        SCOPED_TRACE(how);
        expectSame(open(file), expected->fields);
    }
}

// Types that nanovdb_convert does not make, but NanoVDB's own builder does.
template <class Value>
void buildGrid(const std::string& file, const Value& background, Value (*value)(int)) {
    nanovdb::GridBuilder<Value> builder(background);
    auto accessor = builder.getAccessor();
    for (int i = 0; i < 500; ++i)
        accessor.setValue(nanovdb::Coord(i % 10 - 3, i / 10 % 10, i / 100 * 40), value(i));
    nanovdb::io::writeGrid(file, builder.template getHandle<>(0.5, nanovdb::Vec3d(1, 2, 3), "built"));
}

TEST_F(NanoInput, TypesWithoutAnOpenVdbCounterpartAreRead) {
    buildGrid<nanovdb::Vec3d>(path("v.nvdb"), nanovdb::Vec3d(1, 2, 3),
                              [](int i) { return nanovdb::Vec3d(i, -i, 1e300 * i); });
    buildGrid<std::int16_t>(path("s.nvdb"), -7, [](int i) { return std::int16_t(-60 * i); });
    buildGrid<std::uint32_t>(path("u.nvdb"), 9, [](int i) { return 4'000'000'000u + std::uint32_t(i); });
    const auto at = [](const FieldSource& field, int i, std::size_t c = 0) {
        SampleBlock block;
        EXPECT_TRUE(field.read({{-3, 0, 0}, {7, 10, 161}}, block));
        const std::size_t index = std::size_t(i / 100 * 40) * 100 + std::size_t(i % 100),
                          count = block.active.size();
        EXPECT_EQ(block.active[index], 1);
        ValueBits bits = 0;
        const std::size_t bytes = sampleBytes(field.info().type);
        std::memcpy(&bits, block.values.data() + (c * count + index) * bytes, bytes);
        return toDouble(field.info().type, bits);
    };
    const auto vectors = open(path("v.nvdb")), shorts = open(path("s.nvdb")), words = open(path("u.nvdb"));
    EXPECT_EQ(vectors.fields[0]->info().type, SampleType::kFloat64);
    EXPECT_EQ(vectors.fields[0]->info().components, 3);
    EXPECT_EQ(vectors.fields[0]->info().active_voxels, 500u);
    EXPECT_EQ(vectors.fields[0]->info().index_to_world.point({2, 0, 0}), glm::dvec3(2, 2, 3));
    EXPECT_EQ(shorts.fields[0]->info().source_type, "int16");
    EXPECT_EQ(words.fields[0]->info().source_type, "uint32");
    EXPECT_EQ(shorts.fields[0]->info().background[0], std::uint32_t(-7));
    for (const int i : {0, 1, 123, 499}) {
        EXPECT_EQ(at(*vectors.fields[0], i, 0), i);
        EXPECT_EQ(at(*vectors.fields[0], i, 1), -i);
        EXPECT_EQ(at(*vectors.fields[0], i, 2), 1e300 * i);
        EXPECT_EQ(at(*shorts.fields[0], i), -60 * i);
        EXPECT_EQ(at(*words.fields[0], i), 4e9 + i);
    }
}

TEST_F(NanoInput, SegmentsFollowEachOtherAndNamesStayUnique) {
    writeGrids(scratch_ / "a.vdb", {lumpyGrid<openvdb::FloatGrid>("density", 1)});
    writeGrids(scratch_ / "b.vdb",
               {lumpyGrid<openvdb::FloatGrid>("density", 2), lumpyGrid<openvdb::FloatGrid>("", 3)});
    const std::string both =
        readFile(nano("-b", path("a.vdb"), "a.nvdb")) + readFile(nano("-z", path("b.vdb"), "b.nvdb"));
    const auto contents = open(write("both.nvdb", both));
    EXPECT_THAT(contents.names, testing::UnorderedElementsAre("density", "density[1]", "unnamed"));
    ASSERT_EQ(contents.fields.size(), 3u);
    EXPECT_EQ(contents.fields[1]->info().active_voxels,
              readVdb(path("b.vdb"), {})->fields[0]->info().active_voxels +
                  readVdb(path("b.vdb"), {})->fields[1]->info().active_voxels -
                  contents.fields[2]->info().active_voxels);
    InputOptions only;
    only.channels = {"density[1]"};
    EXPECT_EQ(openInput(path("both.nvdb"), only)->fields.size(), 1u);
}

TEST_F(NanoInput, PointsAndOtherVersionsAreRefusedWithTheirReason) {
    const char* shared = std::getenv("BRICKYARD_SHARED_DATA");
    const fs::path points =
        fs::path(shared ? shared : BRICKYARD_TEST_DATA "/../../../shared/data") / "vdb/points_houdini.vdb";
    if (fs::exists(points)) {
        const std::string file = nano("", points.string(), "points.nvdb");
        const auto contents = open(file);
        EXPECT_TRUE(contents.fields.empty());
        ASSERT_EQ(contents.skipped.size(), 1u);
        EXPECT_THAT(contents.skipped[0].reason, HasSubstr("convert"));
        expectOneLineOf(brickyard({"convert", file, path("p.bricks")}), "nothing to convert");
    }
    writeGrids(scratch_ / "a.vdb", {lumpyGrid<openvdb::FloatGrid>("density", 1)});
    const std::string good = readFile(nano("", path("a.vdb"), "a.nvdb"));
    const auto refused = [&](std::string bytes, const std::string& why) {
        expectOneLineOf(brickyard({"convert", write("bad.nvdb", bytes), path("bad.bricks")}), why);
        EXPECT_FALSE(fs::exists(path("bad.bricks")));
    };
    std::string other = good;
    other.replace(0, 8, "NanoVDB2");
    refused(other, "32.6 or newer");
    other = good;
    other[10] = char(0x20);
    other[11] = char(0x04);  // version 33
    refused(other, "version 33");
    refused(good + "x", "cut off");
    refused(good.substr(0, good.size() - 1), "claims bytes");
    other = good;
    for (std::size_t i = 0; i < 8; ++i) other[16 + i] = char(0xff);
    refused(other, "not as long");
    // A NaN in the transform: the map stands 296 bytes into the grid, its doubles 88 further.
    other = good;
    const std::size_t grid_at = good.find("NanoVDB0", 8);
    const double nan = std::nan("");
    std::memcpy(other.data() + grid_at + 296 + 88, &nan, sizeof nan);
    refused(other, "unusable transform");
}

TEST_F(NanoInput, DamageIsRefusedOrHarmless) {
    writeGrids(scratch_ / "a.vdb", {lumpyGrid<openvdb::FloatGrid>("density", 1)});
    std::mt19937 random(5);
    for (const char* how : {"", "-z", "-b", "--fpN -r 0.01"}) {
        const std::string good = readFile(nano(how, path("a.vdb"), "a.nvdb"));
        for (int round = 0; round < 150; ++round) {
            std::string bytes = good;
            if (round % 3 == 0) {
                bytes.resize(random() % bytes.size());
            } else {
                // The head and the inner nodes' tables are where offsets are.
                for (unsigned i = 0, n = 1 + random() % 8; i < n; ++i)
                    bytes[random() %
                          (round % 3 == 1 ? bytes.size() : std::min<std::size_t>(bytes.size(), 2000))] =
                        char(random());
            }
            const auto contents = openInput(write("bad.nvdb", bytes), {});
            if (!contents) {
                EXPECT_EQ(contents.error().message.find('\n'), std::string::npos);
                continue;
            }
            SampleBlock block;
            for (const auto& field : contents->fields) {
                (void)field->uniformOver({{-100, -100, -100}, {100, 100, 100}});
                (void)field->read({{-40, -40, -40}, {60, 60, 60}}, block);
            }
        }
    }
}

TEST_F(NanoInput, TheSharedCachesAreTheirSource) {
    const char* shared = std::getenv("BRICKYARD_SHARED_DATA");
    const fs::path folder = fs::path(shared ? shared : BRICKYARD_TEST_DATA "/../../../shared/data");
    if (!fs::is_directory(folder)) GTEST_SKIP() << "no shared data at " << folder;
    for (const char* name :
         {"vdb/smoke_houdini.vdb", "vdb/sphere_levelset_houdini.vdb", "vdb/torus_maya.vdb",
          "extremes/affine_shear.vdb", "extremes/ball_near_int_limit.vdb", "extremes/bbox_int_full_span.vdb",
          "extremes/tiles_and_voxels.vdb", "extremes/nonzero_background.vdb"}) {
        SCOPED_TRACE(name);
        const auto expected = readVdb(folder / name, {});
        ASSERT_TRUE(expected) << expected.error().message;
        expectSame(open(nano("-b", (folder / name).string(), "s.nvdb")), expected->fields);
    }
}

}  // namespace
}  // namespace brickyard

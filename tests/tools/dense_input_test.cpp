// Raw dumps: as fields, and through the command. What is expected is computed here from the bytes of the
// file.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <cstring>
#include <nlohmann/json.hpp>
#include <random>
#include <thread>

#include "command_run.h"
#include "raw_file.h"
#include "tools/field_reader.h"
#include "tools/importers/dense_field.h"
#include "tools/importers/input_file.h"
#include "tools/importers/raw_layout.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

InputOptions optionsFor(const std::string& layout) {
    InputOptions options;
    options.raw = layout;
    return options;
}

class DenseInput : public testing::Test {
protected:
    Outcome brickyard(const std::vector<std::string>& arguments) {
        return runCommand(logs_.path(), arguments);
    }
    std::string path(const std::string& name) const { return (scratch_ / name).string(); }
    std::string write(const std::string& name, const std::string& bytes) const {
        writeFile(scratch_ / name, bytes);
        return path(name);
    }
    // The dataset's only channel.
    FieldReader reader(const std::string& dataset) {
        auto opened = Dataset::open(dataset);
        EXPECT_TRUE(opened) << opened.error().message;
        auto store = opened->openFrame(opened->manifest().frames(0).frame());
        EXPECT_TRUE(store) << store.error().message;
        EXPECT_EQ((*store)->footer().channels_size(), 1);
        return FieldReader(*store, 0);
    }
    void expectStored(const RawFile& raw, const std::string& dataset) {
        const FieldReader stored = reader(dataset);
        EXPECT_EQ(stored.channel().active_voxels(), std::uint64_t(raw.nx * raw.ny * raw.nz));
        SampleBlock block;
        ASSERT_TRUE(stored.read({{0, 0, 0}, {raw.nx, raw.ny, raw.nz}}, block));
        const std::size_t bytes = sampleBytes(stored.type());
        std::size_t wrong = 0;
        for (std::size_t i = 0; i < block.active.size(); ++i) {
            ValueBits value = 0;
            std::memcpy(&value, block.values.data() + i * bytes, bytes);
            const auto x = std::int64_t(i) % raw.nx, y = std::int64_t(i) / raw.nx % raw.ny,
                       z = std::int64_t(i) / raw.nx / raw.ny;
            wrong += block.active[i] != 1 || value != raw.expected(x, y, z);
        }
        EXPECT_EQ(wrong, 0u) << raw.layout();
    }
    ScratchFolder scratch_, logs_;
};

TEST_F(DenseInput, EveryTypeAndOrderConvertsBitForBit) {
    unsigned seed = 0;
    for (const char* type : {"uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64",
                             "float16", "float32", "float64"})
        for (const bool z_fastest : {false, true})
            for (const bool big : {false, true}) {
                const RawFile raw = randomRaw(19, 33, 21, type, z_fastest, big, ++seed);
                const std::string file = write("dump.raw", "head!" + raw.bytes);
                const std::string out = path(std::to_string(seed) + ".bricks");
                const std::string layout = raw.layout() + (big ? ":header=5" : ":skip=5");
                const auto converted = brickyard({"convert", file, out, "--raw", layout});
                ASSERT_EQ(converted.status, 0) << layout << ": " << converted.err;
                expectStored(raw, out);
                const auto same = brickyard({"verify", out, "--against", file, "--raw", layout});
                EXPECT_EQ(same.status, 0) << layout << ": " << same.err << same.out;
                EXPECT_THAT(same.out, HasSubstr("every voxel is bit-exact"));
                const bool integer = !std::string(type).starts_with("float");
                const bool own = std::string(type) == "int32" || std::string(type) == "int64";
                const auto contents = openInput(file, optionsFor(layout));
                ASSERT_TRUE(contents) << contents.error().message;
                EXPECT_EQ(contents->fields[0]->info().source_type, integer && !own ? type : "");
                EXPECT_EQ(contents->fields[0]->info().saved_as_half, std::string(type) == "float16");
            }
}

TEST_F(DenseInput, BoxesReadInAnyOrderAndByManyThreadsAreTheFile) {
    // Larger than half the least budget, so that bands, chunks and single rows are all met.
    for (const bool z_fastest : {false, true}) {
        const RawFile raw = randomRaw(300, 190, 210, "uint16", z_fastest, false, 7);
        const std::string file = write("dump.raw", raw.bytes);
        InputOptions options = optionsFor(raw.layout());
        options.memory_bytes = 1;  // the least that is taken
        const auto contents = openInput(file, options);
        ASSERT_TRUE(contents) << contents.error().message;
        const FieldSource& field = *contents->fields[0];
        EXPECT_TRUE(field.prefersRows());
        std::vector<IndexBox> boxes;
        for (std::int64_t z = -7; z < raw.nz; z += 128)
            for (std::int64_t y = -7; y < raw.ny; y += 128)
                for (std::int64_t x = -7; x < raw.nx; x += 128)
                    boxes.push_back({{x, y, z}, {x + 143, y + 143, z + 143}});
        std::mt19937 random(3);
        for (int i = 0; i < 60; ++i) {
            const std::int64_t x = random() % 300, y = random() % 190, z = random() % 210,
                               edge = i % 3 == 0 ? 2 : 33;
            boxes.push_back({{x, y, z}, {x + edge, y + edge, z + edge}});
        }
        std::atomic<std::size_t> next{0};
        std::vector<std::thread> threads;
        for (int t = 0; t < 4; ++t)
            threads.emplace_back([&] {
                for (std::size_t i; (i = next++) < boxes.size();) expectValues(field, raw, boxes[i]);
            });
        for (std::thread& thread : threads) thread.join();
        field.release();
        expectValues(field, raw, boxes[0]);
    }
}

TEST_F(DenseInput, ThinVolumesConvert) {
    for (const bool z_fastest : {false, true})
        for (const auto& [nx, ny, nz] : {std::array{1, 1, 1}, std::array{1, 1, 500}, std::array{400, 1, 1},
                                         std::array{1, 70, 3}, std::array{90, 60, 1}, std::array{5, 1, 77}}) {
            const RawFile raw = randomRaw(nx, ny, nz, "float32", z_fastest, false, unsigned(nx + 7 * nz));
            const std::string file = write("thin.raw", raw.bytes);
            const auto contents = openInput(file, optionsFor(raw.layout()));
            ASSERT_TRUE(contents) << contents.error().message;
            expectValues(*contents->fields[0], raw, {{-2, -2, -2}, {nx + 1, ny + 2, nz + 3}});
        }
}

TEST_F(DenseInput, VoxelsAreCellsAndHaveTheirHalfVoxelInTheTransform) {
    const RawFile raw = randomRaw(4, 4, 4, "uint8", false, false, 1);
    const std::string file = write("a.0007.raw", raw.bytes), out = path("out.bricks");
    ASSERT_EQ(
        brickyard({"convert", file, out, "--raw", raw.layout(), "--voxel-size", "0.5,1,2", "--name", "ct"})
            .status,
        0);
    const FieldReader stored = reader(out);
    EXPECT_EQ(stored.channel().name(), "ct");
    EXPECT_EQ(stored.indexToWorld().point({0, 0, 0}), glm::dvec3(0.25, 0.5, 1));
    EXPECT_EQ(stored.indexToWorld().point({3, 3, 3}), glm::dvec3(1.75, 3.5, 7));
}

TEST_F(DenseInput, TheSameFileWithAnotherLayoutIsNotThereAlready) {
    const std::string file = write("a.raw", std::string(64, 'x')), out = path("out.bricks");
    ASSERT_EQ(brickyard({"convert", file, out, "--raw", "4x4x4:uint8"}).status, 0);
    EXPECT_EQ(brickyard({"convert", file, out, "--raw", "4x4x4:uint8"}).status, 0);
    expectOneLineOf(brickyard({"convert", file, out, "--raw", "4x4x4:int8"}), "--raw 4x4x4:uint8");
    expectOneLineOf(brickyard({"convert", file, out, "--raw", "4x4x4:uint8", "--voxel-size", "2"}),
                    "--voxel-size 1,1,1");
}

TEST_F(DenseInput, AnIntegerThatDoesNotFitNamesItsVoxel) {
    RawFile raw = randomRaw(6, 5, 4, "uint64", false, false, 1);
    raw.bytes[((3 * 5 + 2) * 6 + 4) * 8 + 7] = char(0x80);
    const std::string file = write("a.raw", raw.bytes), out = path("out.bricks");
    expectOneLineOf(brickyard({"convert", file, out, "--raw", raw.layout()}), "voxel (4, 2, 3)");
    EXPECT_FALSE(fs::exists(out));
}

TEST_F(DenseInput, GzipIsUnpackedAndABombIsNot) {
    const RawFile raw = randomRaw(40, 50, 60, "int16", true, true, 5);
    const std::size_t half = raw.bytes.size() / 2;
    for (const std::string& packed :
         {gzipped(raw.bytes), gzipped(raw.bytes.substr(0, half)) + gzipped(raw.bytes.substr(half))}) {
        const auto contents = openInput(write("a.raw.gz", packed), optionsFor(raw.layout()));
        ASSERT_TRUE(contents) << contents.error().message;
        expectValues(*contents->fields[0], raw, {{0, 0, 0}, {40, 50, 60}});
    }
    const std::string packed = gzipped(raw.bytes), out = path("out.bricks");
    const std::string bomb = gzipped(std::string(100'000'000, '\0'));
    ASSERT_LT(bomb.size(), 120'000u);
    expectOneLineOf(brickyard({"convert", write("bomb.gz", bomb), out, "--raw", "10x10x10:uint8"}),
                    "more than the 1000");
    expectOneLineOf(brickyard({"convert", write("cut.gz", packed.substr(0, packed.size() / 2)), out, "--raw",
                               raw.layout()}),
                    "end early");
    std::string damaged = packed;
    damaged[damaged.size() / 2] ^= 0x55;
    damaged[damaged.size() / 2 + 1] ^= 0x55;
    EXPECT_EQ(brickyard({"convert", write("bad.gz", damaged), out, "--raw", raw.layout()}).status, 1);
    expectOneLineOf(brickyard({"convert", write("lie.gz", packed), out, "--raw", "99999x99999x9999:uint8"}),
                    "cannot hold");
    EXPECT_FALSE(fs::exists(out));
}

TEST_F(DenseInput, ASizeThatContradictsTheLayoutIsRefusedWithBoth) {
    const std::string out = path("out.bricks"), file = write("a.raw", std::string(1064, 'x'));
    expectOneLineOf(brickyard({"convert", file, out, "--raw", "10x10x10:uint8"}), "1064 bytes");
    expectOneLineOf(brickyard({"convert", file, out, "--raw", "10x10x10:uint8"}), ":skip=64");
    expectOneLineOf(brickyard({"convert", file, out, "--raw", "10x10x10:uint16"}), "2000 bytes");
    expectOneLineOf(brickyard({"convert", file, out, "--raw", "2147483647x1000x1000:uint8"}),
                    "2147483647000000");
    EXPECT_EQ(brickyard({"convert", file, out, "--raw", "10x10x10:uint8:skip=60:trailing=4"}).status, 0);
    expectOneLineOf(brickyard({"convert", path("absent.raw"), path("b"), "--raw", "1x1x1:uint8"}),
                    "absent.raw");
    expectOneLineOf(brickyard({"convert", scratch_.path().string(), path("b"), "--raw", "1x1x1:uint8"}),
                    "not a file");
    EXPECT_FALSE(fs::exists(path("b")));
}

TEST_F(DenseInput, AWrongLayoutIsWrongUsage) {
    const std::string file = write("a.raw", "x");
    for (const char* layout : {"",
                               "1",
                               "1x1",
                               "1x1x1",
                               "1x1x1:",
                               "1x1x1:uint7",
                               "1x1x1:uint8:",
                               "1x1x1:uint8:sideways",
                               "0x1x1:uint8",
                               "-1x1x1:uint8",
                               "1x1x1x1:uint8",
                               "1x1x1:uint8:skip",
                               "1x1x1:uint8:skip=",
                               "1x1x1:uint8:skip=-1",
                               "1x1x1:uint8:skip=99999999999999999999",
                               "99999999x99999999x99999999:uint8",
                               "4294967297x1x1:uint8",
                               "2147483647x2147483647x2147483647:float64",
                               "1.5x1x1:uint8",
                               " 1x1x1:uint8"}) {
        const bool trailing_colon = std::string(layout) == "1x1x1:uint8:";
        EXPECT_EQ(bool(parseRawLayout(layout)), trailing_colon) << layout;
        if (trailing_colon) continue;
        const auto outcome = brickyard({"convert", file, path("out.bricks"), "--raw", layout});
        EXPECT_EQ(outcome.status, 2) << layout << outcome.err;
        EXPECT_EQ(outcome.err.find('\n'), outcome.err.size() - 1) << outcome.err;
    }
    for (const char* size : {"0", "-1", "nan", "inf", "1,2", "1,2,3,4", "a", "1,2,3,"})
        EXPECT_EQ(
            brickyard({"convert", file, path("o"), "--raw", "1x1x1:uint8", "--voxel-size", size}).status, 2)
            << size;
    EXPECT_EQ(brickyard({"convert", file, path("o"), "--voxel-size", "1"}).status, 2) << "without --raw";
}

TEST_F(DenseInput, AnUnknownFormatSaysWhatIsUnderstood) {
    for (const char* bytes : {"", "x", "P6 1 1 255 abc", "NRR"})
        expectOneLineOf(brickyard({"convert", write("a.bin", bytes), path("out.bricks")}),
                        "--raw 128x128x128:uint16");
}

TEST_F(DenseInput, TheSharedScanConverts) {
    const char* shared = std::getenv("BRICKYARD_SHARED_DATA");
    const fs::path file = fs::path(shared ? shared : BRICKYARD_TEST_DATA "/../../../shared/data") /
                          "volumes/ct_skull_64_float32.inr";
    if (!fs::exists(file)) GTEST_SKIP() << "no shared data at " << file;
    RawFile raw{64, 64, 64, "float32", false, false, readFile(file).substr(256)};
    const std::string out = path("out.bricks");
    ASSERT_EQ(brickyard({"convert", file, out, "--raw", "64x64x64:float32:skip=256", "--voxel-size",
                         "3.94305,3.94305,3.65079"})
                  .status,
              0);
    expectStored(raw, out);
    EXPECT_EQ(brickyard({"verify", out, "--against", file, "--raw", "64x64x64:float32:skip=256",
                         "--voxel-size", "3.94305,3.94305,3.65079"})
                  .status,
              0);
}

TEST_F(DenseInput, VerifyNamesTheWorstVoxel) {
    RawFile raw = randomRaw(20, 20, 20, "int16", false, false, 9);
    const std::string out = path("out.bricks"), file = write("a.raw", raw.bytes);
    ASSERT_EQ(brickyard({"convert", file, out, "--raw", raw.layout()}).status, 0);
    const std::size_t at = std::size_t((7 * 20 + 6) * 20 + 5) * 2;
    raw.bytes[at] = char(raw.bytes[at] ^ 3);
    raw.bytes[at - 40 * 20 * 2] = char(raw.bytes[at - 40 * 20 * 2] ^ 1);
    write("a.raw", raw.bytes);
    const auto outcome = brickyard({"verify", out, "--against", file, "--raw", raw.layout(), "--json"});
    EXPECT_EQ(outcome.status, 1);
    const auto json = nlohmann::json::parse(outcome.out);
    EXPECT_EQ(json["against"]["faults"], 2);
    const auto& worst = json["against"]["worst_voxels"].at(0);
    EXPECT_EQ(worst["channel"], "density");
    EXPECT_EQ(worst["index"], (std::vector<int>{5, 6, 7}));
    EXPECT_EQ(worst["source"], double(std::int32_t(std::uint32_t(raw.expected(5, 6, 7)))));
    EXPECT_EQ(worst["deviation"], std::abs(double(worst["source"]) - double(worst["stored"])));
}

}  // namespace
}  // namespace brickyard

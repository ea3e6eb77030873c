// Broken and hostile .vdb files: refused in one line, or read, but never believed. And files that change
// meanwhile.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openvdb/io/Stream.h>
#include <sys/resource.h>

#include <atomic>
#include <random>
#include <thread>

#include "core/octree_plan.h"
#include "frame_fixture.h"
#include "read_everything.h"
#include "sample_grids.h"
#include "tools/importers/vdb_grid_field.h"
#include "tools/importers/vdb_source.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::IsEmpty;

class VdbDamageTest : public testing::Test {
protected:
    VdbDamageTest() { openvdb::initialize(); }
    void write(const openvdb::GridPtrVec& grids, std::uint32_t compression) {
        openvdb::io::File output(file_.string());
        output.setCompression(compression);
        output.write(grids);
        output.close();
        bytes_ = readFile(file_);
    }
    // Opens and reads all there is. Every error must be one line that names the file.
    std::vector<Error> errorsOf(const std::string& bytes) {
        writeFile(file_, bytes);
        const auto contents = openVdb(file_, {});
        std::vector<Error> errors =
            contents ? readEverything(*contents, /*most_boxes=*/40) : std::vector<Error>{contents.error()};
        for (const Error& error : errors) {
            EXPECT_THAT(error.message, HasSubstr(file_.string()));
            EXPECT_EQ(error.message.find('\n'), std::string::npos) << error.message;
        }
        return errors;
    }
    // The bytes of `grid`'s tree, by the first place where a number of buffers (1) and its background follow.
    std::size_t treeBegin(float background) const {
        std::string head(8, '\0');
        const std::int32_t one = 1;
        std::memcpy(head.data(), &one, sizeof one);
        std::memcpy(head.data() + 4, &background, sizeof background);
        return bytes_.find(head);
    }

    ScratchFolder scratch_;
    fs::path file_ = scratch_ / "grids.vdb";
    std::string bytes_;
};

openvdb::FloatGrid::Ptr smallGrid() {
    auto grid = openvdb::FloatGrid::create(0.75f);
    grid->setName("density");
    for (int i = 0; i < 40; ++i) grid->tree().setValueOn(openvdb::Coord(i, i % 7, i % 3), float(i));
    grid->tree().addTile(1, openvdb::Coord(64, 0, 0), 9, true);
    return grid;
}

TEST_F(VdbDamageTest, RefusesEveryTruncation) {
    for (const std::uint32_t compression : {0u, 3u, 6u}) {
        write({smallGrid(), lumpyGrid<openvdb::Vec3DGrid>("velocity", 2)}, compression);
        for (std::size_t size = 0; size < bytes_.size(); size += size < 400 ? 1 : bytes_.size() / 61)
            ASSERT_FALSE(errorsOf(bytes_.substr(0, size)).empty())
                << "accepted the first " << size << " of " << bytes_.size();
        EXPECT_THAT(errorsOf(bytes_), IsEmpty());
    }
}

// Without offsets nothing in the head tells where the file should end.
TEST_F(VdbDamageTest, RefusesEveryTruncationOfAStream) {
    {
        std::ofstream out(file_, std::ios::binary);
        openvdb::io::Stream(out).write(openvdb::GridPtrVec{smallGrid(), smallGrid()});
    }
    bytes_ = readFile(file_);
    for (std::size_t size = 0; size < bytes_.size(); size += size < 400 ? 1 : 397)
        ASSERT_FALSE(errorsOf(bytes_.substr(0, size)).empty())
            << "accepted the first " << size << " of " << bytes_.size();
    EXPECT_THAT(errorsOf(bytes_), IsEmpty());
}

TEST_F(VdbDamageTest, SurvivesFlippedBytes) {
    std::mt19937 random(1);
    std::size_t refused = 0, rounds = 0;
    for (const std::uint32_t compression : {0u, 1u, 2u, 3u, 4u, 6u}) {
        write({smallGrid(), lumpyGrid<openvdb::BoolGrid>("mask", 1)}, compression);
        for (int round = 0; round < 400; ++round, ++rounds) {
            std::string damaged = bytes_;
            // Where a flip says something: in the heads, and in the small tree of the first grid.
            const std::size_t range = round % 2 ? damaged.size() : std::size_t(1500);
            for (int flips = 1 << random() % 5; flips > 0; --flips)
                damaged[random() % range] ^= char(1 << random() % 8);
            refused += !errorsOf(damaged).empty();
        }
    }
    EXPECT_GT(refused, rounds / 8);
}

// Any 32-bit number of a tree's head as a huge one: counts, positions and lengths among them.
TEST_F(VdbDamageTest, SurvivesHugeNumbersInBoundedMemory) {
    write({smallGrid()}, 6);
    const std::size_t tree = treeBegin(0.75f);
    ASSERT_NE(tree, std::string::npos);
    for (std::size_t at = 0; at + 4 < bytes_.size(); at += at < tree + 100 ? 1 : 37)
        for (const std::uint32_t number : {0xffffffffu, 0x7fffffffu, 0x10000000u}) {
            std::string damaged = bytes_;
            std::memcpy(damaged.data() + at, &number, sizeof number);
            (void)errorsOf(damaged);
        }
    rusage usage{};
    ::getrusage(RUSAGE_SELF, &usage);
    EXPECT_LT(usage.ru_maxrss, 1'500'000)
        << "KiB, in a process that holds libopenvdb and what other tests left";
}

TEST_F(VdbDamageTest, SaysWhatIsWrongAndWhere) {
    write({smallGrid()}, 2);
    const std::size_t tree = treeBegin(0.75f);
    ASSERT_NE(tree, std::string::npos);
    const auto only = [&](std::size_t at, char flip) {
        std::string damaged = bytes_;
        damaged[at] ^= flip;
        const auto errors = errorsOf(damaged);
        return errors.empty() ? std::string("nothing") : errors[0].message;
    };
    EXPECT_THAT(only(tree + 16, 1),
                HasSubstr("grid 'density': its tree has a branch at an impossible position"));
    EXPECT_THAT(only(tree + 11, 1), HasSubstr("its tree is cut off or damaged, at byte"));  // 2^24 tiles
    // Behind the root's three numbers and an origin: two masks of 4096 bytes and a node's code.
    EXPECT_THAT(only(tree + 28 + 8192, 64), HasSubstr("a node has the unknown code 64, at byte"));
    // The last leaf's record is the file's end: 64 bytes of mask, a code, its active values.
    EXPECT_THAT(only(bytes_.size() - 4 * 8 - 1 - 10, 1), HasSubstr("has two masks that differ"));
}

TEST_F(VdbDamageTest, PackedBytesThatDoNotUnpackAreFoundByTheirRead) {
    for (const std::uint32_t codec : {1u, 4u}) {
        write({lumpyGrid<openvdb::FloatGrid>("density", 1)}, codec | 2u);
        std::string damaged = bytes_;
        // All but the lengths: what zlib and blosc are given is noise.
        for (std::size_t i = bytes_.size() - 200; i < bytes_.size(); ++i) damaged[i] = char(i * 7919 >> 3);
        const auto errors = errorsOf(damaged);
        ASSERT_FALSE(errors.empty());
    }
}

// Tiles can be stored in a thousandth of their size. A tree of them is refused before it takes gigabytes.
TEST_F(VdbDamageTest, TilesThatUnpackToMoreThanTheFileAccountsForAreRefused) {
    auto grid = openvdb::FloatGrid::create();
    grid->setName("tiles");
    for (int node = 0; node < 400; ++node)
        for (int i = 0; i < 32 * 32 * 32; ++i)
            grid->tree().addTile(
                2, openvdb::Coord(4096 * node + 128 * (i >> 10), 128 * (i >> 5 & 31), 128 * (i & 31)),
                float(1 + i % 2), false);
    write({grid}, openvdb::io::COMPRESS_ZIP);
    grid.reset();
    ASSERT_LT(bytes_.size(), 5'000'000u);
    const auto errors = errorsOf(bytes_);
    ASSERT_FALSE(errors.empty());
    EXPECT_THAT(errors[0].message, HasSubstr("more nodes and tiles than can be read"));
}

// uniformOver has no error to give. A planner that descends wherever nothing is known must come to an end,
// and to the read that fails.
TEST_F(VdbDamageTest, APlanOfADamagedGridEndsAndItsReadFails) {
    write({smallGrid()}, 2);
    bytes_[bytes_.size() - 43] ^= 1;
    writeFile(file_, bytes_);
    const auto contents = openVdb(file_, {});
    ASSERT_TRUE(contents) << contents.error().message;
    const FieldSource& field = *contents->fields.at(0);
    const auto plan = OctreePlan::make(field, BrickShape{});
    ASSERT_TRUE(plan);
    ASSERT_FALSE(plan->chunks().empty());
    EXPECT_LE(plan->chunks().size(), 8u);
    for (const NodeKey& chunk : plan->chunks()) {
        SampleBlock at_chunk;
        EXPECT_FALSE(field.read(closedRegion(chunk, BrickShape{}), at_chunk));
    }
    SampleBlock block;
    EXPECT_FALSE(field.read({{50, 50, 50}, {52, 52, 52}}, block));
    field.release();
    EXPECT_FALSE(field.read({{50, 50, 50}, {52, 52, 52}}, block)) << "an error is for good";
}

TEST_F(VdbDamageTest, AFileThatChangesWhileItIsReadIsRefused) {
    for (const bool cut : {false, true}) {
        write({lumpyGrid<openvdb::FloatGrid>("density", 1)}, 6);
        const auto contents = openVdb(file_, {});
        ASSERT_TRUE(contents);
        const FieldSource& field = *contents->fields.at(0);
        SampleBlock block;
        ASSERT_TRUE(field.read({{0, 0, 0}, {8, 8, 8}}, block));
        if (cut)
            fs::resize_file(file_, bytes_.size() / 2);
        else
            std::ofstream(file_, std::ios::app) << "more";
        const auto read = field.read({{-20, -7, 3}, {9, 30, 51}}, block);
        ASSERT_FALSE(read);
        EXPECT_THAT(read.error().message, HasSubstr("changed while it was being read"));
    }
}

TEST_F(VdbDamageTest, ThreadsReadTheSameAsOne) {
    write({lumpyGrid<openvdb::FloatGrid>("a", 1), lumpyGrid<openvdb::Vec3SGrid>("b", 2)}, 6);
    InputOptions options;
    options.memory_bytes = 400'000;  // a cache that is always full
    const auto one = openVdb(file_, options), many = openVdb(file_, options);
    ASSERT_TRUE(one && many);
    std::vector<std::thread> threads;
    std::atomic<int> different = 0;
    for (unsigned t = 0; t < 4; ++t)
        threads.emplace_back([&, t] {
            std::mt19937 random(t);
            for (int round = 0; round < 150; ++round) {
                const std::size_t field = random() % 2;
                IndexBox box;
                for (std::size_t a = 0; a < 3; ++a) {
                    box.begin[a] = std::int64_t(random() % 60) - 30;
                    box.end[a] = box.begin[a] + 1 + std::int64_t(random() % 24);
                }
                SampleBlock block, again;
                if (!many->fields[field]->read(box, block) || !one->fields[field]->read(box, again) ||
                    block.values != again.values || block.active != again.active)
                    ++different;
                (void)many->fields[field]->uniformOver(box);
                (void)many->fields[field]->info().active_voxels;
            }
        });
    for (std::thread& thread : threads) thread.join();
    EXPECT_EQ(different, 0);
}

TEST(VdbLeafCache, KeepsWhatWasUsedLastWithinItsBudget) {
    constexpr std::size_t kLeafBytes = 2112;
    constexpr std::uint64_t kBudget = 1u << 20;
    VdbLeafCache cache(kBudget);
    const auto leaf = [] { return std::make_shared<std::byte[]>(kLeafBytes); };
    for (std::uint32_t i = 0; i < 5000; ++i) {
        cache.insert(0, i, leaf(), kLeafBytes);
        EXPECT_TRUE(cache.find(0, 0)) << "asked for all the time, gone after " << i;
        ASSERT_LE(cache.usedBytes(), kBudget);
    }
    EXPECT_GT(cache.usedBytes(), kBudget / 2);
    EXPECT_FALSE(cache.find(0, 1));
    cache.insert(1, 7, leaf(), kLeafBytes);
    cache.forget(0);
    EXPECT_FALSE(cache.find(0, 4999));
    EXPECT_TRUE(cache.find(1, 7));
}

}  // namespace
}  // namespace brickyard

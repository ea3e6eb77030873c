#include "core/octree_builder.h"

#include <gmock/gmock.h>

#include <random>
#include <thread>

#include "blob_field.h"
#include "core/octree_plan.h"
#include "stored_frame.h"

namespace brickyard {
namespace {

BuildOptions optionsFor(int edge, double max_error = 0) {
    BuildOptions options;
    options.shape.edge_cells = edge;
    options.max_error = max_error;
    return options;
}

// Random positions inside a node's closed region, its corners and faces among them.
template <class Visit>
void forPositions(const StoredNode& node, BrickShape shape, int count, std::mt19937& random, Visit&& visit) {
    const IndexBox box = closedRegion(node.key, shape);
    for (int i = 0; i < count; ++i) {
        double p[3];
        for (std::size_t a = 0; a < 3; ++a) {
            const double extent = double(box.extent(int(a)) - 1);
            const int kind = std::uniform_int_distribution(0, 4)(random);
            p[a] = double(box.begin[a]) + (kind == 0   ? 0
                                           : kind == 1 ? extent
                                                       : std::uniform_real_distribution(0.0, extent)(random));
            if (kind == 2) p[a] = std::floor(p[a]);
        }
        visit(p[0], p[1], p[2]);
    }
}

double trilinear(const FormulaField& field, double x, double y, double z, int component = 0) {
    const double f[3] = {std::floor(x), std::floor(y), std::floor(z)}, t[3] = {x - f[0], y - f[1], z - f[2]};
    double sum = 0;
    for (int q = 0; q < 8; ++q) {
        const double w =
            ((q & 1) ? t[0] : 1 - t[0]) * ((q & 2) ? t[1] : 1 - t[1]) * ((q & 4) ? t[2] : 1 - t[2]);
        if (w != 0)
            sum += w * field.at(std::int64_t(f[0]) + (q & 1), std::int64_t(f[1]) + (q >> 1 & 1),
                                std::int64_t(f[2]) + (q >> 2), component);
    }
    return sum;
}

TEST(OctreeBuilderTest, LevelZeroIsTheSourceBitForBit) {
    const FormulaField field = roughBlobField();
    const StoredFrame frame(field, optionsFor(8));
    std::size_t bricks = 0;
    for (const StoredNode& node : frame.nodes()) {
        if (node.key.level != 0) continue;
        ++bricks;
        for (int k = 0; k <= 8; ++k)
            for (int j = 0; j <= 8; ++j)
                for (int i = 0; i <= 8; ++i)
                    ASSERT_EQ(node.samples[frame.shape().sampleAt(i, j, k)],
                              field.at(node.key.x * 8 + i, node.key.y * 8 + j, node.key.z * 8 + k))
                        << toString(node.key) << " sample " << i << " " << j << " " << k;
    }
    EXPECT_GT(bricks, 100u);
    EXPECT_EQ(frame.footer().channels(0).error_made(), 0);
}

TEST(OctreeBuilderTest, NoNodeStraysBeyondItsBoundAnywhere) {
    std::mt19937 random(1);
    for (const int edge : {8, 16})
        for (const double background : {0.0, 0.37}) {
            FormulaField field(
                "density", {{-30, -25, -20}, {31, 26, 37}},
                [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                    return roughBlob(double(x), double(y), double(z)) - 0.1;
                },
                SampleType::kFloat32, 1, background);
            const StoredFrame frame(field, optionsFor(edge));
            for (const StoredNode& node : frame.nodes())
                forPositions(node, frame.shape(), 300, random, [&](double x, double y, double z) {
                    const double deviation = std::abs(frame.field(node, x, y, z) - trilinear(field, x, y, z));
                    ASSERT_LE(deviation, double(node.record.bound) + 1e-9)
                        << toString(node.key) << " at " << x << " " << y << " " << z;
                });
        }
}

// Every error of every node above level 0, against a visit of all level-0 samples. Gives how many nodes stand
// above a chunk: their bounds are true, the others' are exact.
std::size_t expectErrorsAsComputedDirectly(const FormulaField& field, const StoredFrame& frame) {
    const int n = 8;
    std::size_t inner = 0, above_chunks = 0;
    for (const StoredNode& node : frame.nodes()) {
        if (node.key.level == 0) continue;
        ++inner;
        const std::int64_t edge = std::int64_t(n) << node.key.level, part = edge / kErrorGridEdge;
        double squares = 0, largest = 0;
        std::vector<double> box_squares(kErrorGridCells), box_largest(kErrorGridCells);
        for (std::int64_t z = 0; z <= edge; ++z)
            for (std::int64_t y = 0; y <= edge; ++y)
                for (std::int64_t x = 0; x <= edge; ++x) {
                    const std::int64_t px = node.key.x * edge + x, py = node.key.y * edge + y,
                                       pz = node.key.z * edge + z;
                    const double d =
                        frame.field(node, double(px), double(py), double(pz)) - field.at(px, py, pz);
                    largest = std::max(largest, std::abs(d));
                    if (x == edge || y == edge || z == edge) continue;
                    squares += d * d;
                    const std::size_t box =
                        std::size_t(x / part + kErrorGridEdge * (y / part + kErrorGridEdge * (z / part)));
                    box_squares[box] += d * d;
                    box_largest[box] = std::max(box_largest[box], std::abs(d));
                }
        const double rms = std::sqrt(squares / std::pow(double(edge), 3));
        EXPECT_NEAR(double(node.record.rms), rms, 1e-6 * rms + 1e-12) << toString(node.key);
        if (node.key.level <= chunkSteps(frame.shape())) {
            EXPECT_NEAR(double(node.record.bound), largest, 1e-6 * largest + 1e-12) << toString(node.key);
        } else {
            ++above_chunks;
            EXPECT_GE(double(node.record.bound) * (1 + 1e-6), largest) << toString(node.key);
            EXPECT_LE(double(node.record.bound), 3 * largest) << toString(node.key);
        }
        EXPECT_TRUE(node.grid || !node.record.hasBrick()) << toString(node.key);
        if (!node.grid) continue;
        for (std::size_t b = 0; b < std::size_t(kErrorGridCells); ++b) {
            const double box_rms = std::sqrt(box_squares[b] / std::pow(double(part), 3));
            const double stored_rms = double(errorFromCode(node.grid->rms[b], node.record.bound));
            const double stored_bound = double(errorFromCode(node.grid->bound[b], node.record.bound));
            // Rounded up by no more than an eighth of an octave.
            EXPECT_GE(stored_rms * (1 + 1e-6), box_rms) << toString(node.key) << " box " << b;
            EXPECT_LE(stored_rms, box_rms * 1.0906 + 1e-9 * double(node.record.bound))
                << toString(node.key) << " box " << b;
            EXPECT_GE(stored_bound * (1 + 1e-6), box_largest[b]) << toString(node.key) << " box " << b;
        }
    }
    EXPECT_GT(inner, 20u);
    return above_chunks;
}

TEST(OctreeBuilderTest, RmsAndGridsEqualADirectComputation) {
    const FormulaField field = roughBlobField();
    EXPECT_EQ(expectErrorsAsComputedDirectly(field, StoredFrame(field, optionsFor(8))), 0u);
}

// A chunk has 64 voxels an edge with bricks of 8: six of them here, levels 4 and 5 above, and regions of one
// value in both.
TEST(OctreeBuilderTest, RmsAndBoundsHoldAboveAChunk) {
    const FormulaField field("density", {{-40, -12, 3}, {230, 30, 50}},
                             [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                                 if (x > 60 && x < 150) return 0.75;
                                 return 1.5 * roughBlob(double(x % 60), double(y), double(z - 20));
                             });
    const StoredFrame frame(field, optionsFor(8));
    EXPECT_GT(expectErrorsAsComputedDirectly(field, frame), 3u);
    // Not a byte depends on what is put into the scratch file instead of memory.
    const ScratchFolder scratch;
    BuildOptions options = optionsFor(8);
    options.scratch_folder = scratch.path();
    options.memory_bytes = 1;
    const StoredFrame tight(field, options);
    ASSERT_EQ(tight.nodes().size(), frame.nodes().size());
    for (std::size_t i = 0; i < frame.nodes().size(); ++i) {
        const NodeRecord &a = frame.nodes()[i].record, &b = tight.nodes()[i].record;
        EXPECT_EQ(a.payload_offset, b.payload_offset);
        EXPECT_EQ(a.payload_checksum, b.payload_checksum);
        EXPECT_EQ(a.rms, b.rms);
        EXPECT_EQ(a.bound, b.bound);
    }
}

TEST(OctreeBuilderTest, RangesAndBoxesHoldWhatIsBelowThem) {
    const FormulaField field = roughBlobField();
    const StoredFrame frame(field, optionsFor(8));
    std::mt19937 random(2);
    for (const StoredNode& node : frame.nodes()) {
        const double edge = std::ldexp(1.0, node.key.level);
        forPositions(node, frame.shape(), 100, random, [&](double x, double y, double z) {
            for (const double value : {frame.field(node, x, y, z), trilinear(field, x, y, z)}) {
                EXPECT_GE(value, double(node.record.value_min) - 1e-7);
                EXPECT_LE(value, double(node.record.value_max) + 1e-7);
            }
            const double p[3] = {x / edge - node.key.x * 8.0, y / edge - node.key.y * 8.0,
                                 z / edge - node.key.z * 8.0};
            bool inside = true;
            for (std::size_t a = 0; a < 3; ++a)
                inside &= p[a] >= node.record.box_begin[a] && p[a] <= node.record.box_end[a];
            if (!inside) {
                EXPECT_EQ(frame.field(node, x, y, z), 0) << toString(node.key) << " outside its box";
            }
        });
    }
}

TEST(OctreeBuilderTest, AnErrorIsKeptAndReportedAsItIs) {
    const FormulaField field = roughBlobField();
    for (const double error : {0.2, 0.01, 1e-4}) {
        const StoredFrame frame(field, optionsFor(8, error));
        double worst = 0;
        for (const StoredNode& node : frame.nodes()) {
            if (!node.leaf) continue;
            const IndexBox box = closedRegion(node.key, frame.shape());
            for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
                for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y)
                    for (std::int64_t x = box.begin[0]; x < box.end[0]; ++x)
                        worst = std::max(worst, std::abs(frame.field(node, double(x), double(y), double(z)) -
                                                         field.at(x, y, z)));
        }
        EXPECT_LE(worst, error);
        EXPECT_NEAR(worst, frame.footer().channels(0).error_made(), 1e-9 + 1e-6 * worst);
    }
}

TEST(OctreeBuilderTest, SmoothRegionsEndAtACoarseLeafWhereTheErrorAllowsIt) {
    // A gentle ramp: level 1 says it as well as level 0, but for the edges of its box.
    const FormulaField ramp(
        "density", {{0, 0, 0}, {64, 64, 64}},
        [](std::int64_t x, std::int64_t y, std::int64_t, int) { return 1 + 0.001 * double(x + y); });
    const StoredFrame exact(ramp, optionsFor(8)), loose(ramp, optionsFor(8, 0.01));
    EXPECT_LT(loose.nodes().size(), exact.nodes().size());
    EXPECT_THAT(loose.nodes(), testing::Contains(testing::Truly([](const StoredNode& n) {
                    return n.leaf && n.key.level > 0 && n.record.hasBrick();
                })));
}

TEST(OctreeBuilderTest, ARegionOfOneValueIsALeafWithoutABrick) {
    const FormulaField box("density", {{0, 0, 0}, {129, 129, 129}},
                           [](std::int64_t, std::int64_t, std::int64_t, int) { return 2.5; });
    const StoredFrame frame(box, optionsFor(8));
    bool coarse = false;
    for (const StoredNode& node : frame.nodes())
        if (!node.record.hasBrick()) {
            EXPECT_TRUE(node.leaf);
            EXPECT_TRUE(node.record.active);
            EXPECT_EQ(node.samples[0], 2.5);
            coarse |= node.key.level >= 2;
        }
    EXPECT_TRUE(coarse) << "a box of 129 voxels has room for nodes of 8 * 4 cells";
}

TEST(OctreeBuilderTest, EveryTypeComesBackExactly) {
    for (const SampleType type :
         {SampleType::kFloat64, SampleType::kInt32, SampleType::kInt64, SampleType::kBool})
        for (const int components : {1, 3}) {
            const FormulaField field(
                "any", {{-3, -5, -7}, {12, 9, 5}},
                [&](std::int64_t x, std::int64_t y, std::int64_t z, int c) {
                    const double v = double((x * 7 + y * 13 + z * 29 + c * 5) % 23);
                    return type == SampleType::kBool ? double(std::int64_t(std::abs(v)) & 1) : v * 1001.5;
                },
                type, components);
            const StoredFrame frame(field, optionsFor(8));
            for (const StoredNode& node : frame.nodes()) {
                if (node.key.level != 0) continue;
                for (int c = 0; c < components; ++c)
                    for (int i = 0; i <= 8; ++i)
                        ASSERT_EQ(node.samples[std::size_t(c) * frame.shape().samples() +
                                               frame.shape().sampleAt(i, i, 8 - i)],
                                  field.at(node.key.x * 8 + i, node.key.y * 8 + i, node.key.z * 8 + 8 - i, c))
                            << toString(type) << " component " << c;
            }
        }
}

TEST(OctreeBuilderTest, VoxelsAtBothEndsOfInt32HaveABrickEach) {
    constexpr std::int64_t kLow = INT32_MIN, kHigh = INT32_MAX;
    // Two fields, each one voxel: a formula over all of int32 could not be asked sample by sample.
    for (const std::int64_t at : {kLow, kHigh}) {
        const FormulaField voxel("density", {{at, at, at}, {at + 1, at + 1, at + 1}},
                                 [](std::int64_t, std::int64_t, std::int64_t, int) { return 1.0; });
        const StoredFrame frame(voxel, optionsFor(16));
        double most = 0;
        for (const StoredNode& node : frame.nodes())
            if (node.key.level == 0)
                for (double v : node.samples) most = std::max(most, v);
        EXPECT_EQ(most, 1) << at;
    }
}

TEST(OctreeBuilderTest, TheFileIsTheSameForAnyNumberOfThreads) {
    const FormulaField field = roughBlobField();
    const FieldSource* const fields[] = {&field};
    ScratchFolder folder;
    std::vector<std::string> files;
    for (const unsigned threads : {1u, 3u}) {
        BuildOptions options = optionsFor(8);
        options.parallel_for = [threads](std::size_t n, const std::function<void(std::size_t)>& body) {
            std::atomic<std::size_t> next{0};
            std::vector<std::jthread> pool;
            for (unsigned t = 0; t < threads; ++t)
                pool.emplace_back([&] {
                    for (std::size_t i = next++; i < n; i = next++) body(i);
                });
        };
        auto writer = FrameWriter::create(folder / "f.brk");
        auto footer = buildFrame(fields, std::span(&options, 1), **writer);
        ASSERT_TRUE(footer);
        ASSERT_TRUE((*writer)->finish(*footer));
        files.push_back(readFile(folder / "f.brk"));
    }
    EXPECT_TRUE(files[0] == files[1]);
}

TEST(OctreeBuilderTest, NonFiniteValuesAreNamedOrReplaced) {
    const FormulaField field(
        "density", {{0, 0, 0}, {20, 20, 20}}, [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
            return x == 3 && y == 4 && z == 5 ? std::nan("") : x == 6 ? -INFINITY : 1.0 + double(y);
        });
    const FieldSource* const fields[] = {&field};
    ScratchFolder folder;
    BuildOptions options = optionsFor(8);
    auto writer = FrameWriter::create(folder / "f.brk");
    const auto refused = buildFrame(fields, std::span(&options, 1), **writer);
    ASSERT_FALSE(refused);
    EXPECT_THAT(refused.error().message, testing::HasSubstr("density"));
    EXPECT_THAT(refused.error().message, testing::HasSubstr("(6, 0, 0)"));

    options.nonfinite = NonFinite::kZero;
    const StoredFrame zero(field, options);
    options.nonfinite = NonFinite::kClamp;
    const StoredFrame clamped(field, options);
    const NodeKey key{0, 0, 0, 0};
    EXPECT_EQ(zero.find(key)->samples[zero.shape().sampleAt(6, 1, 1)], 0);
    EXPECT_EQ(clamped.find(key)->samples[zero.shape().sampleAt(6, 1, 1)],
              -double(std::numeric_limits<float>::max()));
    EXPECT_EQ(clamped.find(key)->samples[zero.shape().sampleAt(3, 4, 5)], 0);
}

}  // namespace
}  // namespace brickyard

// Light in a dataset: known answers, and nothing of what was there changed.
#include "tools/bake/bake.h"

#include <gmock/gmock.h>

#include <cmath>

#include "blob_field.h"
#include "client/scene.h"
#include "stored_fields.h"
#include "tools/dataset_check.h"
#include "tools/field_reader.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

constexpr double kDensity = 0.25, kScale = 0.5;
// Voxels of the box, the last included.
constexpr std::int64_t kLow = -3, kHigh = 8;

FormulaField constantBox() {
    return FormulaField("density", {{kLow, kLow, kLow}, {kHigh + 1, kHigh + 1, kHigh + 1}},
                        [](std::int64_t, std::int64_t, std::int64_t, int) { return kDensity; });
}

// Optical depth from z to infinity along +z, inside the box in x and y: the field falls to 0 within a voxel.
double depthAbove(double z) {
    if (z >= kHigh) return kScale * kDensity * 0.5 * std::pow(std::max(0.0, kHigh + 1 - z), 2);
    return kScale * kDensity *
           ((kHigh - std::max(z, double(kLow))) + 0.5 +
            (z < kLow ? 0.5 - 0.5 * std::pow(1 - (kLow - z), 2) : 0));
}

class BakeTest : public testing::Test {
protected:
    std::filesystem::path dataset() const { return folder_ / "box.bricks"; }
    std::filesystem::path lit() const { return folder_ / "lit.bricks"; }
    void store(const std::vector<const FieldSource*>& fields, std::uint32_t frame = 0) {
        const Result<void> stored = storeFields(dataset(), fields, 8, 0, frame);
        ASSERT_TRUE(stored) << stored.error().message;
    }
    void storeBox() {
        const FormulaField field = constantBox();
        store({&field});
    }
    BakeOptions options(const std::string& scene) const {
        BakeOptions options;
        options.dataset = dataset();
        options.output = lit();
        options.scene = *readScene(scene);
        options.max_error = 0;
        options.jobs = 2;
        return options;
    }
    void expectRefused(const BakeOptions& options, const std::string& what) const {
        const auto baked = bake(options);
        ASSERT_FALSE(baked) << "baked what should say: " << what;
        EXPECT_THAT(baked.error().message, HasSubstr(what));
        EXPECT_EQ(baked.error().message.find('\n'), std::string::npos);
    }
    // The folder holds nothing but what it held.
    void expectNothingLeft(std::size_t entries) const {
        std::size_t found = 0;
        for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder_.path()))
            ++found;
        EXPECT_EQ(found, entries);
    }
    static std::shared_ptr<const BrickStore> open(const std::filesystem::path& folder,
                                                  std::uint32_t frame = 0) {
        const auto dataset = Dataset::open(folder);
        EXPECT_TRUE(dataset) << dataset.error().message;
        const auto store = dataset->openFrame(frame);
        EXPECT_TRUE(store) << store.error().message;
        return *store;
    }
    struct Light {
        std::shared_ptr<const BrickStore> store;
        std::unique_ptr<FieldReader> reader;
        SampleBlock block;
        IndexBox box;
        double at(std::int64_t x, std::int64_t y, std::int64_t z) const {
            return toDouble(SampleType::kFloat32,
                            sampleBits(SampleType::kFloat32, block.values, index(x, y, z)));
        }
        bool active(std::int64_t x, std::int64_t y, std::int64_t z) const {
            return block.active[index(x, y, z)] != 0;
        }
        std::size_t index(std::int64_t x, std::int64_t y, std::int64_t z) const {
            return std::size_t(x - box.begin[0] +
                               box.extent(0) * (y - box.begin[1] + box.extent(1) * (z - box.begin[2])));
        }
    };
    Light light(const std::string& name, std::int64_t low = kLow - 3, std::int64_t high = kHigh + 4) const {
        Light light;
        light.store = open(lit());
        light.reader = std::make_unique<FieldReader>(light.store, *findChannel(*light.store, name));
        light.box = {{low, low, low}, {high, high, high}};
        EXPECT_TRUE(light.reader->read(light.box, light.block));
        return light;
    }

    ScratchFolder folder_;
    const std::string medium_ = R"("medium":{"density_scale":0.5})";
    const std::string down_ = R"({"direction":[0,0,-1]})";
};

TEST_F(BakeTest, AConstantBoxHasAClosedForm) {
    storeBox();
    const auto baked = bake(options("{" + medium_ + R"(,"lights":[)" + down_ + "]}"));
    ASSERT_TRUE(baked) << baked.error().message;
    EXPECT_EQ(baked->channels, std::vector<std::string>{"light.0"});
    const Light lit = light("light.0");
    for (std::int64_t z = lit.box.begin[2]; z < lit.box.end[2]; ++z)
        for (std::int64_t y = lit.box.begin[1]; y < lit.box.end[1]; ++y)
            for (std::int64_t x = lit.box.begin[0]; x < lit.box.end[0]; ++x) {
                const auto within = [](std::int64_t v, std::int64_t by) {
                    return v >= kLow - by && v <= kHigh + by;
                };
                const bool medium = within(x, 1) && within(y, 1) && within(z, 1);
                EXPECT_EQ(lit.active(x, y, z), medium) << x << " " << y << " " << z;
                // A ray along an outer face runs where the field has fallen to 0.
                const bool shadowed = medium && within(x, 0) && within(y, 0);
                EXPECT_NEAR(lit.at(x, y, z), shadowed ? std::exp(-depthAbove(double(z))) : 1, 1e-6)
                    << x << " " << y << " " << z;
            }
    const ChannelFooter& channel = lit.reader->channel();
    EXPECT_EQ(channel.active_voxels(), 14u * 14 * 14);
    EXPECT_EQ(channel.active_min(0), kLow - 1);
    EXPECT_EQ(channel.active_max(2), kHigh + 1);
}

TEST_F(BakeTest, NearLightsEndWhereTheyAreAndAnEnvironmentIsItsMean) {
    storeBox();
    const auto baked = bake(options("{" + medium_ + R"(,"lights":[
        {"type":"point","position":[2,2,4]},
        {"type":"spot","position":[2,2,30],"direction":[0,0,-1]},
        {"type":"environment","radiance":[1,1,1],"samples":64},
        {"direction":[0,0,1]}]})"));
    ASSERT_TRUE(baked) << baked.error().message;
    EXPECT_NEAR(light("light.0").at(2, 2, 0), std::exp(-kScale * kDensity * 4), 1e-6);
    EXPECT_EQ(light("light.0").at(2, 2, 4), 1);
    EXPECT_NEAR(light("light.1").at(2, 2, 0), std::exp(-depthAbove(0)), 1e-6);
    EXPECT_NEAR(light("light.3").at(2, 2, 5), std::exp(-(kScale * kDensity * (5 - kLow + 0.5))), 1e-6);
    // The middle sees the sky through between half and all of the diagonal; a corner's outer octant is clear.
    const Light sky = light("light.2");
    EXPECT_LT(sky.at(2, 2, 2), std::exp(-kScale * kDensity * 5.5));
    EXPECT_GT(sky.at(2, 2, 2), std::exp(-kScale * kDensity * 6 * std::sqrt(3.0)));
    EXPECT_GT(sky.at(kLow - 1, kLow - 1, kLow - 1), 0.8);
}

TEST_F(BakeTest, WhatWasThereIsThereBitByBit) {
    const FormulaField density = roughBlobField();
    const FormulaField velocity(
        "velocity", {{-5, -5, -5}, {9, 8, 7}},
        [](std::int64_t x, std::int64_t y, std::int64_t z, int c) { return double(x + 2 * y - z) * (c + 1); },
        SampleType::kFloat32, 3);
    store({&density, &velocity});
    store({&velocity, &density}, 3);
    BakeOptions request = options(R"({"medium":{"density_scale":0.1},"lights":[{"direction":[1,-1,0.2]}]})");
    request.max_error = 0.002;
    const auto baked = bake(request);
    ASSERT_TRUE(baked) << baked.error().message;
    EXPECT_EQ(baked->frames.size(), 2u);
    for (const std::uint32_t frame : {0u, 3u}) {
        const auto before = open(dataset(), frame), after = open(lit(), frame);
        ASSERT_EQ(after->footer().channels_size(), 3);
        for (int c = 0; c < 2; ++c) {
            EXPECT_EQ(before->footer().channels(c).SerializeAsString(),
                      after->footer().channels(c).SerializeAsString());
            const FieldReader a(before, std::uint32_t(c)), b(after, std::uint32_t(c));
            const IndexBox box{{-40, -40, -40}, {45, 45, 45}};
            SampleBlock x, y;
            ASSERT_TRUE(a.read(box, x) && b.read(box, y));
            EXPECT_EQ(x.values, y.values);
            EXPECT_EQ(x.active, y.active);
        }
        const ChannelFooter& light = after->footer().channels(2);
        EXPECT_EQ(light.name(), "light.0");
        EXPECT_LE(light.error_made(), 0.002);
        EXPECT_GE(light.value_min(), -0.002);
        EXPECT_LE(light.value_max(), 1.002);
    }
    const CheckReport checked = checkDataset(lit(), serialFor, {});
    EXPECT_EQ(checked.frames, 2u);
    for (const CheckFault& fault : checked.faults) ADD_FAILURE() << fault.message;
}

TEST_F(BakeTest, ACoarserLevelHasItsVoxelsTwiceAsWide) {
    storeBox();
    BakeOptions request = options("{" + medium_ + R"(,"lights":[)" + down_ + "]}");
    request.level = 1;
    const auto baked = bake(request);
    ASSERT_TRUE(baked) << baked.error().message;
    const Light lit = light("light.0", -4, 8);
    EXPECT_EQ(lit.reader->indexToWorld().point({1, 2, 3}), glm::dvec3(2, 4, 6));
    for (std::int64_t z = -4; z < 8; ++z) {
        // All that an active voxel's cells touch.
        const bool active = 2 * z >= kLow - 2 && 2 * z <= kHigh + 2;
        EXPECT_EQ(lit.active(1, 1, z), active) << z;
        EXPECT_NEAR(lit.at(1, 1, z), active ? std::exp(-depthAbove(2.0 * double(z))) : 1, 1e-6) << z;
    }
}

TEST_F(BakeTest, ASceneMovesAndClipsTheMedium) {
    storeBox();
    const auto baked = bake(options(R"({"medium":{"density_scale":0.5,"sample_offset":[0.5,0.5,0.5]},
        "clip":{"planes":[{"point":[0,0,4.5],"normal":[0,0,-1]}]},"lights":[)" +
                                    down_ + "]}"));
    ASSERT_TRUE(baked) << baked.error().message;
    // Sample z = 1 lies at 1.5; the plane leaves 3 of what is above it.
    EXPECT_NEAR(light("light.0").at(2, 2, 1), std::exp(-kScale * kDensity * 3), 1e-6);
    EXPECT_EQ(light("light.0").reader->indexToWorld().point({0, 0, 0}), glm::dvec3(0));
}

TEST_F(BakeTest, RefusalsNameWhatToDoAndLeaveNothing) {
    storeBox();
    expectRefused(options("{}"), "no light");
    expectRefused(options(R"({"medium":{"density":"smoke"},"lights":[{}]})"), "smoke");
    BakeOptions absent = options(R"({"lights":[{}]})");
    absent.frames = *FrameSet::parse("0,7");
    expectRefused(absent, "no frame 7; there are 0");
    BakeOptions shifted = options(R"({"medium":{"sample_offset":[0.5,0,0]},"lights":[{}]})");
    shifted.level = 2;
    expectRefused(shifted, "sample_offset");
    BakeOptions stopped = options(R"({"lights":[{}]})");
    stopped.stop = [] { return true; };
    expectRefused(stopped, "stopped");
    expectNothingLeft(1);

    ASSERT_TRUE(bake(options(R"({"lights":[{}]})")));
    expectRefused(options(R"({"lights":[{}]})"), "--overwrite");
    BakeOptions again = options(R"({"lights":[{}]})");
    again.overwrite = true;
    EXPECT_TRUE(bake(again));
    BakeOptions twice = again;
    twice.dataset = lit();
    twice.output = folder_ / "twice.bricks";
    expectRefused(twice, "light.0");
    expectNothingLeft(2);
}

TEST_F(BakeTest, ADamagedBrickIsNamedAndNothingIsLeft) {
    const FormulaField density = roughBlobField();
    store({&density});
    const std::filesystem::path frame = dataset() / "frames/000000.brk";
    std::string bytes = readFile(frame);
    bytes[200] = char(bytes[200] ^ 1);
    writeFile(frame, bytes);
    expectRefused(options(R"({"lights":[{}]})"), "checksum");
    expectNothingLeft(1);
}

TEST_F(BakeTest, AnEmptyFrameHasAnEmptyLight) {
    const FormulaField empty("density", {{0, 0, 0}, {0, 0, 0}},
                             [](std::int64_t, std::int64_t, std::int64_t, int) { return 0.0; });
    store({&empty});
    const auto baked = bake(options(R"({"lights":[{}]})"));
    ASSERT_TRUE(baked) << baked.error().message;
    EXPECT_EQ(light("light.0").reader->channel().active_voxels(), 0u);
}

}  // namespace
}  // namespace brickyard

// Scenes that `brickyard scene` writes: taken by the binding, and right about what the data are.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openvdb/tools/LevelSetSphere.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <glm/geometric.hpp>
#include <random>

#include "client/world_settings.h"
#include "command_run.h"
#include "core/camera_framing.h"
#include "sample_grids.h"
#include "tools/scene_exposure.h"
#include "tools/scene_proposal.h"
#include "tools/scene_text.h"
#include "tools/velocity_fit.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

constexpr double kVoxel = 0.1;

// A smooth ball around `x`, and where it is a wind of 5 along x with a turn that the wind cannot explain.
openvdb::GridPtrVec windyGrids(double x) {
    auto density = openvdb::FloatGrid::create(0);
    auto velocity = openvdb::Vec3SGrid::create(openvdb::Vec3s(0));
    density->setName("density");
    velocity->setName("vel");
    density->setGridClass(openvdb::GRID_FOG_VOLUME);
    for (int k = -20; k <= 20; ++k)
        for (int j = -20; j <= 20; ++j)
            for (int i = -20; i <= 60; ++i) {
                const double r2 = (i - x) * (i - x) + j * j + k * k;
                if (r2 < 400) density->tree().setValueOn({i, j, k}, float(std::exp(-r2 / 60)));
                velocity->tree().setValueOn({i, j, k}, openvdb::Vec3s(5, 0, 0));
            }
    for (const openvdb::GridBase::Ptr& grid :
         {openvdb::GridBase::Ptr(density), openvdb::GridBase::Ptr(velocity)})
        grid->setTransform(openvdb::math::Transform::createLinearTransform(kVoxel));
    return {density, velocity};
}

// Large caches that are not part of the project; tests of them say so and skip where they are absent.
std::filesystem::path sharedData() {
    const char* const set = std::getenv("BRICKYARD_SHARED_DATA");
    return set ? set : BRICKYARD_TEST_DATA "/../../../shared/data";
}

class SceneCommandTest : public testing::Test {
protected:
    SceneCommandTest() { openvdb::initialize(); }

    std::string convert(const std::vector<std::string>& inputs, std::vector<std::string> options = {}) {
        const std::string dataset = (scratch_ / "a.bricks").string();
        std::vector<std::string> arguments{"convert", "--overwrite"};
        arguments.insert(arguments.end(), options.begin(), options.end());
        arguments.insert(arguments.end(), inputs.begin(), inputs.end());
        arguments.push_back(dataset);
        const Outcome outcome = runCommand(scratch_.path(), arguments);
        EXPECT_EQ(outcome.status, 0) << outcome.err;
        return dataset;
    }
    std::string convertGrids(const std::vector<openvdb::GridPtrVec>& frames) {
        std::vector<std::string> files;
        for (std::size_t i = 0; i < frames.size(); ++i) {
            files.push_back((scratch_ / ("a." + std::to_string(i + 1) + ".vdb")).string());
            writeGrids(files.back(), frames[i]);
        }
        return convert(files);
    }
    // What the command says, read again.
    Scene propose(const std::string& dataset, std::vector<std::string> options = {}) {
        std::vector<std::string> arguments{"scene", dataset};
        arguments.insert(arguments.end(), options.begin(), options.end());
        const Outcome outcome = runCommand(scratch_.path(), arguments);
        EXPECT_EQ(outcome.status, 0) << outcome.err;
        const auto scene = readScene(outcome.out);
        EXPECT_TRUE(scene) << outcome.out << scene.error().message;
        return scene ? *scene : Scene();
    }
    // Binds it to the frame it was made of.
    WorldSettings bound(const Scene& scene, const std::string& dataset, std::uint32_t frame) {
        const auto opened = Dataset::open(dataset);
        EXPECT_TRUE(opened);
        const auto store = opened->openFrame(frame);
        EXPECT_TRUE(store);
        footer_ = (*store)->footer();
        const BoundFrame frames[] = {{"", &footer_}};
        const auto world = bindWorld(scene, frames, {});
        EXPECT_TRUE(world) << world.error().message;
        return world ? *world : WorldSettings();
    }
    static std::string plume(int frame) {
        return BRICKYARD_TEST_DATA "/plume/plume.00" + std::to_string(frame) + ".vdb";
    }

    ScratchFolder scratch_;
    FrameFooter footer_;
};

SampledField fieldOf(const Dataset& dataset, std::uint32_t frame, const std::string& name, int finest = 0) {
    const auto store = dataset.openFrame(frame);
    EXPECT_TRUE(store);
    const auto index = findChannel(**store, name);
    EXPECT_TRUE(index);
    const auto field = SampledField::read(FieldReader(*store, *index), 1u << 21, finest);
    EXPECT_TRUE(field);
    return *field;
}

TEST_F(SceneCommandTest, AFireBecomesABlackBodyInSmokeOfSomeDepth) {
    const std::string dataset = convert({plume(18), plume(24), plume(30)});
    const Scene scene = propose(dataset);
    const Medium& medium = scene.medium();
    EXPECT_EQ(medium.density(), "density");
    EXPECT_EQ(medium.emission().channel(), "temperature");
    EXPECT_EQ(medium.emission().weight(), "flame");
    EXPECT_EQ(medium.velocity(), "velocity");
    EXPECT_NEAR(medium.velocity_scale(), 1.0 / 24, 1e-4) << "no two frames are neighbours";
    const WorldSettings world = bound(scene, dataset, 24);
    ASSERT_EQ(world.media.size(), 1u);

    const Dataset opened = *Dataset::open(dataset);
    const SampledField density = fieldOf(opened, 24, "density"), flame = fieldOf(opened, 24, "flame"),
                       heat = fieldOf(opened, 24, "temperature");
    const double depth = medium.density_scale() * medianColumn(density, 2);
    EXPECT_GT(depth, 2) << "optical depth of the median column";
    EXPECT_LT(depth, 4);
    // What burns is between dull red and yellow, and the core is bright without being a flash.
    const MediumEmission& emission = *world.media[0].emission;
    double hottest = 0;
    for (std::int64_t i = 0; i < heat.count(); ++i)
        hottest = std::max(hottest, emission.kelvin_offset + emission.kelvin_scale * double(heat.value(i)));
    EXPECT_GT(hottest, 2000);
    EXPECT_LT(hottest, 2450);
    const double seen = brightestColumns(
        density, medium.density_scale(),
        [&](std::int64_t i) {
            const glm::dvec3 c = emission.black_body->radiance(
                emission.kelvin_offset + emission.kelvin_scale * heat.at(density.world(i)));
            return emission.scale * std::max(0.0, flame.at(density.world(i))) * std::max({c.x, c.y, c.z});
        },
        2);
    EXPECT_GT(seen, 3);
    EXPECT_LT(seen, 8);
    EXPECT_LT(world.background[0], 0.02f) << "a fire is seen in the dark";
    EXPECT_EQ(world.lights.size(), 2u);
}

TEST_F(SceneCommandTest, FlamesWithoutATemperatureGlowByARamp) {
    const std::string dataset = convert({plume(24)}, {"--channel", "density,flame"});
    const Scene scene = propose(dataset);
    EXPECT_EQ(scene.medium().emission().channel(), "flame");
    EXPECT_EQ(scene.medium().emission().ramp().preset(), "fire");
    EXPECT_NEAR(scene.medium().emission().ramp().high(), 0.9, 0.1);
    EXPECT_GT(scene.medium().emission().scale(), 0);
    EXPECT_TRUE(bound(scene, dataset, 24).media.at(0).emission->ramp);
}

TEST_F(SceneCommandTest, SmokeAloneIsLightAndLit) {
    const std::string dataset = convert({plume(24)}, {"--channel", "density"});
    const Scene scene = propose(dataset);
    const WorldSettings world = bound(scene, dataset, 24);
    EXPECT_FALSE(world.media.at(0).emission);
    EXPECT_GT(world.media[0].albedo.x, 0.85);
    ASSERT_EQ(world.lights.size(), 2u);
    EXPECT_EQ(world.lights[0].kind, WorldLight::Kind::kDirectional);
    EXPECT_EQ(world.lights[1].kind, WorldLight::Kind::kEnvironment);
    // From the camera's side, from above.
    const auto& camera = scene.camera();
    const glm::dvec3 to_eye =
        glm::normalize(glm::dvec3(camera.eye(0) - camera.target(0), camera.eye(1) - camera.target(1),
                                  camera.eye(2) - camera.target(2)));
    EXPECT_GT(glm::dot(world.lights[0].to_light, to_eye), 0.3);
    EXPECT_GT(world.lights[0].to_light.z, 0.3);
    const Camera framed = frameChannel(footer_.channels(0), 4.0 / 3);
    for (int a = 0; a < 3; ++a) EXPECT_NEAR(camera.eye(a), framed.eye(a), 1e-3) << "the box is framed";
}

TEST_F(SceneCommandTest, ALevelSetBecomesASurface) {
    auto sphere = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(2, openvdb::Vec3f(0), 0.1f);
    sphere->setName("ball");
    const std::string dataset = convertGrids({{sphere}});
    const WorldSettings world = bound(propose(dataset), dataset, 1);
    EXPECT_TRUE(world.media.empty());
    ASSERT_EQ(world.surfaces.size(), 1u);
    EXPECT_EQ(world.surfaces[0].iso, 0);
    EXPECT_TRUE(world.surfaces[0].inside_below);
    EXPECT_NEAR(world.surfaces[0].ambient_occlusion, 0.1 * 4.6 * std::sqrt(3), 0.2);
    EXPECT_EQ(world.lights.size(), 2u);

    // With a smoke beside it both are drawn.
    const std::string both = convertGrids({{sphere, windyGrids(10)[0]}});
    const WorldSettings mix = bound(propose(both), both, 1);
    EXPECT_EQ(mix.media.size(), 1u);
    EXPECT_EQ(mix.surfaces.size(), 1u);
}

// A head: air, a skull of a tenth of the volume, and tissue in between.
TEST_F(SceneCommandTest, AScanGetsAWindowAroundWhatIsNotAir) {
    std::mt19937 random(5);
    std::string bytes;
    for (int z = 0; z < 40; ++z)
        for (int y = 0; y < 40; ++y)
            for (int x = 0; x < 40; ++x) {
                const double r = std::hypot(x - 20, y - 20, z - 20);
                const int value = r > 18 ? 5 : r > 16 ? 200 : 60;
                bytes.push_back(char(std::uint8_t(value + int(random() % 9))));
            }
    std::ofstream(scratch_ / "head.raw", std::ios::binary) << bytes;
    const std::string dataset = convert({(scratch_ / "head.raw").string()}, {"--raw", "40x40x40:uint8"});
    const Scene scene = propose(dataset);
    const Transfer& transfer = scene.medium().transfer();
    EXPECT_EQ(transfer.preset(), "bone");
    EXPECT_EQ(transfer.shading(), 0.6);
    EXPECT_EQ(scene.camera().up(2), 1) << "a head stands";
    const WorldSettings world = bound(scene, dataset, 0);
    const TransferFunction& function = *world.media.at(0).transfer;
    EXPECT_LT(function.most(0, 14), 0.01) << "air";
    EXPECT_LT(function.most(60, 69), 0.1) << "tissue";
    EXPECT_GT(function.at(205).opacity, 0.5) << "bone";

    // Without the skull all that is not air is a skin with something below.
    for (char& byte : bytes)
        if (std::uint8_t(byte) >= 200) byte = char(std::uint8_t(byte) - 140);
    std::ofstream(scratch_ / "soft.raw", std::ios::binary) << bytes;
    const std::string soft = convert({(scratch_ / "soft.raw").string()}, {"--raw", "40x40x40:uint8"});
    EXPECT_EQ(propose(soft).medium().transfer().preset(), "skin");
}

TEST_F(SceneCommandTest, TheUnitOfTheVelocityIsFoundFromTwoFrames) {
    // Three voxels a frame under a velocity of 5.
    const std::string dataset = convertGrids({windyGrids(10), windyGrids(13)});
    for (const char* frame : {"1", "2"}) {
        const Scene scene = propose(dataset, {"--frame", frame});
        EXPECT_EQ(scene.medium().velocity(), "vel");
        EXPECT_NEAR(scene.medium().velocity_scale(), 3 * kVoxel / 5, 0.003) << "at frame " << frame;
    }
    const Dataset opened = *Dataset::open(dataset);
    const SampledField d = fieldOf(opened, 1, "density", 1), v = fieldOf(opened, 1, "vel", 1),
                       next_d = fieldOf(opened, 2, "density", 1), next_v = fieldOf(opened, 2, "vel", 1);
    const VelocityFit fit = fitVelocityScale({d, v}, {next_d, next_v});
    EXPECT_NEAR(fit.scale, 0.06, 0.003);
    EXPECT_GT(fit.explained, 0.95);
    // What goes the other way is not explained, whatever the scale.
    EXPECT_LT(fitVelocityScale({next_d, next_v}, {d, v}).explained, 0.3);
}

// Mantaflow's velocities are cells a tenth of a time unit: nobody would guess it.
TEST_F(SceneCommandTest, TheUnitOfASolversVelocityIsFoundInItsCache) {
    const std::filesystem::path shared = sharedData();
    if (!std::filesystem::is_directory(shared)) GTEST_SKIP() << "no shared data at " << shared;
    std::vector<std::string> files;
    for (const char* frame : {"14", "15", "16", "17"})
        files.push_back(
            (shared / "sim/plume_fire_64" / ("fluid_data_00" + std::string(frame) + ".vdb")).string());
    const Dataset opened = *Dataset::open(convert(files));
    double least = 1, most = 0;
    for (const std::uint32_t frame : {14u, 15u, 16u}) {
        const auto proposal = proposeScene(opened, frame);
        ASSERT_TRUE(proposal) << proposal.error().message;
        EXPECT_GT(proposal->velocity_explained.value_or(0), 0.6) << "of the change to the next frame";
        least = std::min(least, proposal->scene.medium().velocity_scale());
        most = std::max(most, proposal->scene.medium().velocity_scale());
    }
    EXPECT_LT(most / least, 1.35) << "frames agree: " << least << " to " << most;
}

TEST_F(SceneCommandTest, TheCameraSeesAllOfTheSequence) {
    const std::string dataset = convertGrids({windyGrids(0), windyGrids(40)});
    const Scene first = propose(dataset, {"--frame", "1"}), last = propose(dataset, {"--frame", "2"});
    EXPECT_EQ(first.camera().SerializeAsString(), last.camera().SerializeAsString());
    EXPECT_NEAR(first.camera().target(0), 20 * kVoxel, 0.06) << "between where it is first and last";
}

TEST_F(SceneCommandTest, ColumnsAreMeasuredInWorldUnits) {
    auto grid = openvdb::FloatGrid::create(0);
    grid->setName("density");
    grid->fill(openvdb::CoordBBox({0, 0, 0}, {9, 19, 29}), 2.f);
    grid->setTransform(openvdb::math::Transform::createLinearTransform(0.5));
    const std::string dataset = convertGrids({{grid}});
    const SampledField density = fieldOf(*Dataset::open(dataset), 1, "density");
    // Columns along x are 10 voxels long, along y 20: 300 and 600 of them.
    EXPECT_NEAR(medianColumn(density, 2), 2 * 0.5 * 10, 1e-6);
    EXPECT_NEAR(medianColumn(density, 0), 2 * 0.5 * 20, 1e-6) << "across x: along z and y";
    // Emission 3 without extinction: its length; with much: the ratio of the two.
    const auto glow = [](std::int64_t) { return 3.0; };
    EXPECT_NEAR(brightestColumns(density, 0, glow, 2), 3 * 0.5 * 22, 1e-6)
        << "one sample more on either side";
    const auto thick_glow = [&](std::int64_t i) { return double(density.value(i)) > 0 ? 3.0 : 0.0; };
    const double thick = brightestColumns(density, 1, thick_glow, 2);
    EXPECT_NEAR(thick, 3 / 2.0, 0.1);
}

TEST_F(SceneCommandTest, TheFileIsWrittenInOrderAndOtherwiseNothing) {
    const std::string dataset = convert({plume(24)});
    const std::filesystem::path file = scratch_ / "scene.json";
    const Outcome outcome = runCommand(scratch_.path(), {"scene", dataset, "-o", file.string()});
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    EXPECT_EQ(outcome.out, "");
    const std::string text = readFile(file);
    std::size_t before = 0;
    for (const char* key : {"\n  \"camera\"", "\n  \"background\"", "\n  \"medium\"", "\n  \"lights\""}) {
        const std::size_t at = text.find(key);
        ASSERT_NE(at, std::string::npos) << key << " in " << text;
        EXPECT_GE(at, before) << key;
        before = at;
    }
    EXPECT_THAT(text, HasSubstr("\"up\": [0, 0, 1]")) << "rows on a line";
    EXPECT_THAT(text, testing::Not(HasSubstr("datasets")));
    const auto scene = readScene(file.string());
    ASSERT_TRUE(scene) << scene.error().message;
    EXPECT_EQ(*printScene(*scene), text) << "the same again";
}

TEST_F(SceneCommandTest, WhatCannotBeIsOneLine) {
    auto grid = openvdb::Vec3SGrid::create();
    grid->setName("vel");
    grid->tree().setValueOn({0, 0, 0}, openvdb::Vec3s(1));
    const std::string dataset = convertGrids({{grid}});
    const auto run = [&](const std::vector<std::string>& arguments) {
        return runCommand(scratch_.path(), arguments);
    };
    expectOneLineOf(run({"scene", dataset}), "no channel that could be drawn");
    expectOneLineOf(run({"scene", dataset, "--frame", "7"}), "7");
    expectOneLineOf(run({"scene", (scratch_ / "none.bricks").string()}), "none.bricks");
    const std::string smoke = convert({plume(24)});
    expectOneLineOf(run({"scene", smoke, "-o", (scratch_ / "none" / "a.json").string()}), "folder");
}

// The shared caches, where they are: every one gets a scene that binds.
TEST_F(SceneCommandTest, EverySharedCacheGetsAScene) {
    const std::filesystem::path shared = sharedData();
    if (!std::filesystem::is_directory(shared)) GTEST_SKIP() << "no shared data at " << shared;
    const std::pair<const char*, const char*> caches[] = {
        {"sim/plume_fire/fluid_data_0024.vdb", "black_body"},
        {"sim/plume_fire_64/fluid_data_0015.vdb", "black_body"},
        {"sim/jets_256/fluid_data_0003.vdb", "density_scale"},
        {"sim/liquid/fluid_data_0006.vdb", "\"channel\": \"phi\""},
        {"vdb/smoke_houdini.vdb", "density_scale"},
        {"vdb/sphere_levelset_houdini.vdb", "ls_sphere"},
        {"volumes/mri_colin27_181x217x181_uint8.nrrd", "\"preset\": \"skin\""}};
    for (const auto& [name, word] : caches) {
        SCOPED_TRACE(name);
        const std::string dataset = convert({(shared / name).string()});
        const Outcome outcome = runCommand(scratch_.path(), {"scene", dataset});
        ASSERT_EQ(outcome.status, 0) << outcome.err;
        EXPECT_THAT(outcome.out, HasSubstr(word));
        const auto scene = readScene(outcome.out);
        ASSERT_TRUE(scene);
        bound(*scene, dataset, Dataset::open(dataset)->manifest().frames(0).frame());
    }
}

}  // namespace
}  // namespace brickyard

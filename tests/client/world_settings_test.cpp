#include "client/world_settings.h"

#include <gmock/gmock.h>

#include <cmath>
#include <glm/geometric.hpp>

#include "client/default_scene.h"
#include "client/picture.h"
#include "frame_fixture.h"
#include "named_channels.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

Scene sceneOf(const std::string& json) {
    const auto scene = readScene(json);
    EXPECT_TRUE(scene) << json << ": " << scene.error().message;
    return scene ? *scene : Scene();
}

// Channels with a box of 10 voxels of half a unit, values from 0 to 4.
FrameFooter footerOf(std::initializer_list<std::pair<const char*, unsigned>> channels) {
    FrameFooter footer = footerWith(channels);
    const double columns[16] = {0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 0.5, 0, 1, 2, 3, 1};
    for (ChannelFooter& channel : *footer.mutable_channels()) {
        for (const double number : columns) channel.add_index_to_world(number);
        for (int a = 0; a < 3; ++a) channel.add_active_min(0), channel.add_active_max(9);
        channel.set_active_voxels(1000);
        channel.set_value_max(4);
        channel.set_grid_class("fog volume");
    }
    return footer;
}

FrameFooter fireFooter() {
    return footerOf(
        {{"density", 1}, {"flame", 1}, {"heat", 1}, {"velocity", 3}, {"albedo", 3}, {"shadow", 1}});
}

FrameFooter levelSetFooter() {
    FrameFooter footer = footerOf({{"surface", 1}, {"velocity", 3}});
    footer.mutable_channels(0)->set_grid_class("level set");
    footer.mutable_channels(0)->set_value_min(-0.1);
    return footer;
}

// One dataset without a name, and the scene as text.
Result<WorldSettings> bindOne(const std::string& json, FrameFooter footer = fireFooter(),
                              const std::filesystem::path& folder = {}) {
    const BoundFrame frames[] = {{"", &footer}};
    return bindWorld(sceneOf(json), frames, folder);
}

glm::dvec3 originOf(const FrameFooter& footer, int channel) {
    const auto& m = footer.channels(channel).index_to_world();
    return {m[12], m[13], m[14]};
}

void expectNear(const glm::dvec3& a, const glm::dvec3& b, double tolerance = 1e-12) {
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(a[c], b[c], tolerance) << "component " << c;
}

TEST(WorldSettingsTest, EveryContradictionIsNamed) {
    const std::tuple<const char*, const char*, const char*> cases[] = {
        // scene, entry, what is said of it
        {R"({"medium":{},"media":[{}]})", "medium:", "media"},
        {R"({"media":[{},{"density":"densty"}]})", "media[1].density:",
         "no channel 'densty'; there are: density, flame, heat, velocity, albedo, shadow"},
        {R"({"medium":{"density":"velocity"}})", "medium.density:", "vectors"},
        {R"({"medium":{"dataset":"smoke"}})", "medium.dataset:", "smoke"},
        {R"({"medium":{"density_scale":-1}})", "medium.density_scale:", "above 0"},
        {R"({"medium":{"density_scale":"NaN"}})", "medium.density_scale:", "nan"},
        {R"({"medium":{"albedo":[1,2,0]}})", "medium.albedo:", "0 to 1"},
        {R"({"medium":{"albedo":[1]}})", "medium.albedo:", "3 numbers"},
        {R"({"medium":{"albedo":[1,"NaN",0]}})", "medium.albedo:", "finite"},
        {R"({"medium":{"anisotropy":-1}})", "medium.anisotropy:", "above -1"},
        {R"({"medium":{"phase":"mie"}})", "medium.phase:", "mie"},
        {R"({"medium":{"phase":"rayleigh","anisotropy":0.1}})", "medium.anisotropy:", "rayleigh"},
        {R"({"medium":{"sample_offset":[0.5]}})", "medium.sample_offset:", "3 numbers"},
        {R"({"media":[{"sample_offset":[0.5,0.5,0.5]},{"sample_offset":[0,0,0]}]})",
         "media[1].sample_offset:", "media[0].sample_offset"},
        {R"({"medium":{"sample_offset":[0.5,0.5,0.5]},"surfaces":[{"sample_offset":[0,0,0]}]})",
         "surfaces[0].sample_offset:", "medium.sample_offset"},
        {R"({"medium":{"filter":"lanczos"}})", "medium.filter:", "lanczos"},
        {R"({"medium":{"color":"flame"}})", "medium.color_ramp:", "missing"},
        {R"({"medium":{"color":"albedo","color_ramp":{"preset":"grey"}}})", "medium.color_ramp:", "scalars"},
        {R"({"medium":{"color_ramp":{"preset":"grey"}}})", "medium.color:", "missing"},
        {R"({"medium":{"color":"flame","color_ramp":{"preset":"jet"}}})", "medium.color_ramp.preset:", "jet"},
        {R"({"medium":{"velocity":"flame"}})", "medium.velocity:", "three components"},
        {R"({"medium":{"velocity_scale":2}})", "medium.velocity:", "missing"},
        {R"({"medium":{"velocity":"velocity","velocity_scale":-2}})", "medium.velocity_scale:", "above 0"},
        {R"({"medium":{"emission":{}}})", "medium.emission.channel:", "missing"},
        {R"({"medium":{"emission":{"channel":"fire"}}})", "medium.emission.channel:", "fire"},
        {R"({"medium":{"emission":{"channel":"flame","scale":-2}}})", "medium.emission.scale:", "above 0"},
        {R"({"medium":{"emission":{"channel":"flame","color":[1,1,-1]}}})",
         "medium.emission.color:", "negative"},
        {R"({"medium":{"emission":{"channel":"flame","color":[1,1,1],"ramp":{"preset":"fire"}}}})",
         "medium.emission.color:", "ramp"},
        {R"({"medium":{"emission":{"channel":"flame","color":[1,1,1],"black_body":{}}}})",
         "medium.emission.color:", "black_body"},
        {R"({"medium":{"emission":{"channel":"flame","ramp":{"preset":"fire"},"black_body":{}}}})",
         "medium.emission.ramp:", "black_body"},
        {R"({"medium":{"emission":{"channel":"flame","weight":"heat"}}})", "medium.emission.weight:", "ramp"},
        {R"({"medium":{"emission":{"channel":"heat","black_body":{},"weight":"velocity"}}})",
         "medium.emission.weight:", "vectors"},
        {R"({"medium":{"emission":{"channel":"heat","black_body":{"kelvin_at_one":20}}}})",
         "medium.emission.black_body.kelvin_at_one:", "500"},
        {R"({"medium":{"emission":{"channel":"heat","black_body":{"kelvin_scale":-20}}}})",
         "medium.emission.black_body.kelvin_scale:", "above 0"},
        {R"({"medium":{"emission":{"channel":"heat","black_body":{"kelvin_offset":"NaN"}}}})",
         "medium.emission.black_body.kelvin_offset:", "finite"},
        {R"({"medium":{"emission":{"channel":"heat","ramp":{}}}})", "medium.emission.ramp:", "preset"},
        {R"({"medium":{"transfer":{"preset":"bone"},"albedo":[1,1,1]}})", "medium.albedo:", "transfer"},
        {R"({"medium":{"transfer":{"preset":"bone"},"emission":{"channel":"flame"}}})",
         "medium.emission:", "transfer"},
        {R"({"medium":{"transfer":{"preset":"bone"},"phase":"rayleigh"}})", "medium.phase:", "transfer"},
        {R"({"medium":{"transfer":{"preset":"bone"},"anisotropy":0.1}})", "medium.anisotropy:", "transfer"},
        {R"({"medium":{"transfer":{"preset":"bone"},"color":"albedo"}})", "medium.color:", "transfer"},
        {R"({"medium":{"transfer":{"preset":"bone","shading":1.5}}})", "medium.transfer.shading:", "0 to 1"},
        {R"({"medium":{"transfer":{"preset":"wood"}}})", "medium.transfer.preset:", "wood"},
        {R"({"medium":{"transfer":{"points":[{"color":[1,1,1],"opacity":-1}]}}})",
         "medium.transfer.points[0].opacity:", "-1"},
        {R"({"lights":[{"type":"area"}]})", "lights[0].type:", "area"},
        {R"({"lights":[{},{"direction":[0,0,0]}]})", "lights[1].direction:", "no length"},
        {R"({"lights":[{"direction":[0,1]}]})", "lights[0].direction:", "3 numbers"},
        {R"({"lights":[{"irradiance":[1,1,-1]}]})", "lights[0].irradiance:", "negative"},
        {R"({"lights":[{"type":"point","position":[0,0,0],"direction":[0,0,1]}]})",
         "lights[0].direction:", "type point; that has position, intensity"},
        {R"({"lights":[{"type":"directional","radiance":[1,1,1]}]})",
         "lights[0].radiance:", "type directional"},
        {R"({"lights":[{"irradiance":[1,1,1],"radiance":[1,1,1]}]})",
         "lights[0].radiance:", "type directional"},
        {R"({"lights":[{"type":"directional","intensity":[1,1,1]}]})",
         "lights[0].intensity:", "type directional"},
        {R"({"lights":[{"irradiance":[1,1,1],"visible":true}]})", "lights[0].visible:", "environment"},
        {R"({"lights":[{"type":"point"}]})", "lights[0].position:", "missing"},
        {R"({"lights":[{"intensity":[1,1,1]}]})", "lights[0].position:", "missing"},
        {R"({"lights":[{"type":"point","position":[0,0,"Infinity"]}]})", "lights[0].position:", "finite"},
        {R"({"lights":[{"type":"spot","position":[0,0,0]}]})", "lights[0].direction:", "missing"},
        {R"({"lights":[{"position":[0,0,0],"direction":[0,0,1],"cone_degrees":180}]})",
         "lights[0].cone_degrees:", "180"},
        {R"({"lights":[{"position":[0,0,0],"direction":[0,0,1],"cone_softness":1.5}]})",
         "lights[0].cone_softness:", "0 to 1"},
        {R"({"lights":[{"radiance":[1,1,1],"up":[0,1,0]}]})", "lights[0].up:", "image"},
        {R"({"lights":[{"radiance":[1,1,1],"rotation_degrees":9}]})", "lights[0].rotation_degrees:", "image"},
        {R"({"lights":[{"radiance":[1,1,1],"samples":100000}]})", "lights[0].samples:", "4096"},
        {R"({"lights":[{"image":"no such.exr"}]})", "lights[0].image:", "no such.exr"},
        {R"({"lights":[{"image":"sky.exr","up":[0,0,0]}]})", "lights[0].up:", "no length"},
        {R"({"lights":[{"image":"sky.exr","intensity":[1,1,1]}]})", "lights[0]", "type"},
        {R"({"lights":[{"shadows":"soft"}]})", "lights[0].shadows:", "soft"},
        {R"({"lights":[{"shadows":"baked"}]})", "lights[0].baked:", "missing"},
        {R"({"lights":[{"shadows":"baked","baked":"sun"}]})", "lights[0].baked:", "no channel 'sun'"},
        {R"({"lights":[{"shadows":"exact","baked":"shadow"}]})", "lights[0].baked:", "shadows exact"},
        {R"({"surfaces":[{}],"lights":[{"baked":"shadow"}]})", "lights[0].baked:", "no medium"},
        {R"({"surfaces":[{"channel":"phi"}]})", "surfaces[0].channel:", "phi"},
        {R"({"surfaces":[{"channel":"velocity"}]})", "surfaces[0].channel:", "vectors"},
        {R"({"surfaces":[{"iso":"NaN"}]})", "surfaces[0].iso:", "finite"},
        {R"({"surfaces":[{"opacity":1.5}]})", "surfaces[0].opacity:", "0 to 1"},
        {R"({"surfaces":[{"opacity":-0.5}]})", "surfaces[0].opacity:", "0 to 1"},
        {R"({"surfaces":[{"color":[2,0,0]}]})", "surfaces[0].color:", "0 to 1"},
        {R"({"surfaces":[{"specular":-1}]})", "surfaces[0].specular:", "above 0"},
        {R"({"surfaces":[{"ambient_occlusion":-1}]})", "surfaces[0].ambient_occlusion:", "above 0"},
        {R"({"surfaces":[{"filter":"gaussian"}]})", "surfaces[0].filter:", "bspline"},
        {R"({"clip":{"low":[0,0,0]}})", "clip.high:", "missing"},
        {R"({"clip":{"high":[0,0,0]}})", "clip.low:", "missing"},
        {R"({"clip":{"low":[0,0,0],"high":[1,0,1]}})", "clip.low:", "along y"},
        {R"({"clip":{"planes":[{"normal":[0,0,1]},{"point":[0,0,1]}]}})",
         "clip.planes[1].normal:", "missing"},
        {R"({"clip":{"planes":[{"normal":[0,0,0]}]}})", "clip.planes[0].normal:", "no length"},
        {R"({"shutter":{"close":0.5}})", "shutter:", "velocity"},
        {R"({"medium":{"velocity":"velocity"},"shutter":{"open":0.5}})", "shutter.close:", "before"},
        {R"({"medium":{"velocity":"velocity"},"shutter":{"close":"Infinity"}})", "shutter.close:", "finite"},
        {R"({"frame":-1})", "frame:", "at least 0"},
        {R"({"background":[0,0]})", "background:", "3 numbers"},
        {R"({"datasets":[{"name":"a"},{"name":"b"},{"name":"a"}]})", "datasets[2].name:", "datasets[0]"},
        {R"({"datasets":[{"name":"a"},{}]})", "datasets[1].name:", "missing"},
        {R"({"datasets":[{"transform":[1,2,3]}]})", "datasets[0].transform:", "16 numbers"},
        {R"({"datasets":[{"transform":[1,0,0,0,0,1,0,0,0,0,0,0,0,0,0,1]}]})",
         "datasets[0].transform:", "inverted"},
    };
    for (const auto& [json, entry, word] : cases) {
        const auto world = bindOne(json);
        ASSERT_FALSE(world) << json;
        EXPECT_THAT(world.error().message, HasSubstr(std::string("scene: ") + entry)) << json;
        EXPECT_THAT(world.error().message, HasSubstr(word)) << json;
        EXPECT_THAT(world.error().message, testing::Not(HasSubstr("\n"))) << json;
    }
}

TEST(WorldSettingsTest, AChannelOfANamedDatasetIsMissedByTheDatasetsName) {
    FrameFooter smoke = fireFooter(), water = levelSetFooter();
    const BoundFrame frames[] = {{"smoke", &smoke}, {"water", &water}};
    const auto of = [&](const char* json) { return bindWorld(sceneOf(json), frames, {}); };
    EXPECT_EQ(
        of(R"({"media":[{},{"dataset":"smoke","density":"densty"}]})").error().message,
        "scene: media[1].density: no channel 'densty' in dataset 'smoke'; there are: density, flame, heat, "
        "velocity, albedo, shadow");
    EXPECT_THAT(of(R"({"medium":{"dataset":"fog"}})").error().message, HasSubstr("there are: smoke, water"));
    const auto both = of(R"({"medium":{},"surfaces":[{"dataset":"water"}]})");
    ASSERT_TRUE(both) << both.error().message;
    EXPECT_EQ(both->media.at(0).density, (FieldBinding{0, 0}));
    EXPECT_EQ(both->surfaces.at(0).channel, (FieldBinding{1, 0}));
    EXPECT_TRUE(both->surfaces[0].inside_below);
}

TEST(WorldSettingsTest, DefaultsAreFilledIn) {
    const auto world = bindOne("{}");
    ASSERT_TRUE(world);
    ASSERT_EQ(world->media.size(), 1u);
    const MediumSettings& medium = world->media[0];
    EXPECT_EQ(medium.density, (FieldBinding{0, 0}));
    EXPECT_EQ(medium.density_scale, 1);
    EXPECT_EQ(medium.filter, FieldFilter::kTrilinear);
    EXPECT_EQ(medium.albedo, glm::dvec3(0.8));
    EXPECT_FALSE(medium.emission || medium.velocity || medium.transfer || medium.color);
    EXPECT_TRUE(world->lights.empty() && world->surfaces.empty() && !world->clip.any());
    EXPECT_EQ(world->shutter_close, 0);

    const auto fire =
        bindOne(R"({"medium":{"emission":{"channel":"heat","weight":"flame","black_body":{}}}})");
    ASSERT_TRUE(fire);
    const MediumEmission& emission = *fire->media[0].emission;
    EXPECT_EQ(emission.channel, (FieldBinding{0, 2}));
    EXPECT_EQ(*emission.weight, (FieldBinding{0, 1}));
    EXPECT_EQ(emission.kelvin_scale, 1);
    ASSERT_TRUE(emission.black_body);
    EXPECT_EQ(emission.black_body->radiance(1700), BlackBody(1500).radiance(1700));

    const auto scan = bindOne(R"({"medium":{"transfer":{"preset":"grey"}}})");
    ASSERT_TRUE(scan);
    EXPECT_NEAR(scan->media[0].density_scale, 100 / 5.0, 1e-12) << "the box is 10 voxels of half a unit";
    EXPECT_NEAR(scan->media[0].transfer->at(2).opacity, 0.25, 1e-12) << "over the channel's range, 0 to 4";
}

TEST(WorldSettingsTest, TheTypeOfALightFollowsFromItsEntries) {
    const std::pair<const char*, WorldLight::Kind> cases[] = {
        {"{}", WorldLight::Kind::kDirectional},
        {R"({"direction":[0,0,-1]})", WorldLight::Kind::kDirectional},
        {R"({"irradiance":[1,1,1]})", WorldLight::Kind::kDirectional},
        {R"({"position":[0,0,1]})", WorldLight::Kind::kPoint},
        {R"({"position":[0,0,1],"intensity":[1,1,1]})", WorldLight::Kind::kPoint},
        {R"({"position":[0,0,1],"direction":[0,0,-1]})", WorldLight::Kind::kSpot},
        {R"({"position":[0,0,1],"direction":[0,0,-1],"cone_degrees":20})", WorldLight::Kind::kSpot},
        {R"({"radiance":[1,1,1]})", WorldLight::Kind::kEnvironment},
        {R"({"visible":true})", WorldLight::Kind::kEnvironment},
        {R"({"type":"environment"})", WorldLight::Kind::kEnvironment},
    };
    for (const auto& [json, kind] : cases) {
        const auto world = bindOne(std::string(R"({"lights":[)") + json + "]}");
        ASSERT_TRUE(world) << json << world.error().message;
        EXPECT_EQ(world->lights[0].kind, kind) << json;
    }
}

TEST(WorldSettingsTest, LightsAreWhatTheirEntriesSay) {
    const auto world = bindOne(R"({"lights":[
        {"direction":[0,0,-2],"irradiance":[1,2,3],"shadows":"deep"},
        {"position":[1,2,3],"intensity":[4,5,6],"shadows":"none"},
        {"position":[1,2,3],"direction":[0,3,0],"cone_degrees":60,"cone_softness":0.5},
        {"radiance":[0.1,0.2,0.3],"samples":7},
        {"shadows":"baked","baked":"shadow"}]})");
    ASSERT_TRUE(world) << world.error().message;
    ASSERT_EQ(world->lights.size(), 5u);
    expectNear(world->lights[0].to_light, {0, 0, 1});
    EXPECT_EQ(world->lights[0].power, glm::dvec3(1, 2, 3));
    EXPECT_EQ(world->lights[0].shadows, ShadowMethod::kDeepMap);
    EXPECT_EQ(world->lights[1].position, glm::dvec3(1, 2, 3));
    EXPECT_EQ(world->lights[1].power, glm::dvec3(4, 5, 6));
    EXPECT_EQ(world->lights[1].shadows, ShadowMethod::kNone);
    expectNear(world->lights[2].to_light, {0, -1, 0});
    EXPECT_NEAR(world->lights[2].cos_outer, std::cos(M_PI / 6), 1e-12);
    EXPECT_NEAR(world->lights[2].cos_inner, std::cos(M_PI / 12), 1e-12);
    expectNear(world->lights[3].environment->radiance({0, 0, 1}), {0.1, 0.2, 0.3}, 1e-7);
    EXPECT_EQ(world->lights[3].samples, 7u);
    EXPECT_EQ(*world->lights[4].baked, (FieldBinding{0, 5}));
    EXPECT_EQ(world->lights[4].shadows, ShadowMethod::kBaked);
}

TEST(WorldSettingsTest, AnImageIsFoundFromTheScenesFolder) {
    ScratchFolder folder;
    Picture sky(4, 2);
    for (Pixel& pixel : sky.pixels) pixel.radiance = {1, 2, 4};
    ASSERT_TRUE(writeExr(sky, folder / "sky.exr"));
    const auto world = bindOne(R"({"lights":[{"image":"sky.exr","radiance":[2,2,2],"up":[0,1,0]}]})",
                               fireFooter(), folder.path());
    ASSERT_TRUE(world) << world.error().message;
    EXPECT_EQ(world->lights[0].environment->radiance({1, 0, 0}), glm::dvec3(2, 4, 8));
}

TEST(WorldSettingsTest, SampleOffsetsAndTransformsEnterTheFootersOnce) {
    FrameFooter smoke = fireFooter(), water = levelSetFooter();
    const BoundFrame frames[] = {{"smoke", &smoke}, {"water", &water}};
    // Turns x to y, doubles, and moves.
    const auto world = bindWorld(sceneOf(R"({
        "datasets":[{"name":"smoke","transform":[0,2,0,0, -2,0,0,0, 0,0,2,0, 10,20,30,1]},{"name":"water"}],
        "media":[{"sample_offset":[0.5,0.5,0.5]},{"density":"flame","dataset":"smoke","sample_offset":[0.5,0.5,0.5]},
                 {"density":"heat"}],
        "surfaces":[{"dataset":"water"}]})"),
                                 frames, {});
    ASSERT_TRUE(world) << world.error().message;
    for (int c = 0; c < smoke.channels_size(); ++c) {
        // Index 0 lay at 1 2 3; with half a voxel of half a unit at 1.25 2.25 3.25.
        expectNear(originOf(smoke, c), {10 - 2 * 2.25, 20 + 2 * 1.25, 30 + 2 * 3.25});
        EXPECT_NEAR(smoke.channels(c).index_to_world(1), 1, 1e-12) << "x has become y, and twice as long";
    }
    expectNear(originOf(water, 0), {1, 2, 3});
    for (const MediumSettings& medium : world->media) EXPECT_EQ(medium.sample_offset, glm::dvec3(0.5));
}

TEST(WorldSettingsTest, TheCommandLinesDatasetStandsForTheScenesFirst) {
    FrameFooter smoke = fireFooter();
    const BoundFrame frames[] = {{"", &smoke}};
    const auto world =
        bindWorld(sceneOf(R"({"datasets":[{"name":"smoke","transform":[1,0,0,0,0,1,0,0,0,0,1,0,5,0,0,1]}],
                                             "medium":{"dataset":"smoke"}})"),
                  frames, {});
    ASSERT_TRUE(world) << world.error().message;
    expectNear(originOf(smoke, 0), {6, 2, 3});
}

TEST(WorldSettingsTest, SurfacesAloneHaveNoMediumAndALevelSetIsOneByItself) {
    const auto named = bindOne(R"({"surfaces":[{"iso":0.5,"opacity":0,"specular":0.3,"ambient_occlusion":2,
                                                "filter":"bspline","color":[0.1,0.2,0.3]}]})");
    ASSERT_TRUE(named) << named.error().message;
    EXPECT_TRUE(named->media.empty());
    const SurfaceSettings& surface = named->surfaces.at(0);
    EXPECT_FALSE(surface.inside_below) << "a fog is inside where it is thick";
    EXPECT_EQ(surface.channel, (FieldBinding{0, 0}));
    EXPECT_EQ(surface.iso, 0.5);
    EXPECT_EQ(surface.opacity, 0);
    EXPECT_EQ(surface.specular, 0.3);
    EXPECT_EQ(surface.ambient_occlusion, 2);
    EXPECT_EQ(surface.normal_filter, FieldFilter::kBSpline);
    expectNear(surface.color, {0.1, 0.2, 0.3}, 1e-7);

    const auto by_itself = bindOne(R"({"background":[0,0,0]})", levelSetFooter());
    ASSERT_TRUE(by_itself) << by_itself.error().message;
    EXPECT_TRUE(by_itself->media.empty());
    ASSERT_EQ(by_itself->surfaces.size(), 1u);
    EXPECT_TRUE(by_itself->surfaces[0].inside_below);
    EXPECT_NEAR(by_itself->surfaces[0].ambient_occlusion, 0.1 * 5 * std::sqrt(3), 1e-9) << "of its box";
    EXPECT_EQ(by_itself->lights.size(), 2u) << "a key and a sky, or one sees nothing";
    const auto lit = bindOne(R"({"lights":[{}]})", levelSetFooter());
    ASSERT_TRUE(lit);
    EXPECT_EQ(lit->surfaces.size(), 1u);
    EXPECT_EQ(lit->lights.size(), 1u) << "the scene's light is kept";
    const auto unsaid = bindOne("{}", levelSetFooter());
    ASSERT_TRUE(unsaid);
    EXPECT_EQ(unsaid->media.size(), 1u) << "without a scene all is as it was";
    EXPECT_TRUE(unsaid->surfaces.empty() && unsaid->lights.empty());
    FrameFooter fog = levelSetFooter();
    fog.mutable_channels(0)->set_value_min(0);
    EXPECT_EQ(bindOne(R"({"background":[0,0,0]})", fog)->media.size(), 1u) << "a class that lies";
}

TEST(WorldSettingsTest, ClipsAndShuttersArePassedOn) {
    const auto world = bindOne(R"({"medium":{"velocity":"velocity","velocity_scale":0.04},
        "clip":{"low":[0,0,0],"high":[1,2,3],"planes":[{"point":[1,1,1],"normal":[0,0,-4]}]},
        "shutter":{"open":-0.25,"close":0.25}})");
    ASSERT_TRUE(world) << world.error().message;
    EXPECT_EQ((*world->clip.box)[1], glm::dvec3(1, 2, 3));
    expectNear(world->clip.planes.at(0).normal, {0, 0, -1});
    EXPECT_EQ(world->clip.planes[0].point, glm::dvec3(1));
    EXPECT_EQ(world->shutter_open, -0.25);
    EXPECT_EQ(world->shutter_close, 0.25);
    EXPECT_EQ(*world->media[0].velocity, (FieldBinding{0, 3}));
    EXPECT_EQ(world->media[0].velocity_scale, 0.04);
}

TEST(WorldSettingsTest, FiltersAndShadowsAreKnownByTheirNames) {
    for (const char* name : {"nearest", "trilinear", "bspline", "catmull-rom", "mitchell", "gaussian"}) {
        const auto filter = fieldFilter(name);
        ASSERT_TRUE(filter) << name;
        EXPECT_STREQ(toString(*filter), name);
    }
    EXPECT_FALSE(fieldFilter("Trilinear"));
    EXPECT_EQ(shadowMethod("baked"), ShadowMethod::kBaked);
    EXPECT_FALSE(shadowMethod(""));
}

void expectTheFastWaysSettings(const std::string& json, const FrameFooter& footer) {
    SCOPED_TRACE(json);
    FrameFooter old_footer = footer, new_footer = footer;
    const auto expected = bindScene(sceneOf(json), old_footer);
    ASSERT_TRUE(expected) << expected.error().message;
    const BoundFrame frames[] = {{"", &new_footer}};
    const auto world = bindWorld(sceneOf(json), frames, {});
    ASSERT_TRUE(world) << world.error().message;
    const auto simple = simpleScene(*world);
    ASSERT_TRUE(simple);
    EXPECT_EQ(simple->density_channel, expected->density_channel);
    EXPECT_EQ(simple->density_scale, expected->density_scale);
    EXPECT_EQ(simple->albedo, expected->albedo);
    EXPECT_EQ(simple->anisotropy, expected->anisotropy);
    EXPECT_EQ(simple->background, expected->background);
    ASSERT_EQ(simple->emission.has_value(), expected->emission.has_value());
    if (simple->emission) {
        EXPECT_EQ(simple->emission->channel, expected->emission->channel);
        EXPECT_EQ(simple->emission->scale, expected->emission->scale);
        EXPECT_EQ(simple->emission->color, expected->emission->color);
    }
    ASSERT_EQ(simple->light.has_value(), expected->light.has_value());
    if (simple->light) {
        EXPECT_EQ(simple->light->to_light, expected->light->to_light);
        EXPECT_EQ(simple->light->irradiance, expected->light->irradiance);
    }
    EXPECT_EQ(new_footer.SerializeAsString(), old_footer.SerializeAsString()) << "the transforms";
}

TEST(WorldSettingsTest, WhatTheFastWayCanDrawIsBoundAsEver) {
    for (
        const char* json :
        {"{}", R"({"medium":{"density_scale":3,"albedo":[0.1,0.2,0.3],"anisotropy":-0.3}})",
         R"({"medium":{"sample_offset":[0.5,0.5,0.5],"emission":{"channel":"flame","scale":9,"color":[1,0.2,0]}}})",
         R"({"medium":{"density":"heat"},"lights":[{"direction":[0.8,0.35,-0.75],"irradiance":[11,10.8,10.4]}]})",
         R"({"lights":[{}],"background":[0.01,0.014,0.022]})"})
        expectTheFastWaysSettings(json, fireFooter());
    expectTheFastWaysSettings(BRICKYARD_TEST_DATA "/plume/scene.json", fireFooter());
    expectTheFastWaysSettings("{}", levelSetFooter());
}

TEST(WorldSettingsTest, WhatTheFastWayCannotDrawIsNotSimple) {
    ASSERT_TRUE(simpleScene(*bindOne("{}")));
    for (const char* json :
         {R"({"media":[{},{}]})", R"({"medium":{"filter":"nearest"}})", R"({"medium":{"phase":"rayleigh"}})",
          R"({"medium":{"color":"albedo"}})", R"({"medium":{"transfer":{"preset":"bone"}}})",
          R"({"medium":{"velocity":"velocity"}})", R"({"surfaces":[{}]})", R"({"medium":{},"surfaces":[{}]})",
          R"({"medium":{"emission":{"channel":"flame","ramp":{"preset":"fire"}}}})",
          R"({"medium":{"emission":{"channel":"heat","black_body":{}}}})", R"({"lights":[{},{}]})",
          R"({"lights":[{"position":[0,0,0]}]})", R"({"lights":[{"radiance":[1,1,1]}]})",
          R"({"lights":[{"shadows":"none"}]})", R"({"lights":[{"baked":"shadow"}]})",
          R"({"clip":{"planes":[{"normal":[0,0,1]}]}})"}) {
        const auto world = bindOne(json);
        ASSERT_TRUE(world) << json << world.error().message;
        EXPECT_FALSE(simpleScene(*world)) << json;
    }
}

TEST(WorldSettingsTest, WithoutAFrameNothingIsBound) {
    const auto world = bindWorld({}, {}, {});
    ASSERT_FALSE(world);
    EXPECT_THAT(world.error().message, HasSubstr("no frame"));
}

}  // namespace
}  // namespace brickyard

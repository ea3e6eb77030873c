#include "client/scene.h"

#include <gmock/gmock.h>

#include "named_channels.h"

namespace brickyard {
namespace {

TEST(SceneTest, DensityIsFoundByNameOrBecauseItIsTheOnlyOne) {
    FrameFooter named = footerWith({{"v", 3}, {"density", 1}, {"heat", 1}});
    EXPECT_EQ(bindScene({}, named)->density_channel, 1u);
    FrameFooter alone = footerWith({{"v", 3}, {"smoke", 1}});
    EXPECT_EQ(bindScene({}, alone)->density_channel, 1u);
    FrameFooter unclear = footerWith({{"a", 1}, {"b", 1}});
    const auto none = bindScene({}, unclear);
    ASSERT_FALSE(none);
    EXPECT_THAT(none.error().message, testing::HasSubstr("a, b"));
}

TEST(SceneTest, WhatCannotBeMeantIsNamed) {
    FrameFooter footer = footerWith({{"density", 1}, {"velocity", 3}});
    const std::pair<const char*, const char*> cases[] = {
        {R"({"medium":{"density":"smoke"}})", "smoke"},
        {R"({"medium":{"density":"velocity"}})", "vectors"},
        {R"({"medium":{"density_scale":-1}})", "density_scale"},
        {R"({"medium":{"albedo":[1,2,0]}})", "albedo"},
        {R"({"medium":{"anisotropy":1}})", "anisotropy"},
        {R"({"medium":{"emission":{"channel":"fire"}}})", "fire"},
        {R"({"lights":[{"direction":[0,0,0]}]})", "direction"},
        {R"({"lights":[{},{}]})", "2 lights"},
        {R"({"medium":{"sample_offset":[0.5]}})", "sample_offset"},
    };
    for (const auto& [json, word] : cases) {
        const auto scene = readScene(json);
        ASSERT_TRUE(scene) << json;
        const auto bound = bindScene(*scene, footer);
        ASSERT_FALSE(bound) << json;
        EXPECT_THAT(bound.error().message, testing::HasSubstr(word));
    }
}

TEST(SceneTest, ASampleOffsetMovesEveryChannelByThatManyOfItsVoxels) {
    FrameFooter footer = footerWith({{"density", 1}, {"flame", 1}});
    const double columns[2][16] = {{2, 0, 0, 0, 0, 3, 0, 0, 1, 0, 4, 0, 10, 20, 30, 1},
                                   {8, 0, 0, 0, 0, 8, 0, 0, 0, 0, 8, 0, 0, 0, 0, 1}};
    for (int i = 0; i < 2; ++i)
        for (const double number : columns[i]) footer.mutable_channels(i)->add_index_to_world(number);
    const auto scene = readScene(R"({"medium":{"sample_offset":[0.5,0.5,0.25]}})");
    ASSERT_TRUE(scene);
    ASSERT_TRUE(bindScene(*scene, footer));
    const double moved[2][3] = {{11.25, 21.5, 31}, {4, 4, 2}};
    for (int i = 0; i < 2; ++i)
        for (int row = 0; row < 3; ++row)
            EXPECT_EQ(footer.channels(i).index_to_world(12 + row), moved[i][row]) << i << " " << row;
    EXPECT_EQ(footer.channels(0).index_to_world(8), 1) << "the linear part stays";
}

TEST(SceneTest, UnknownKeysAndBrokenJsonAreOneLineErrors) {
    for (const char* text : {R"({"medum":{}})", "{", R"({"lights":3})", "/no/such/file.json"}) {
        const auto scene = readScene(text);
        ASSERT_FALSE(scene) << text;
        EXPECT_THAT(scene.error().message, testing::Not(testing::HasSubstr("\n")));
    }
}

}  // namespace
}  // namespace brickyard

#include "core/camera_framing.h"

#include <gtest/gtest.h>

#include <glm/geometric.hpp>

#include "core/camera.h"
#include "core/default_density.h"
#include "named_channels.h"

namespace brickyard {
namespace {

TEST(CameraFraming, SeesAllCornersOfTheBox) {
    ChannelFooter channel;
    for (int i = 0; i < 16; ++i) channel.add_index_to_world(i % 5 == 0 ? 1 : 0);
    for (const int v : {-3, 100, 7}) channel.add_active_min(v);
    for (const int v : {90, 130, 77}) channel.add_active_max(v);
    for (const double aspect : {0.4, 1.0, 2.5}) {
        const std::uint32_t height = 200, width = std::uint32_t(200 * aspect);
        const auto camera = PinholeCamera::create(frameChannel(channel, aspect), width, height);
        ASSERT_TRUE(camera);
        for (int corner = 0; corner < 8; ++corner) {
            glm::dvec3 p;
            for (int a = 0; a < 3; ++a)
                p[a] = (corner >> a & 1) ? channel.active_max(a) + 1 : channel.active_min(a) - 1;
            const glm::dvec3 to = p - camera->eye();
            const double z = glm::dot(to, camera->forward());
            ASSERT_GT(z, 0);
            EXPECT_LE(std::abs(glm::dot(to, camera->right())), z * camera->halfWidth() * 1.0001);
            EXPECT_LE(std::abs(glm::dot(to, camera->up())), z * camera->halfHeight() * 1.0001);
        }
    }
}

TEST(DefaultDensity, IsTheOneOfThatNameOrTheOnlyScalar) {
    EXPECT_EQ(defaultDensity(footerWith({{"v", 3}, {"heat", 1}, {"density", 1}})), 2u);
    EXPECT_EQ(defaultDensity(footerWith({{"v", 3}, {"smoke", 1}})), 1u);
    EXPECT_EQ(defaultDensity(footerWith({{"a", 1}, {"b", 1}, {"c", 1}})), std::nullopt);
    EXPECT_EQ(defaultDensity(footerWith({{"ct", 1}, {"light.0", 1}, {"light.12", 1}})), 0u);
    EXPECT_EQ(defaultDensity(footerWith({{"light.", 1}, {"light.a", 1}})), std::nullopt);
    EXPECT_EQ(defaultDensity(footerWith({{"v", 3}})), std::nullopt);
    EXPECT_EQ(defaultDensity({}), std::nullopt);
}

}  // namespace
}  // namespace brickyard

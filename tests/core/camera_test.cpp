#include "core/camera.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <vector>

namespace brickyard {
namespace {

Camera cameraAt(std::vector<double> eye, std::vector<double> target, std::vector<double> up = {}) {
    Camera camera;
    camera.mutable_eye()->Assign(eye.begin(), eye.end());
    camera.mutable_target()->Assign(target.begin(), target.end());
    camera.mutable_up()->Assign(up.begin(), up.end());
    return camera;
}

void expectNear(const glm::dvec3& a, const glm::dvec3& b, double tolerance = 1e-12) {
    EXPECT_LE(glm::length(a - b), tolerance)
        << a.x << ' ' << a.y << ' ' << a.z << " is not " << b.x << ' ' << b.y << ' ' << b.z;
}

TEST(PinholeCamera, SendsTheRayOfAPixelThroughItsCentre) {
    Camera camera = cameraAt({0, 0, 5}, {0, 0, 0});
    camera.set_vertical_fov_degrees(90);
    const auto pinhole = PinholeCamera::create(camera, 4, 2);
    ASSERT_TRUE(pinhole) << pinhole.error().message;
    expectNear(pinhole->ray(0, 0).origin, {0, 0, 5});
    // Row 0 is the top, column 0 the left; the picture is 4 wide and 2 high at distance 1.
    expectNear(pinhole->ray(0, 0).direction, glm::normalize(glm::dvec3(-1.5, 0.5, -1)));
    expectNear(pinhole->ray(3, 1).direction, glm::normalize(glm::dvec3(1.5, -0.5, -1)));
    EXPECT_DOUBLE_EQ(pinhole->pixelEdge(), 1.0);
    EXPECT_DOUBLE_EQ(pinhole->halfWidth(), 2.0);
}

TEST(PinholeCamera, TakesYAsUpAndZWhereTheViewIsVertical) {
    expectNear(PinholeCamera::create(cameraAt({0, 0, 5}, {0, 0, 0}), 8, 8)->up(), {0, 1, 0});
    expectNear(PinholeCamera::create(cameraAt({0, 5, 0}, {0, 0, 0}), 8, 8)->up(), {0, 0, 1});
    expectNear(PinholeCamera::create(cameraAt({0, 0, 0}, {0, 5, 0}), 8, 8)->up(), {0, 0, 1});
}

TEST(PinholeCamera, IsTheSameAtAnyScaleAndPlace) {
    const auto near = PinholeCamera::create(cameraAt({1, 2, 3}, {0, 0, 0}, {0, 0, 1}), 64, 48);
    for (const double scale : {1e-200, 1e-9, 1e9, 1e200}) {
        const auto scaled = PinholeCamera::create(
            cameraAt({1 * scale, 2 * scale, 3 * scale}, {0, 0, 0}, {0, 0, scale}), 64, 48);
        ASSERT_TRUE(scaled) << scaled.error().message;
        expectNear(scaled->ray(5, 7).direction, near->ray(5, 7).direction);
    }
    const double far = 1099511627776;  // 2^40: the sums are exact
    const auto moved =
        PinholeCamera::create(cameraAt({far + 1, far + 2, far + 3}, {far, far, far}, {0, 0, 1}), 64, 48);
    expectNear(moved->ray(5, 7).direction, near->ray(5, 7).direction);
}

TEST(PinholeCamera, RefusesWhatCannotBeACamera) {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    EXPECT_FALSE(PinholeCamera::create(cameraAt({1, 2}, {0, 0, 0}), 8, 8));
    EXPECT_FALSE(PinholeCamera::create(cameraAt({1, 2, nan}, {0, 0, 0}), 8, 8));
    EXPECT_FALSE(PinholeCamera::create(cameraAt({1, 2, 3}, {1, 2, 3}), 8, 8));
    EXPECT_FALSE(PinholeCamera::create(cameraAt({1, 2, 3}, {0, 0, 0}, {0, 0, 0}), 8, 8));
    EXPECT_FALSE(PinholeCamera::create(cameraAt({0, 0, 3}, {0, 0, 0}, {0, 0, -2}), 8, 8));
    EXPECT_FALSE(PinholeCamera::create(cameraAt({1e308, 0, 0}, {-1e308, 0, 0}), 8, 8));
    EXPECT_FALSE(PinholeCamera::create(cameraAt({0, 0, 3}, {0, 0, 0}), 0, 8));
    for (const double fov : {-1.0, 180.0, nan}) {
        Camera camera = cameraAt({0, 0, 3}, {0, 0, 0});
        camera.set_vertical_fov_degrees(fov);
        EXPECT_FALSE(PinholeCamera::create(camera, 8, 8)) << fov;
    }
}

}  // namespace
}  // namespace brickyard

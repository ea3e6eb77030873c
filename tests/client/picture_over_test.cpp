// A picture in front of another program's.
#include "client/picture_over.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "stored_fields.h"

namespace brickyard {
namespace {

Pixel pixelOf(float red, float alpha, float depth) {
    Pixel pixel;
    pixel.radiance = {red, red / 2, 0};
    pixel.alpha = alpha;
    pixel.depth = depth;
    return pixel;
}

Pixel over(const Pixel& front, const Pixel& behind) {
    Picture a(1, 1), b(1, 1);
    a.pixels[0] = front;
    b.pixels[0] = behind;
    composeOver(a, b);
    return a.pixels[0];
}

TEST(PictureOverTest, WhatIsBehindShowsThroughPremultiplied) {
    const Pixel p = over(pixelOf(0.25f, 0.5f, 3), pixelOf(0.75f, 1, 7));
    EXPECT_EQ(p.radiance[0], 0.25f + 0.5f * 0.75f);
    EXPECT_EQ(p.radiance[1], 0.125f + 0.5f * 0.375f);
    EXPECT_EQ(p.radiance[2], 0);
    EXPECT_EQ(p.alpha, 1);
    const Pixel thin = over(pixelOf(0.25f, 0.5f, 3), pixelOf(0.25f, 0.5f, 7));
    EXPECT_EQ(thin.alpha, 0.75f);
}

TEST(PictureOverTest, DepthIsWhereHalfOfTheOpacityIsReached) {
    EXPECT_EQ(over(pixelOf(1, 0.5f, 3), pixelOf(1, 1, 7)).depth, 3);
    EXPECT_EQ(over(pixelOf(1, 0.25f, 3), pixelOf(1, 1, 7)).depth, 7);
    EXPECT_EQ(over(pixelOf(0, 0, 0), pixelOf(1, 1, 7)).depth, 7);
    EXPECT_EQ(over(pixelOf(1, 0.25f, 3), pixelOf(1, 0.25f, 7)).depth, 3);
    // A sky without a depth is behind everything.
    EXPECT_EQ(over(pixelOf(1, 0.25f, 3), pixelOf(1, 1, 0)).depth, 3);
    EXPECT_EQ(over(pixelOf(0, 0, 0), pixelOf(1, 1, 0)).depth, 0);
}

TEST(PictureOverTest, NothingShowsThroughWhatIsOpaque) {
    const float infinity = std::numeric_limits<float>::infinity();
    const Pixel p = over(pixelOf(0.5f, 1, 3), pixelOf(infinity, 1, 7));
    EXPECT_EQ(p.radiance[0], 0.5f);
    EXPECT_EQ(p.radiance[1], 0.25f);
    EXPECT_EQ(p.alpha, 1);
    EXPECT_EQ(p.bound_radiance, 0);
}

TEST(PictureOverTest, AnErrorOfAlphaCountsForWhatShowsThrough) {
    Pixel front = pixelOf(0.25f, 0.5f, 3);
    front.bound_alpha = 0.125f;
    front.bound_radiance = 0.0625f;
    front.estimate_alpha = 0.03125f;
    const Pixel behind = pixelOf(2, 0.75f, 7);
    const Pixel p = over(front, behind);
    EXPECT_EQ(p.bound_alpha, 0.125f * 0.25f);
    EXPECT_EQ(p.bound_radiance, 0.0625f + 0.125f * 2);
    EXPECT_EQ(p.estimate_radiance, 0.03125f * 2);
    // The bound holds for the worst alpha there could have been.
    Pixel worst = front;
    worst.alpha -= front.bound_alpha;
    worst.radiance[0] += front.bound_radiance;
    const Pixel q = over(worst, behind);
    EXPECT_LE(std::abs(q.radiance[0] - p.radiance[0]), p.bound_radiance);
    EXPECT_LE(std::abs(q.alpha - p.alpha), p.bound_alpha);
}

TEST(PictureOverTest, ADepthAlongTheAxisBecomesOneAlongTheRay) {
    const auto camera = PinholeCamera::create(cameraAt({0, 0, 0}, {0, 0, -1}, 90), 3, 3);
    ASSERT_TRUE(camera);
    Picture picture(3, 3);
    for (Pixel& p : picture.pixels) p.depth = 6;
    picture.pixels[0].depth = std::numeric_limits<float>::infinity();
    picture.pixels[1].depth = -1;
    picture.pixels[2].depth = std::numeric_limits<float>::quiet_NaN();
    toRayDepth(picture, DepthKind::kPlane, &*camera);
    for (int i = 0; i < 3; ++i) EXPECT_EQ(picture.pixels[std::size_t(i)].depth, 0) << i;
    EXPECT_FLOAT_EQ(picture.pixels[4].depth, 6);
    // The middle of the next pixel is 2/3 from the axis, at a distance of 1.
    EXPECT_FLOAT_EQ(picture.pixels[5].depth, float(6 * std::sqrt(1 + 4.0 / 9)));
    EXPECT_FLOAT_EQ(picture.pixels[8].depth, float(6 * std::sqrt(1 + 8.0 / 9)));

    Picture along(1, 1);
    along.pixels[0].depth = 4;
    toRayDepth(along, DepthKind::kRay, nullptr);
    EXPECT_EQ(along.pixels[0].depth, 4);
}

TEST(PictureOverTest, AnEnlargedPictureFiltersToItself) {
    Picture picture(2, 1);
    picture.pixels[0] = pixelOf(0.5f, 0.5f, 2);
    picture.pixels[1] = pixelOf(0.25f, 1, 4);
    const Picture large = enlarged(picture, 2);
    ASSERT_EQ(large.width, 4u);
    ASSERT_EQ(large.height, 2u);
    EXPECT_EQ(large.pixels[1].depth, 2);
    EXPECT_EQ(large.pixels[6].depth, 4);
    const Picture back = boxFiltered(large, 2);
    EXPECT_EQ(back.pixels[0].radiance[0], 0.5f);
    EXPECT_EQ(back.pixels[1].alpha, 1);
}

}  // namespace
}  // namespace brickyard

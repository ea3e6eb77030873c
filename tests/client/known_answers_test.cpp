// Media whose pictures are a formula: slab, ramp, ball, Gaussian; and two symmetries that every picture has.
#include <gmock/gmock.h>

#include <numbers>
#include <random>

#include "blob_field.h"
#include "reference_field.h"
#include "stored_fields.h"

namespace brickyard {
namespace {

using Position = std::int64_t;

class KnownAnswers : public testing::Test {
protected:
    Picture draw(const std::vector<const FieldSource*>& fields, const RenderRequest& request) {
        const auto stored = storeFields(folder_ / "test.bricks", fields, 16);
        EXPECT_TRUE(stored) << stored.error().message;
        return drawAgain(request);
    }
    Picture drawAgain(const RenderRequest& request) {
        auto outcome = drawStored(folder_ / "test.bricks", request);
        EXPECT_TRUE(outcome) << outcome.error().message;
        EXPECT_TRUE(outcome->final);
        return std::move(outcome->picture);
    }
    static RenderRequest request(const Camera& camera, std::uint32_t edge, double density_scale) {
        RenderRequest request;
        request.camera = camera;
        request.width = request.height = edge;
        request.density_scale = density_scale;
        request.quality.reference = true;
        return request;
    }
    // Of a medium of constant extent along z, seen from z = 100: the largest error of alpha where the ray
    // crosses all of its height `depth_along_z` belongs to, far from its sides.
    static double worstThroughSlab(const Picture& picture, const PinholeCamera& camera,
                                   double depth_along_z) {
        double worst = 0;
        std::size_t tested = 0;
        for (std::uint32_t y = 0; y < picture.height; ++y)
            for (std::uint32_t x = 0; x < picture.width; ++x) {
                const WorldRay ray = camera.ray(x, y);
                const glm::dvec3 out = ray.origin + ray.direction * ((-1 - ray.origin.z) / ray.direction.z);
                if (std::max(std::abs(out.x - 32), std::abs(out.y - 32)) > 30) continue;
                ++tested;
                const double truth = -std::expm1(-depth_along_z / std::abs(ray.direction.z));
                worst =
                    std::max(worst, std::abs(double(picture.pixels[y * picture.width + x].alpha) - truth));
            }
        EXPECT_GT(tested, picture.pixels.size() / 4);
        return worst;
    }

    ScratchFolder folder_;
};

TEST_F(KnownAnswers, ASlabAbsorbsByItsThicknessOverTheCosine) {
    const FormulaField slab("density", {{0, 0, 0}, {65, 65, 11}},
                            [](Position, Position, Position, int) { return 1.0; });
    const RenderRequest view = request(cameraAt({20, 28, 60}, {30, 33, 5}, 50), 24, 0.07);
    const auto camera = PinholeCamera::create(*view.camera, 24, 24);
    // 10 whole cells, and a ramp of one voxel down to 0 on either side.
    EXPECT_LE(worstThroughSlab(draw({&slab}, view), *camera, 0.07 * 11), 2e-6);
}

TEST_F(KnownAnswers, ALinearRampIsIntegratedAsATrapezoid) {
    const FormulaField ramp("density", {{0, 0, 0}, {65, 65, 17}},
                            [](Position, Position, Position z, int) { return 0.25 + double(z) / 8; });
    const RenderRequest view = request(cameraAt({20, 28, 60}, {30, 33, 5}, 50), 24, 0.04);
    const auto camera = PinholeCamera::create(*view.camera, 24, 24);
    const double first = 0.25, last = 0.25 + 2, inside = 16 * (first + last) / 2;
    EXPECT_LE(worstThroughSlab(draw({&ramp}, view), *camera, 0.04 * (inside + first / 2 + last / 2)), 2e-6);
}

// The largest error of the optical depth, where `truth` gives it for a distance from the centre; rays further
// out than `reach` are left out.
double worstDepth(const Picture& picture, const PinholeCamera& camera, double reach,
                  const std::function<double(double)>& truth) {
    double worst = 0;
    for (std::uint32_t y = 0; y < picture.height; ++y)
        for (std::uint32_t x = 0; x < picture.width; ++x) {
            const WorldRay ray = camera.ray(x, y);
            const double impact = glm::length(glm::cross(ray.origin, ray.direction));
            if (impact > reach) continue;
            const double depth = -std::log1p(-double(picture.pixels[y * picture.width + x].alpha));
            worst = std::max(worst, std::abs(depth - truth(impact)));
        }
    return worst;
}

// Across the surface the lattice holds a ramp of one voxel, which a trilinear field rounds off at both ends:
// each ray is off by a part of a voxel where it goes in and where it comes out, which is a part of 1 / radius
// here.
TEST_F(KnownAnswers, ABallOfConstantDensityConvergesToItsChords) {
    for (const int radius : {10, 20, 40}) {
        const FormulaField ball(
            "density", {{-radius - 1, -radius - 1, -radius - 1}, {radius + 2, radius + 2, radius + 2}},
            [radius](Position x, Position y, Position z, int) {
                const double r = std::sqrt(double(x * x + y * y + z * z));
                return std::clamp(radius + 0.5 - r, 0.0, 1.0);
            });
        const RenderRequest view =
            request(cameraAt({4.0 * radius, 2.0 * radius, 3.0 * radius}, {0, 0, 0}, 20), 32, 1.0 / radius);
        const auto camera = PinholeCamera::create(*view.camera, 32, 32);
        const double worst = worstDepth(draw({&ball}, view), *camera, 0.9 * radius, [&](double b) {
            return 2 * std::sqrt(double(radius * radius) - b * b) / radius;
        });
        EXPECT_LE(worst, 0.6 / radius) << radius;
    }
}

// A trilinear field is above a Gaussian's hollows and below its top by an eighth of its curvature per voxel
// squared at most, so the error falls with the square of the resolution.
TEST_F(KnownAnswers, AGaussianConvergesToItsClosedForm) {
    for (const int sigma : {4, 8, 16}) {
        const int edge = 5 * sigma;
        const FormulaField blob("density", {{-edge, -edge, -edge}, {edge + 1, edge + 1, edge + 1}},
                                [sigma](Position x, Position y, Position z, int) {
                                    return std::exp(-double(x * x + y * y + z * z) / (2.0 * sigma * sigma));
                                });
        const RenderRequest view =
            request(cameraAt({20.0 * sigma, 10.0 * sigma, 15.0 * sigma}, {0, 0, 0}, 15), 32, 1.0 / sigma);
        const auto camera = PinholeCamera::create(*view.camera, 32, 32);
        const double worst = worstDepth(draw({&blob}, view), *camera, 3.0 * sigma, [&](double b) {
            return std::sqrt(2 * std::numbers::pi) * std::exp(-b * b / (2.0 * sigma * sigma));
        });
        EXPECT_LE(worst, 0.6 / (sigma * sigma)) << sigma;
    }
}

TEST_F(KnownAnswers, AWorldTwoToTheKTimesAsLargeHasTheSamePixels) {
    std::vector<Picture> pictures;
    for (const double scale : {1.0, 0x1p40, 0x1p-40}) {
        FormulaField field = roughBlobField();
        const double columns[16] = {scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, 1};
        field.setTransform(*Affine::fromColumns(columns));
        RenderRequest view =
            request(cameraAt(glm::dvec3(10, 20, 150) * scale, glm::dvec3(0, 0, 5) * scale), 16, 0.05 / scale);
        Light* light = view.scene.add_lights();
        for (const double d : {-1.0, -1.0, 0.3}) light->add_direction(d);
        view.scene.mutable_medium()->mutable_emission()->set_channel("density");
        view.scene.mutable_medium()->mutable_emission()->set_scale(0.02 / scale);
        Picture picture = draw({&field}, view);
        for (Pixel& pixel : picture.pixels) pixel.depth = float(double(pixel.depth) / scale);
        pictures.push_back(std::move(picture));
    }
    for (std::size_t k : {1u, 2u}) {
        std::size_t differ = 0;
        for (std::size_t i = 0; i < pictures[0].pixels.size(); ++i)
            differ += std::memcmp(&pictures[0].pixels[i], &pictures[k].pixels[i], sizeof(Pixel)) != 0;
        EXPECT_EQ(differ, 0u) << "of " << pictures[0].pixels.size() << " pixels, with scale " << k;
    }
}

TEST_F(KnownAnswers, LightIsAbsorbedAlikeBothWays) {
    const FormulaField field = roughBlobField();
    ASSERT_TRUE(storeFields(folder_ / "test.bricks", {&field}, 16));
    std::mt19937 random(1);
    std::normal_distribution<double> normal;
    auto aside = [&] {
        return 120.0 * glm::normalize(glm::dvec3(normal(random), normal(random), normal(random)));
    };
    int through = 0;
    for (int trial = 0; trial < 40; ++trial) {
        const glm::dvec3 one = aside(), other = -one + 0.15 * aside(), up = aside();
        const double there =
            double(drawAgain(request(cameraAt(one, other, 40, up), 1, 0.05)).pixels[0].alpha);
        const double back = double(drawAgain(request(cameraAt(other, one, 40, up), 1, 0.05)).pixels[0].alpha);
        EXPECT_NEAR(there, back, 4e-7) << trial;
        through += there > 0.1;
    }
    EXPECT_GT(through, 20) << "the rays miss the medium and prove nothing";
}

}  // namespace
}  // namespace brickyard

// Fields, transforms, cameras and pictures at the edge of what numbers can say, made here.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>

#include "blob_field.h"
#include "extreme_table.h"
#include "stored_fields.h"

namespace brickyard {
namespace {

// In [0, 1), different at each position, the same in every run.
double noise(std::int64_t x, std::int64_t y, std::int64_t z) {
    std::uint64_t h = std::uint64_t(x) * 0x9e3779b97f4a7c15u ^ std::uint64_t(y) * 0xc2b2ae3d27d4eb4fu ^
                      std::uint64_t(z) * 0x165667b19e3779f9u;
    h = (h ^ h >> 31) * 0xd6e8feb86659fd93u;
    return double((h ^ h >> 32) >> 11) * 0x1p-53;
}

constexpr IndexBox kBox{{-10, -10, -10}, {11, 11, 11}};

FormulaField noiseField(double magnitude = 1, IndexBox box = kBox, double background = 0) {
    return FormulaField(
        "density", box,
        [magnitude](std::int64_t x, std::int64_t y, std::int64_t z, int) {
            return magnitude * (0.05 + noise(x, y, z));
        },
        SampleType::kFloat32, 1, background);
}

FormulaField transformed(const glm::dvec3& x, const glm::dvec3& y, const glm::dvec3& z,
                         const glm::dvec3& offset = {0, 0, 0}) {
    FormulaField field = noiseField();
    const double columns[16] = {x.x, x.y, x.z, 0, y.x,      y.y,      y.z,      0,
                                z.x, z.y, z.z, 0, offset.x, offset.y, offset.z, 1};
    field.setTransform(*Affine::fromColumns(columns));
    return field;
}

class ExtremeCases : public testing::Test {
protected:
    static ExtremeOutcome expectDrawn(const std::string& name, const std::string& what,
                                      const FieldSource& field, const ExtremeView& view) {
        ExtremeOutcome outcome = drawExtreme(field, view);
        const ExtremeRow row = rowOf(name, what, outcome);
        expectSound(row, outcome);
        expectRow("Cases", row);
        return outcome;
    }
    ExtremeOutcome expectCase(const std::string& name, const std::string& what, const FieldSource& field,
                              ExtremeView view = {}) {
        view.dataset = (folder_ / "case.bricks").string();
        const auto stored = storeFields(view.dataset, {&field});
        EXPECT_TRUE(stored) << name << ": " << (stored ? "" : stored.error().message);
        if (!stored) return {};
        return expectDrawn(name, what, field, view);
    }
    // Of the noise, which is stored once.
    void expectView(const std::string& name, const std::string& what, const Camera& camera,
                    std::uint32_t width = 20, std::uint32_t height = 20) {
        ExtremeView view;
        view.dataset = (folder_ / "noise.bricks").string();
        view.camera = camera;
        view.width = width;
        view.height = height;
        const FormulaField field = noiseField();
        if (!std::filesystem::exists(view.dataset)) {
            ASSERT_TRUE(storeFields(view.dataset, {&field}));
        }
        expectDrawn(name, what, field, view);
    }

    ScratchFolder folder_;
};

TEST_F(ExtremeCases, DensitiesOfAnyMagnitude) {
    for (const double magnitude : {1e-44, 1e-38, 1e-20, 1e10, 1e30, 1e37, 3e38}) {
        const auto outcome = expectCase(fmt::format("density {:.0e}", magnitude), "noise of that magnitude",
                                        noiseField(magnitude));
        // Alphas of 1e-20 must not drown in an absolute tolerance. (Those of 1e-38 are denormal floats.)
        if (magnitude > 1e-30) EXPECT_LE(outcome.worst_relative, 1e-5) << magnitude;
    }
}

TEST_F(ExtremeCases, DensitiesOfAllMagnitudesAndBothSignsSideBySide) {
    expectCase("density 1e-37 to 1e37", "each voxel of another magnitude",
               FormulaField("density", kBox, [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                   return std::pow(10.0, 74 * noise(x, y, z) - 37);
               }));
    for (const double magnitude : {1.0, 1e30})
        expectCase(fmt::format("density of both signs, {:.0e}", magnitude), "negative densities count as 0",
                   FormulaField("density", kBox, [=](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                       return magnitude * (noise(x, y, z) - 0.5);
                   }));
}

TEST_F(ExtremeCases, EmissionBeyondTheFloatRangeIsFinite) {
    const FormulaField field = noiseField(1e30);
    ASSERT_TRUE(storeFields(folder_ / "bright.bricks", {&field}));
    RenderRequest request;
    request.width = request.height = 8;
    request.density_scale = 1e-31;
    request.quality.reference = true;
    request.scene.mutable_medium()->mutable_emission()->set_channel("density");
    request.scene.mutable_medium()->mutable_emission()->set_scale(1e10);
    const auto outcome = drawStored(folder_ / "bright.bricks", request);
    ASSERT_TRUE(outcome);
    for (const Pixel& pixel : outcome->picture.pixels) ASSERT_TRUE(std::isfinite(pixel.radiance[0]));
}

TEST_F(ExtremeCases, VoxelSizes) {
    for (const double edge : {1e-30, 1e-9, 1e9, 1e30})
        expectCase(fmt::format("voxel size {:.0e}", edge), "world units",
                   transformed({edge, 0, 0}, {0, edge, 0}, {0, 0, edge}));
}

TEST_F(ExtremeCases, WorldOffsets) {
    for (const double edge : {1.0, 0.1})
        expectCase(fmt::format("offset 1e12, voxel {}", edge), "all three axes",
                   transformed({edge, 0, 0}, {0, edge, 0}, {0, 0, edge}, {1e12, -1e12, 1e12}));
}

TEST_F(ExtremeCases, IndicesThatAFloatCannotCountAndTheEndsOfInt32) {
    const std::pair<const char*, std::int64_t> places[] = {{"index 2^24", (1 << 24) - 5},
                                                           {"index INT32_MIN", INT32_MIN},
                                                           {"index INT32_MAX", std::int64_t(INT32_MAX) - 19}};
    for (const auto& [name, first] : places)
        expectCase(name, "20 voxels an edge from there, on each axis",
                   noiseField(1, {{first, first, first}, {first + 20, first + 20, first + 20}}));
}

TEST_F(ExtremeCases, Transforms) {
    expectCase("sheared", "x leans on z", transformed({1, 0, 0}, {0.5, 1, 0}, {3, 0, 1}));
    expectCase("mirrored", "all three axes", transformed({-1, 0, 0}, {0, -1, 0}, {0, 0, -1}));
    expectCase("flat", "one axis a millionth of the others", transformed({1, 0, 0}, {0, 1, 0}, {0, 0, 1e-6}));
    expectCase("rotated, mirrored, sheared, of three scales", "everything at once",
               transformed({0.6, 0.8, 0.1}, {1.6, -1.2, 0.3}, {0.1, 0.2, -0.05}, {5, -7, 1e4}));
    for (const double angle : {1e-3, 1e-6})
        expectCase(fmt::format("near-singular, {:.0e}", angle), "two axes at that angle to each other",
                   transformed({1, 0, 0}, {1, angle, 0}, {0, 0, 1}));
}

TEST_F(ExtremeCases, CamerasInsideTheMedium) {
    expectView("eye in a voxel", "field of view 90", cameraAt({0.3, 0.4, 0.6}, {1, 2, 3}, 90));
    expectView("eye on a voxel's face", "x is an integer", cameraAt({2, 0.4, 0.6}, {3, 2, 3}, 90));
    expectView("eye on a voxel's edge", "x and y are integers", cameraAt({2, 3, 0.6}, {3, 4, 3}, 90));
    expectView("eye on a voxel's corner", "looks along an axis", cameraAt({2, 3, -1}, {2, 3, 9}, 90));
    expectView("eye on a brick's corner", "looks along a diagonal",
               cameraAt({8, 8, 8}, {0, 0, 0}, 90, {0, 0, 1}));
    expectView("eye where octree roots meet", "index 0", cameraAt({0, 0, 0}, {1, 1, 1}, 120));
    expectView("eye on the medium's face", "looks in", cameraAt({11, 0, 0}, {0, 0, 0}, 90));
    expectView("eye on the medium's face, looks out", "all pixels empty",
               cameraAt({11, 0, 0}, {12, 0, 0}, 40));
}

TEST_F(ExtremeCases, CamerasFarAway) {
    for (const double distance : {1e6, 1e9, 1e11, 1e12}) {
        const double fov = 2 * std::atan(14 / distance) * 180 / 3.14159265358979323846;
        const glm::dvec3 way = glm::normalize(glm::dvec3(0.3, 0.5, 0.8));
        expectView(fmt::format("eye {:.0e} away", distance), "the medium fills the picture",
                   cameraAt(way * distance, {0, 0, 0}, fov));
    }
}

// Along an axis all positions are whole numbers of the eye's last bit, so distance costs nothing; off it, the
// renderer's distances from an eye 1e11 away have a last bit of 1e-5.
TEST_F(ExtremeCases, CamerasFarAwayAlongAnAxis) {
    expectView("eye 1e+15 away, along an axis", "one pixel",
               cameraAt({0.25, 0.5, 1e15}, {0.25, 0.5, 0}, 1e-9), 1, 1);
    expectView("eye 1e+15 away, looks aside", "all pixels empty",
               cameraAt({0.25, 0.5, 1e15}, {1e15, 0.5, 1e15}));
}

TEST_F(ExtremeCases, FieldsOfView) {
    expectView("field of view 0.001", "from inside", cameraAt({0.3, 0.4, -30}, {0.2, 0.5, 0}, 0.001));
    expectView("field of view 179", "from near", cameraAt({0, 0, 14}, {0.1, 0.2, 0}, 179));
    expectView("field of view 179.999", "from inside", cameraAt({0.1, 0.2, 0.3}, {1, 2, 0}, 179.999));
}

TEST_F(ExtremeCases, RaysParallelToAxes) {
    const glm::dvec3 axes[] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int a = 0; a < 3; ++a)
        for (const double sign : {1.0, -1.0}) {
            const std::string axis = std::string(sign > 0 ? "+" : "-") + "xyz"[a];
            const glm::dvec3 &way = axes[a], &side = axes[(a + 1) % 3], &other = axes[(a + 2) % 3];
            auto look = [&](const std::string& what, const glm::dvec3& through) {
                expectView("ray along " + axis + ", " + what, "one pixel",
                           cameraAt(through - 50.0 * sign * way, through + 50.0 * sign * way, 40, side), 1,
                           1);
            };
            look("through cells", 0.4 * side + 0.7 * other);
            look("in a face of cells", 3.0 * side + 0.7 * other);
            look("in an edge of cells", 3.0 * side - 2.0 * other);
            look("in a face of bricks", 8.0 * side + 0.7 * other);
            look("in an edge of bricks", 8.0 * side - 8.0 * other);
            look("in a face of octree roots", 0.0 * side + 0.7 * other);
        }
}

TEST_F(ExtremeCases, RaysAlmostParallelToAxes) {
    for (const double slope : {1e-15, 1e-12, 1e-6})
        expectView(fmt::format("ray off an axis by {:.0e}", slope), "crosses a face of bricks on its way",
                   cameraAt({8 - 50 * slope, 0.3, -50}, {8 + 50 * slope, 0.3, 50}, 1), 1, 1);
}

TEST_F(ExtremeCases, DiagonalRaysThroughCorners) {
    expectView("ray through corners of cells", "all three axes at once",
               cameraAt({-50, -50, -50}, {50, 50, 50}), 1, 1);
    expectView("ray through edges of cells", "two axes at once", cameraAt({-50, 0.3, -50}, {50, 0.3, 50}), 1,
               1);
}

TEST_F(ExtremeCases, BackgroundsThatAbsorb) {
    expectCase("background 0.5", "the medium ends one sample beyond its active voxels",
               noiseField(1, kBox, 0.5));
    expectCase("background -0.5", "negative, so it hides nothing", noiseField(1, kBox, -0.5));
    ExtremeView view;
    view.width = view.height = 1;
    view.camera = cameraAt({-11, 0.3, -50}, {-11, 0.3, 50});
    expectCase("ray in the medium's near face", "background 0.5", noiseField(1, kBox, 0.5), view);
}

TEST_F(ExtremeCases, SmallDatasets) {
    expectCase("one voxel", "an active box of 1", noiseField(1, {{3, 4, 5}, {4, 5, 6}}));
    expectCase("one voxel, 1e30", "the same, dense", noiseField(1e30, {{3, 4, 5}, {4, 5, 6}}));
    expectCase("empty", "no active voxel", noiseField(1, {{0, 0, 0}, {0, 0, 0}}));
    expectCase("all zero", "active voxels of 0", noiseField(0));
}

TEST_F(ExtremeCases, PicturesOfOneRowOrColumn) {
    const Camera camera = cameraAt({30, 40, 50}, {0, 0, 0}, 0.01);
    expectView("picture of 1 x 1", "one pixel", camera, 1, 1);
    expectView("picture of 16384 x 1", "wide", camera, 16384, 1);
    expectView("picture of 1 x 16384", "high", cameraAt({30, 40, 50}, {0, 0, 0}, 40), 1, 16384);
}

}  // namespace
}  // namespace brickyard

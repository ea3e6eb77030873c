// Pictures of fields with known answers, through a dataset on disk: exact where asked, bounded always, the
// same whatever the cache and the threads, and with no page that is not needed.
#include "client/renderer.h"

#include <gmock/gmock.h>

#include <numbers>

#include "blob_field.h"
#include "client/cpu/index_ray.h"
#include "core/camera.h"
#include "core/dataset_writer.h"
#include "core/frame_writer.h"
#include "core/octree_builder.h"
#include "frame_fixture.h"

namespace brickyard {
namespace {

class RendererTest : public testing::Test {
protected:
    void store(const std::vector<const FieldSource*>& fields, int edge = 8) {
        Manifest settings;
        settings.set_format_major(kFormatMajor);
        settings.set_brick_edge(std::uint32_t(edge));
        settings.set_nonfinite("reject");
        auto writer = DatasetWriter::open(folder_ / "test.bricks", settings, ExistingDataset::kOverwrite);
        ASSERT_TRUE(writer) << writer.error().message;
        const auto temporary = (*writer)->temporaryFrame(0);
        ASSERT_TRUE(temporary);
        auto frame = FrameWriter::create(*temporary);
        BuildOptions options;
        options.shape.edge_cells = edge;
        const std::vector<BuildOptions> all(fields.size(), options);
        auto footer = buildFrame(fields, all, **frame);
        ASSERT_TRUE(footer) << footer.error().message;
        auto finished = (*frame)->finish(*footer);
        ASSERT_TRUE(finished);
        FrameEntry entry;
        entry.set_frame(0);
        entry.set_file_bytes(finished->file_bytes);
        entry.set_footer_xxh64(finished->footer_checksum);
        ASSERT_TRUE((*writer)->commitFrame(*temporary, entry));
        ASSERT_TRUE((*writer)->finish());
    }
    RenderOutcome draw(const RenderRequest& request) {
        auto source = openSource((folder_ / "test.bricks").string(), "");
        EXPECT_TRUE(source) << source.error().message;
        auto outcome = makeCpuRenderer()->render(**source, request);
        EXPECT_TRUE(outcome) << outcome.error().message;
        return std::move(*outcome);
    }
    static Camera camera(glm::dvec3 eye, glm::dvec3 target, double fov = 40, glm::dvec3 up = {0, 1, 0}) {
        Camera c;
        for (int a = 0; a < 3; ++a) c.add_eye(eye[a]), c.add_target(target[a]), c.add_up(up[a]);
        c.set_vertical_fov_degrees(fov);
        return c;
    }
    static RenderRequest blobRequest() {
        RenderRequest request;
        request.width = 48, request.height = 40;
        request.camera = camera({10, 20, 150}, {0, 0, 5});
        request.density_scale = 0.05;
        return request;
    }
    static void expectSamePixels(const Picture& a, const Picture& b) {
        ASSERT_EQ(a.pixels.size(), b.pixels.size());
        std::size_t differ = 0;
        for (std::size_t i = 0; i < a.pixels.size(); ++i)
            differ += std::memcmp(&a.pixels[i], &b.pixels[i], sizeof(Pixel)) != 0;
        EXPECT_EQ(differ, 0u) << "of " << a.pixels.size() << " pixels";
    }

    ScratchFolder folder_;
};

// Optical depth of the blob along a world ray (identity transform) by brute force: midpoints in every cell.
double bruteDepth(const FormulaField& field, const WorldRay& ray) {
    const IndexBox box = field.info().active_box;
    const IndexRay index(ray, Affine());
    const glm::dvec3 low(box.begin[0] - 1, box.begin[1] - 1, box.begin[2] - 1),
        high(box.end[0], box.end[1], box.end[2]);
    const RaySpan span = index.clip(low, high, {0, 1e9});
    if (span.empty()) return 0;
    constexpr int kSteps = 4000;
    double sum = 0;
    for (int i = 0; i < kSteps; ++i) {
        const glm::dvec3 p =
            ray.origin + ray.direction * (span.begin + (span.end - span.begin) * (i + 0.5) / kSteps);
        const glm::dvec3 f = glm::floor(p), t = p - f;
        double v = 0;
        for (int q = 0; q < 8; ++q)
            v += ((q & 1) ? t.x : 1 - t.x) * ((q & 2) ? t.y : 1 - t.y) * ((q & 4) ? t.z : 1 - t.z) *
                 field.at(std::int64_t(f.x) + (q & 1), std::int64_t(f.y) + (q >> 1 & 1),
                          std::int64_t(f.z) + (q >> 2));
        sum += std::max(0.0, v);
    }
    return sum * (span.end - span.begin) / kSteps;
}

TEST_F(RendererTest, AHomogeneousSlabHasTheAlphaOfTheFormula) {
    const FormulaField slab("density", {{0, 0, 0}, {33, 33, 11}},
                            [](std::int64_t, std::int64_t, std::int64_t, int) { return 1.0; });
    store({&slab});
    RenderRequest request;
    request.width = request.height = 3;
    request.camera = camera({16, 16, 100}, {16, 16, 5}, 1);
    request.density_scale = 0.1;
    request.quality.reference = true;
    const Pixel centre = draw(request).picture.pixels[4];
    // 10 whole cells of density 1, and a ramp of one voxel down to 0 on either side.
    EXPECT_NEAR(double(centre.alpha), 1 - std::exp(-0.1 * 11), 1e-6);
    EXPECT_NEAR(double(centre.depth),
                100 - 5.0 - 11.0 / 2 + 11 * -std::log1p(-0.5 * (1 - std::exp(-1.1))) / 1.1, 0.05);
}

TEST_F(RendererTest, ReferenceEqualsQuadratureOfTheSource) {
    const FormulaField field = roughBlobField();
    store({&field});
    RenderRequest request = blobRequest();
    request.quality.reference = true;
    const RenderOutcome outcome = draw(request);
    EXPECT_TRUE(outcome.final);
    const auto view = PinholeCamera::create(*request.camera, request.width, request.height);
    for (std::uint32_t y = 0; y < request.height; y += 3)
        for (std::uint32_t x = 0; x < request.width; x += 3) {
            const Pixel& pixel = outcome.picture.pixels[y * request.width + x];
            const double truth = -std::expm1(-0.05 * bruteDepth(field, view->ray(x, y)));
            EXPECT_NEAR(double(pixel.alpha), truth, 3e-5) << x << "," << y;
            EXPECT_LE(double(pixel.bound_alpha), 4e-6) << "more than the float kernel's rounding";
        }
}

TEST_F(RendererTest, EveryPixelIsWithinItsBoundAndMostWithinThreeEstimates) {
    const FormulaField field = roughBlobField();
    store({&field});
    RenderRequest request = blobRequest();
    request.quality.reference = true;
    const Picture truth = draw(request).picture;
    for (const double max_error : {0.3, 0.1, 0.03, 0.01})
        for (const bool strict : {false, true}) {
            request.quality = {.strict = strict, .max_error = max_error};
            const RenderOutcome outcome = draw(request);
            EXPECT_TRUE(outcome.final);
            std::size_t beyond_three = 0, off = 0;
            for (std::size_t i = 0; i < truth.pixels.size(); ++i) {
                const Pixel& p = outcome.picture.pixels[i];
                const double error = std::abs(double(p.alpha) - double(truth.pixels[i].alpha));
                EXPECT_LE(error, double(p.bound_alpha) + 1e-6);
                EXPECT_LE(double(p.estimate_alpha), double(p.bound_alpha) + 1e-9);
                beyond_three += error > 3 * double(p.estimate_alpha) + 2e-6;
                off += error > max_error;
                if (strict)
                    EXPECT_LE(double(p.bound_alpha), max_error);
                else
                    EXPECT_LE(double(p.estimate_alpha), max_error / 3 + 1e-9);
            }
            EXPECT_LE(double(beyond_three), 0.003 * double(truth.pixels.size()) + 1) << max_error;
            EXPECT_LE(double(off), 0.003 * double(truth.pixels.size())) << max_error;
        }
}

TEST_F(RendererTest, AnErrorCostsFewerBytesThanTheReference) {
    const FormulaField field = roughBlobField();
    store({&field});
    RenderRequest request = blobRequest();
    request.quality.reference = true;
    const std::uint64_t reference = draw(request).streamed.bytes_streamed;
    request.quality = {.max_error = 0.1};
    const std::uint64_t loose = draw(request).streamed.bytes_streamed;
    EXPECT_LT(loose, reference / 2);
}

TEST_F(RendererTest, ThePictureIsTheSameForAnyCacheAndAnyNumberOfThreads) {
    const FormulaField field = roughBlobField();
    store({&field});
    Scene scene;
    Light* light = scene.add_lights();
    for (const double d : {-1.0, -1.0, 0.3}) light->add_direction(d);
    std::uint64_t reloads = 0;
    for (const bool lit : {false, true})
        for (const QualitySettings& quality :
             {QualitySettings{.reference = true}, QualitySettings{.max_error = 0.05}}) {
            RenderRequest request = blobRequest();
            request.width = request.height = 24;
            if (lit) request.scene = scene;
            request.quality = quality;
            request.threads = 1;
            const RenderOutcome whole = draw(request);
            ASSERT_TRUE(whole.final);
            request.threads = 3;
            expectSamePixels(whole.picture, draw(request).picture);
            request.cache_bytes = whole.cache_bytes / 10;
            const RenderOutcome tight = draw(request);
            EXPECT_TRUE(tight.final);
            EXPECT_LE(tight.cache_bytes, request.cache_bytes);
            reloads += tight.cache.reloads;
            expectSamePixels(whole.picture, tight.picture);
        }
    EXPECT_GT(reloads, 0u) << "the caches were not tight";
}

TEST_F(RendererTest, OnlyWhatThePictureNeedsIsStreamed) {
    const FormulaField density = roughBlobField();
    const FormulaField heat(
        "heat", {{-5, -5, -5}, {6, 6, 6}},
        [](std::int64_t x, std::int64_t, std::int64_t, int) { return 1.0 + 0.1 * double(x); });
    store({&density, &heat});
    RenderRequest request = blobRequest();
    request.quality.reference = true;
    const RenderOutcome alone = draw(request);

    request.scene.mutable_medium()->mutable_emission()->set_channel("heat");
    const RenderOutcome both = draw(request);
    EXPECT_GT(both.streamed.pages_streamed, alone.streamed.pages_streamed)
        << "a second channel has pages of its own";
    request.scene.clear_medium();

    request.camera = camera({10, 20, 150}, {20, 40, 300});
    EXPECT_EQ(draw(request).streamed.pages_streamed, 0u) << "the camera looks away";

    request = blobRequest();
    request.quality = {.max_error = 0.01, .pixels_per_voxel = 1};
    const std::uint64_t near = draw(request).streamed.pages_streamed;
    request.camera = camera({100, 200, 15000}, {0, 0, 5});
    const RenderOutcome far = draw(request);
    EXPECT_LT(far.streamed.pages_streamed, near / 8);
    EXPECT_TRUE(far.final);
}

TEST_F(RendererTest, ABudgetOfBytesGivesAPictureThatSaysItIsNotFinal) {
    const FormulaField field = roughBlobField();
    store({&field});
    RenderRequest request = blobRequest();
    request.quality.reference = true;
    const RenderOutcome truth = draw(request);
    request.max_stream_bytes = truth.streamed.bytes_streamed / 4;
    const RenderOutcome cut = draw(request);
    EXPECT_FALSE(cut.final);
    EXPECT_GT(cut.not_final.over_budget, 0u);
    EXPECT_LE(cut.streamed.bytes_streamed, request.max_stream_bytes);
    for (std::size_t i = 0; i < truth.picture.pixels.size(); ++i)
        EXPECT_LE(std::abs(double(cut.picture.pixels[i].alpha) - double(truth.picture.pixels[i].alpha)),
                  double(cut.picture.pixels[i].bound_alpha) + 1e-6);
}

TEST_F(RendererTest, SingleScatteringInAThinSlabFollowsItsFormula) {
    const FormulaField slab("density", {{0, 0, 0}, {65, 65, 11}},
                            [](std::int64_t, std::int64_t, std::int64_t, int) { return 1.0; });
    store({&slab});
    RenderRequest request;
    request.width = request.height = 3;
    request.camera = camera({32, 32, 100}, {32, 32, 5}, 0.5);
    request.density_scale = 0.05;
    Light* light = request.scene.add_lights();
    for (const double d : {0.0, 0.0, -1.0}) light->add_direction(d);  // from behind the camera
    for (int c = 0; c < 3; ++c) light->add_irradiance(2), request.scene.mutable_medium()->add_albedo(0.5f);
    request.quality.reference = true;
    const Pixel centre = draw(request).picture.pixels[4];
    // Camera and light share the way: integral of exp(-2 tau) d tau over [0, T], isotropic phase.
    const double depth = 0.05 * 11;
    const double expected = 0.5 * 2 / (4 * std::numbers::pi) * 0.5 * -std::expm1(-2 * depth);
    EXPECT_NEAR(double(centre.radiance[0]), expected, 2e-3 * expected);
    EXPECT_GE(double(centre.bound_radiance), std::abs(double(centre.radiance[0]) - expected));
}

TEST_F(RendererTest, EmissionInVacuumAddsUpAndIsAbsorbedInSmoke) {
    const FormulaField smoke("density", {{0, 0, 0}, {33, 33, 11}},
                             [](std::int64_t, std::int64_t, std::int64_t, int) { return 1.0; });
    const FormulaField glow("flame", {{0, 0, 0}, {33, 33, 11}},
                            [](std::int64_t, std::int64_t, std::int64_t, int) { return 3.0; });
    store({&smoke, &glow});
    RenderRequest request;
    request.width = request.height = 3;
    request.camera = camera({16, 16, 100}, {16, 16, 5}, 1);
    request.quality.reference = true;
    Emission* emission = request.scene.mutable_medium()->mutable_emission();
    emission->set_channel("flame");
    emission->set_scale(0.25);
    for (int c = 0; c < 3; ++c) emission->add_color(1);
    for (const double scale : {1e-9, 0.3}) {
        request.density_scale = scale;
        const Pixel centre = draw(request).picture.pixels[4];
        // Same shape for both: radiance = 0.75 / scale * alpha.
        const double expected = 0.75 / scale * -std::expm1(-scale * 11);
        EXPECT_NEAR(double(centre.radiance[0]), expected, 2e-3 * expected) << scale;
        EXPECT_GE(double(centre.bound_radiance), std::abs(double(centre.radiance[0]) - expected)) << scale;
    }
}

TEST_F(RendererTest, ScalingTheWorldChangesNoPixel) {
    std::vector<Picture> pictures;
    for (const double scale : {1.0, 1024.0, 1.0 / 4096}) {
        FormulaField field = roughBlobField();
        const double columns[16] = {scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, 1};
        field.setTransform(*Affine::fromColumns(columns));
        store({&field});
        RenderRequest request = blobRequest();
        request.camera = camera(glm::dvec3(10, 20, 150) * scale, glm::dvec3(0, 0, 5) * scale);
        request.density_scale = 0.05 / scale;
        request.quality.reference = true;
        pictures.push_back(draw(request).picture);
    }
    for (std::size_t i = 0; i < pictures[0].pixels.size(); ++i) {
        EXPECT_EQ(pictures[0].pixels[i].alpha, pictures[1].pixels[i].alpha);
        EXPECT_EQ(pictures[0].pixels[i].alpha, pictures[2].pixels[i].alpha);
    }
}

TEST_F(RendererTest, ACacheTooSmallForOneBrickIsRefused) {
    const FormulaField field = roughBlobField();
    store({&field});
    RenderRequest request = blobRequest();
    request.cache_bytes = 100;
    auto source = openSource((folder_ / "test.bricks").string(), "");
    const auto outcome = makeCpuRenderer()->render(**source, request);
    ASSERT_FALSE(outcome);
    EXPECT_THAT(outcome.error().message, testing::HasSubstr("less than one brick"));
}

}  // namespace
}  // namespace brickyard

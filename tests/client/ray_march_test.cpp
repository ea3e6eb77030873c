// The general renderer held against closed forms, against itself by other ways, and against what must not
// show.
#include "client/trace/ray_march.h"

#include <cmath>
#include <numbers>

#include "marched_pictures.h"

namespace brickyard {
namespace {

constexpr double kPi = std::numbers::pi;

TEST_F(RayMarchTest, ABoxAbsorbsAndGlowsByClosedForms) {
    const FormulaField slab = solid("density", {{0, 0, 0}, {65, 65, 11}}),
                       glow = solid("glow", {{0, 0, 0}, {65, 65, 11}}, 2);
    for (const int edge : {8, 16}) {
        store({&slab, &glow}, edge);
        const RenderRequest view = request(
            kAbove, 16, R"({"media": [{"density": "density", "density_scale": 0.07, "albedo": [0, 0, 0],
            "emission": {"channel": "glow", "scale": 0.3, "color": [1, 0.5, 0.25]}}]})");
        const Picture picture = draw(view);
        // 10 whole cells, and a ramp of one voxel down to 0 on either side.
        auto opacity = [](const WorldRay& ray) { return -std::expm1(-0.07 * along(ray, 0, 11)); };
        EXPECT_LE(worst(picture, view, alpha, opacity), 2e-6);
        EXPECT_LE(worst(picture, view, red, [&](const WorldRay& ray) { return 0.6 / 0.07 * opacity(ray); }),
                  2e-5);
        // Half of its opacity is reached in the middle of nowhere but there.
        EXPECT_LE(worst(picture, view, depth,
                        [&](const WorldRay& ray) {
                            return (60 - 10.5) / std::abs(ray.direction.z) -
                                   std::log1p(-0.5 * opacity(ray)) / 0.07;
                        }),
                  1e-2);
    }
}

TEST_F(RayMarchTest, EveryFilterKeepsABoxsInside) {
    const FormulaField slab = solid("density", {{-20, -20, 0}, {85, 85, 21}});
    store({&slab});
    for (const char* filter : {"nearest", "trilinear", "bspline", "catmull-rom", "mitchell", "gaussian"}) {
        const RenderRequest view =
            request(kAbove, 8,
                    R"({"media": [{"density_scale": 0.05, "filter": ")" + std::string(filter) +
                        R"("}], "clip": {"low": [-10, -10, 4], "high": [75, 75, 16]}})");
        EXPECT_LE(worst(draw(view), view, alpha,
                        [](const WorldRay& ray) { return -std::expm1(-0.05 * along(ray, 0, 12)); }),
                  2e-6)
            << filter;
    }
}

TEST_F(RayMarchTest, MediaAddUpWhereTheyOverlap) {
    const FormulaField field = roughBlobField(),
                       other = ball("other", {10, 5, 0}, 12, {{-3, -8, -13}, {24, 19, 14}});
    store({&field, &other});
    const Camera camera = cameraAt({30, 25, 110}, {0, 0, 5});
    auto depths = [&](const std::string& media) {
        const Picture picture = draw(request(camera, 24, R"({"media": [)" + media + "]}"));
        std::vector<double> out;
        for (const Pixel& pixel : picture.pixels) out.push_back(-std::log1p(-double(pixel.alpha)));
        return out;
    };
    const std::string a = R"({"density": "density", "density_scale": 0.03})",
                      b = R"({"density": "other", "density_scale": 0.05, "filter": "bspline"})";
    const auto one = depths(a), two = depths(b), both = depths(a + "," + b), twice = depths(a + "," + a),
               thrice = depths(a + "," + b + "," + a);
    for (std::size_t i = 0; i < one.size(); ++i) {
        ASSERT_NEAR(both[i], one[i] + two[i], 2e-3 * two[i] + 5e-6);
        ASSERT_NEAR(twice[i], 2 * one[i], 5e-6);
        ASSERT_NEAR(thrice[i], 2 * one[i] + two[i], 2e-3 * two[i] + 5e-6);
    }
}

// A glow that varies where the density does not, and one where there are no leaves of its own.
TEST_F(RayMarchTest, AGlowIsIntegratedThroughItsOwnCells) {
    const IndexBox box{{-24, -24, -24}, {25, 25, 25}};
    const FormulaField density = solid("density", {{-40, -40, -40}, {41, 41, 41}});
    const FormulaField glow("glow", box, [](Position x, Position y, Position z, int) {
        return std::max(0.0, std::exp(-double(x * x + y * y + z * z) / 120) *
                                 (1 + std::sin(1.9 * double(x)) * std::cos(2.1 * double(y - z))));
    });
    store({&density, &glow});
    for (const double scale : {0.01, 0.1}) {
        const RenderRequest view = request(
            cameraAt({30, 25, 90}, {0, 0, 0}, 30), 16,
            R"({"media": [{"density": "density", "density_scale": )" + std::to_string(scale) +
                R"(, "albedo": [0, 0, 0], "emission": {"channel": "glow", "scale": 0.2, "color": [1, 1, 1]}}]})");
        const ReferenceField absorbs(density), glows(glow);
        const Picture picture = draw(view);
        auto truth = [&](const WorldRay& ray) {
            return double(emittedRadiance(absorbs.along(ray), scale, glows.along(ray), 0.2L));
        };
        EXPECT_LE(worst(picture, view, red, truth), 0.003);
    }
}

TEST_F(RayMarchTest, AShellThinnerThanAVoxelSurvives) {
    const FormulaField ramp("density", {{0, 0, 0}, {65, 65, 33}},
                            [](Position, Position, Position z, int) { return double(z - 20); });
    store({&ramp});
    RenderRequest view = request(kAbove, 16, R"({"media": [{"density_scale": 40, "transfer": {"points": [
        {"value": 0.40, "color": [1, 0.5, 0], "opacity": 0}, {"value": 0.41, "color": [1, 0.5, 0], "opacity": 1}, {"value": 0.42, "color": [1, 0.5, 0], "opacity": 0}]}}]})");
    for (const bool reference : {true, false}) {
        view.quality.reference = reference;
        // Once more, steeply, where the ramp falls to the background.
        auto opacity = [](const WorldRay& ray) {
            return -std::expm1(-40 * 0.01 * 13 / 12 / std::abs(ray.direction.z));
        };
        const Picture picture = draw(view);
        EXPECT_LE(worst(picture, view, alpha, opacity), 1e-4) << reference;
        EXPECT_LE(worst(picture, view, red, opacity), 1e-4) << reference;
        EXPECT_LE(worst(picture, view, depth,
                        [](const WorldRay& ray) { return (60 - 20.41) / std::abs(ray.direction.z); }),
                  2)
            << reference;
    }
}

TEST_F(RayMarchTest, ALampFallsOffWithTheSquareOfTheDistanceAndASpotHasACone) {
    const FormulaField slab = solid("density", {{0, 0, 0}, {65, 65, 11}});
    store({&slab});
    const glm::dvec3 lamp(34, 30, 24);
    auto scene = [](const std::string& light) {
        return R"({"media": [{"density_scale": 0.002, "albedo": [1, 1, 1], "anisotropy": 0.3}], "lights": [)" +
               light + R"(], "clip": {"low": [0, 0, 0], "high": [64, 64, 10]}})";
    };
    const PhaseFunction phase{PhaseFunction::Kind::kHenyeyGreenstein, 0.3};
    auto truth = [&](const WorldRay& ray, double cosine_of_cone) {
        double sum = 0;
        constexpr int kSteps = 400;
        const double from = (10 - ray.origin.z) / ray.direction.z, length = along(ray, 0, 10);
        for (int i = 0; i < kSteps; ++i) {
            const double s = (i + 0.5) / kSteps * length;
            const glm::dvec3 point = ray.origin + (from + s) * ray.direction, way = lamp - point;
            const double distance = glm::length(way);
            if (way.z / distance < cosine_of_cone) continue;
            sum += length / kSteps * 0.002 * std::exp(-0.002 * s) *
                   phase(glm::dot(way / distance, ray.direction)) * 900 / (distance * distance) *
                   std::exp(-0.002 * (10 - point.z) * distance / way.z);
        }
        return sum;
    };
    const RenderRequest point = request(
        kAbove, 16, scene(R"({"position": [34, 30, 24], "intensity": [900, 900, 900], "shadows": "exact"})"));
    EXPECT_LE(worst(draw(point), point, red, [&](const WorldRay& ray) { return truth(ray, -1); }), 2e-4);
    const RenderRequest spot = request(
        kAbove, 16,
        scene(
            R"({"position": [34, 30, 24], "direction": [0, 0, -2], "intensity": [900, 900, 900], "cone_degrees": 30, "shadows": "exact"})"));
    const Picture lit = draw(spot);
    // A hard edge within a step.
    EXPECT_LE(
        worst(lit, spot, red, [&](const WorldRay& ray) { return truth(ray, std::cos(15 * kPi / 180)); }),
        3e-3);
    int dark = 0, bright = 0;
    float most = 0;
    for (const Pixel& pixel : lit.pixels) most = std::max(most, pixel.radiance[0]);
    for (const Pixel& pixel : lit.pixels)
        dark += pixel.radiance[0] == 0, bright += pixel.radiance[0] > 0.3f * most;
    EXPECT_GT(dark, 20);
    EXPECT_GT(bright, 20);
}

TEST_F(RayMarchTest, AClipKeepsABoxAndTheSidesOfPlanes) {
    const FormulaField slab = solid("density", {{-60, -60, -20}, {125, 125, 31}});
    store({&slab});
    struct Cut {
        std::string clip;
        double low, high;
    };
    for (
        const Cut& cut :
        {Cut{R"({"low": [-50, -50, 2.25], "high": [100, 100, 7.5]})", 2.25, 7.5},
         Cut{R"({"planes": [{"point": [0, 0, 3.5], "normal": [0, 0, 5]}]})", 3.5, 30.5},
         Cut{R"({"planes": [{"point": [0, 0, 3.5], "normal": [0, 0, -1]}, {"point": [9, 9, -3], "normal": [0, 0, 1]}]})",
             -3, 3.5},
         Cut{R"({"low": [-50, -50, -90], "high": [100, 100, 7.5], "planes": [{"point": [9, 9, -3], "normal": [0, 0, 1]}]})",
             -3, 7.5},
         Cut{R"({"planes": [{"point": [0, 0, 3], "normal": [0, 0, 1]}, {"point": [0, 0, 2], "normal": [0, 0, -1]}]})",
             0, 0}}) {
        const RenderRequest view =
            request(kAbove, 12, R"({"media": [{"density_scale": 0.04}], "clip": )" + cut.clip + "}");
        EXPECT_LE(
            worst(draw(view), view, alpha,
                  [&](const WorldRay& ray) { return -std::expm1(-0.04 * along(ray, cut.low, cut.high)); }),
            2e-6)
            << cut.clip;
    }
}

TEST_F(RayMarchTest, RaysEndAtWhatIsBehind) {
    const FormulaField slab = solid("density", {{-60, -60, -20}, {125, 125, 31}});
    store({&slab});
    RenderRequest view = request(
        kAbove, 12,
        R"({"media": [{"density_scale": 0.04}], "lights": [{"radiance": [1, 1, 1], "visible": true}]})");
    view.scene.mutable_media(0)->add_albedo(0), view.scene.mutable_media(0)->add_albedo(0),
        view.scene.mutable_media(0)->add_albedo(0);
    Picture behind(12, 12);
    const PinholeCamera camera = lens(view);
    for (std::uint32_t i = 0; i < 144; ++i)
        behind.pixels[i].depth =
            i % 3 == 0 ? 0 : float((60 - 11.25) / -camera.ray(i % 12, i / 12).direction.z);
    view.behind = &behind;
    const Picture picture = draw(view);
    for (std::uint32_t i = 0; i < 144; ++i) {
        const WorldRay ray = camera.ray(i % 12, i / 12);
        // Where nothing is behind, the sky is.
        if (i % 3 == 0) {
            EXPECT_EQ(picture.pixels[i].alpha, 1);
            EXPECT_NEAR(double(picture.pixels[i].radiance[0]), std::exp(-0.04 * along(ray, -20.5, 30.5)),
                        2e-6);
        } else {
            EXPECT_NEAR(double(picture.pixels[i].alpha), -std::expm1(-0.04 * along(ray, 11.25, 30.5)), 2e-6);
            EXPECT_EQ(picture.pixels[i].radiance[0], 0);
        }
    }
}

TEST_F(RayMarchTest, ShadowsOfEachKindAgree) {
    const FormulaField field = roughBlobField();
    // Transmittance towards +z, at the samples.
    const ReferenceField exact(field);
    std::map<std::array<Position, 3>, double> memo;
    const FormulaField baked("shade", {{-32, -27, -22}, {33, 28, 39}},
                             [&](Position x, Position y, Position z, int) {
                                 const auto [place, is_new] = memo.try_emplace({x, y, z});
                                 if (is_new) {
                                     // By trapezoids, downwards.
                                     double depth = 0;
                                     for (Position k = z; k < 38; ++k)
                                         depth += 0.5 * (field.at(x, y, k) + field.at(x, y, k + 1));
                                     place->second = std::exp(-0.05 * depth);
                                 }
                                 return place->second;
                             });
    store({&field, &baked});
    auto view = [&](const std::string& shadows) {
        RenderRequest out =
            request(cameraAt({60, 45, 90}, {0, 0, 5}, 35), 20,
                    R"({"media": [{"density": "density", "density_scale": 0.05, "albedo": [1, 1, 1]}],
            "lights": [{"direction": [0, 0, -1], "irradiance": [9, 9, 9], "shadows": ")" +
                        shadows + R"(", "baked": "shade"}]})");
        if (shadows != "baked") out.scene.mutable_lights(0)->clear_baked();
        out.quality.reference = false;
        out.quality.max_error = 0.01;
        return out;
    };
    const Picture truth = draw(view("exact"));
    double brightest = 0;
    for (const Pixel& pixel : truth.pixels) brightest = std::max(brightest, double(pixel.radiance[0]));
    EXPECT_GT(brightest, 0.1);
    for (const char* kind : {"deep", "baked"}) {
        const Picture picture = draw(view(kind));
        int off = 0;
        for (std::size_t i = 0; i < truth.pixels.size(); ++i)
            off += std::abs(double(picture.pixels[i].radiance[0] - truth.pixels[i].radiance[0])) >
                   3 * std::hypot(double(picture.pixels[i].estimate_radiance),
                                  double(truth.pixels[i].estimate_radiance)) +
                       3e-3;
        EXPECT_LE(off, 4) << kind;
        EXPECT_LE(worstDifference(picture, truth), 0.02) << kind;
    }
    EXPECT_GT(worstDifference(draw(view("none")), truth), 0.05);
}

TEST_F(RayMarchTest, TheSizeAndThePlaceOfTheWorldDoNotMatter) {
    const Camera plain = cameraAt({30, 25, 110}, {0, 0, 5});
    auto picture = [&](double scale, const glm::dvec3& offset) {
        FormulaField field = roughBlobField();
        field.setTransform(*Affine::fromColumns(std::vector<double>{
            scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, scale, 0, offset.x, offset.y, offset.z, 1}));
        store({&field});
        RenderRequest out = request(
            cameraAt(glm::dvec3(30, 25, 110) * scale + offset, glm::dvec3(0, 0, 5) * scale + offset), 24,
            R"({"media": [{"albedo": [1, 1, 1]}], "lights": [{"direction": [0.3, -1, -0.2], "irradiance": [5, 5, 5]}],
                "surfaces": [{"channel": "density", "iso": 0.9, "opacity": 0.5}]})");
        out.density_scale = 0.05 / scale;
        return draw(out);
    };
    const Picture truth = picture(1, {0, 0, 0});
    for (const glm::dvec3& offset : {glm::dvec3(1e12, -1e12, 1e12), glm::dvec3(0, 0, 3e12)})
        EXPECT_LE(worstDifference(truth, picture(1, offset)), 1e-4);
    EXPECT_LE(worstDifference(truth, picture(1e-9, {0, 0, 0})), 1e-5);
    EXPECT_LE(worstDifference(truth, picture(1e9, {0, 0, 0})), 1e-5);
    EXPECT_LE(worstDifference(truth, picture(1e-9, {1e-3, 1e-3, -1e-3})), 1e-4);
}

TEST_F(RayMarchTest, APlaneIsHitWhereItIsAndSmokeInFrontDoesNotMoveIt) {
    const FormulaField ramp("ramp", {{-40, -40, -20}, {105, 105, 33}},
                            [](Position, Position, Position z, int) { return 20 - double(z); });
    const FormulaField smoke = solid("density", {{-40, -40, 26}, {105, 105, 30}});
    store({&ramp, &smoke});
    const std::string surface = R"("surfaces": [{"channel": "ramp", "iso": 12.625}])";
    for (const std::string& media :
         {std::string(), std::string(R"("media": [{"density": "density", "density_scale": 0.02}], )")}) {
        const RenderRequest view = request(kAbove, 16, "{" + media + surface + "}");
        const Picture picture = draw(view);
        EXPECT_LE(worst(picture, view, depth,
                        [](const WorldRay& ray) { return (60 - 7.375) / std::abs(ray.direction.z); }),
                  1e-4)
            << media;
        EXPECT_LE(worst(picture, view, alpha, [](const WorldRay&) { return 1; }), 0);
    }
    // The normal is straight up: a light from there lights it whole, with the cosine.
    const RenderRequest lit =
        request(kAbove, 8,
                "{" + surface + R"(, "lights": [{"direction": [0, -0.6, -0.8], "irradiance": [2, 2, 2]}]})");
    EXPECT_LE(worst(draw(lit), lit, red, [](const WorldRay&) { return 0.8 * 2 * 0.8 / kPi; }), 1e-5);
}

TEST_F(RayMarchTest, SurfacesLetThroughWhatTheirOpacitySays) {
    const FormulaField cone("cone", {{-31, -31, -31}, {32, 32, 32}},
                            [](Position x, Position y, Position z, int) {
                                return std::max(0.0, 30 - std::sqrt(double(x * x + y * y + z * z)));
                            });
    store({&cone});
    // Through the middle of both balls.
    const RenderRequest view = request(
        cameraAt({0, 0, 100}, {0, 0, 0}, 4), 8,
        R"({"surfaces": [{"channel": "cone", "iso": 10, "opacity": 0.3}, {"channel": "cone", "iso": 20, "opacity": 0.2}]})");
    const Picture picture = draw(view);
    EXPECT_LE(worst(picture, view, alpha, [](const WorldRay&) { return 1 - 0.7 * 0.7 * 0.8 * 0.8; }), 1e-6);
    const RenderRequest inner = request(
        cameraAt({0, 0, 100}, {0, 0, 0}, 4), 8,
        R"({"surfaces": [{"channel": "cone", "iso": 10, "opacity": 0.3}, {"channel": "cone", "iso": 20, "opacity": 1}]})");
    const Picture opaque = draw(inner);
    EXPECT_LE(worst(opaque, inner, alpha, [](const WorldRay&) { return 1; }), 0);
    // Of its final opacity half is reached at the inner one.
    EXPECT_LE(worst(opaque, inner, depth,
                    [](const WorldRay& ray) {
                        const double middle = -glm::dot(ray.origin, ray.direction),
                                     aside = glm::dot(ray.origin, ray.origin) - middle * middle;
                        return middle - std::sqrt(100 - aside);
                    }),
              0.06);
    // A ball's silhouette is closed, and round to a part of a voxel.
    const RenderRequest whole = request(cameraAt({0, 0, 100}, {0, 0, 0}, 50), 48,
                                        R"({"surfaces": [{"channel": "cone", "iso": 10}]})");
    const PinholeCamera camera = lens(whole);
    const Picture round = draw(whole);
    for (std::uint32_t i = 0; i < 48 * 48; ++i) {
        const WorldRay ray = camera.ray(i % 48, i / 48);
        const double impact = glm::length(glm::cross(ray.origin, ray.direction));
        if (std::abs(impact - 20) > 0.1) {
            ASSERT_EQ(round.pixels[i].alpha, impact < 20 ? 1 : 0) << i;
        }
    }
}

// Levels of detail change with the distance: nothing may jump from one picture to the next that does not in
// the exact ones.
TEST_F(RayMarchTest, AZoomDoesNotFlicker) {
    const FormulaField field = roughBlobField();
    store({&field});
    std::vector<Picture> finals, truths;
    constexpr int kFrames = 20;
    for (int i = 0; i < kFrames; ++i) {
        const double away = 400 * std::pow(1.03, i);
        RenderRequest view = request(cameraAt({0.3 * away, 0.2 * away, away}, {0, 0, 5}, 12), 24,
                                     R"({"media": [{"density_scale": 0.05, "albedo": [1, 1, 1]}],
            "lights": [{"direction": [0.3, -1, -0.2], "irradiance": [5, 5, 5], "shadows": "exact"}]})");
        truths.push_back(draw(view));
        view.quality.reference = false;
        view.quality.max_error = 0.01;
        view.quality.pixels_per_voxel = 1;
        finals.push_back(draw(view));
        EXPECT_LE(worstDifference(truths.back(), finals.back()), 0.08) << i;
    }
    // What changes beyond what should, from frame to frame.
    for (int i = 1; i < kFrames; ++i)
        for (std::size_t p = 0; p < truths[0].pixels.size(); ++p) {
            const std::size_t now = std::size_t(i), before = now - 1;
            const double wanted =
                double(truths[now].pixels[p].radiance[0] - truths[before].pixels[p].radiance[0]);
            const double got =
                double(finals[now].pixels[p].radiance[0] - finals[before].pixels[p].radiance[0]);
            ASSERT_NEAR(got, wanted, 0.02) << "frame " << i << " pixel " << p;
        }
}

}  // namespace
}  // namespace brickyard

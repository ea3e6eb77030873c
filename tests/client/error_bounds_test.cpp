// Each inequality of docs/error-bounds.md on random input, against long double.
#include <gmock/gmock.h>

#include <numbers>
#include <random>

#include "blob_field.h"
#include "client/cpu/cell_walk.h"
#include "client/cpu/node_error.h"
#include "reference_field.h"
#include "stored_fields.h"
#include "tools/field_reader.h"

namespace brickyard {
namespace {

double uniform(std::mt19937& random, double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
}
glm::dvec3 somewhere(std::mt19937& random, double low, double high) {
    return {uniform(random, low, high), uniform(random, low, high), uniform(random, low, high)};
}

// Smooth and rough at once, of both signs where `shift` is negative; another one for each seed.
FormulaField randomField(unsigned seed, double shift, const std::string& name = "density") {
    std::mt19937 random(seed);
    const glm::dvec3 centre = somewhere(random, -8, 8), wave = somewhere(random, 0.2, 1.9);
    const double width = uniform(random, 60, 300), rough = uniform(random, 0.1, 0.8);
    return FormulaField(
        name, {{-18, -17, -16}, {19, 18, 17}}, [=](std::int64_t x, std::int64_t y, std::int64_t z, int) {
            const glm::dvec3 p(x, y, z), d = p - centre;
            const double wiggle =
                std::sin(wave.x * p.x) * std::sin(wave.y * p.y + wave.x) * std::cos(wave.z * p.z);
            return std::exp(-glm::dot(d, d) / width) * (1 + rough * wiggle) + shift;
        });
}

Camera randomCamera(std::mt19937& random) {
    // One in three stands inside.
    const double away = random() % 3 == 0 ? 10 : 70;
    return cameraAt(away * glm::normalize(somewhere(random, -1, 1)), somewhere(random, -5, 5), 35,
                    somewhere(random, 0.1, 1));
}

const QualitySettings kQualities[] = {
    {.reference = true},
    {.max_error = 0.3},
    {.max_error = 0.05},
    {.strict = true, .max_error = 0.3},
    {.strict = true, .max_error = 0.05},
    {.max_error = 0.15, .pixels_per_voxel = 4},
    {.max_error = 0.01, .pixels_per_voxel = 1},
};

class ErrorBounds : public testing::Test {
protected:
    void store(const std::vector<const FieldSource*>& fields) {
        const auto stored = storeFields(path(), fields);
        ASSERT_TRUE(stored) << stored.error().message;
    }
    Picture draw(const RenderRequest& request) {
        auto outcome = drawStored(path(), request);
        EXPECT_TRUE(outcome) << outcome.error().message;
        EXPECT_TRUE(outcome->final);
        return std::move(outcome->picture);
    }
    std::filesystem::path path() const { return folder_ / "test.bricks"; }
    static PinholeCamera cameraOf(const RenderRequest& request) {
        return *PinholeCamera::create(*request.camera, request.width, request.height);
    }

    ScratchFolder folder_;
};

TEST(PositivePart, OfACubicIsIntegratedToRounding) {
    std::mt19937 random(1);
    int mixed = 0;
    for (int trial = 0; trial < 20000; ++trial) {
        Cell cell;
        const double shift = uniform(random, -1, 1), size = std::exp2(uniform(random, -60, 60));
        for (double& corner : cell.corner) corner = size * (uniform(random, -1, 1) + shift);
        const glm::dvec3 from = somewhere(random, 0, 1), to = somewhere(random, 0, 1);
        // The field along the way by its values, for the reference by its control points.
        Bernstein cubic{};
        for (unsigned ends = 0; ends < 8; ++ends) {
            long double value = 0;
            for (unsigned i = 0; i < 8; ++i) {
                long double weight = 1;
                for (int a = 0; a < 3; ++a) {
                    const auto x = (long double)((ends >> a & 1) ? to[a] : from[a]);
                    weight *= (i >> a & 1) ? x : 1 - x;
                }
                value += weight * (long double)cell.corner[i];
            }
            const auto k = std::size_t(__builtin_popcount(ends));
            cubic[k] += k == 0 || k == 3 ? value : value / 3;
        }
        const long double truth = positiveMean(cubic);
        double largest = 0, least = 1e300;
        for (const double corner : cell.corner) {
            largest = std::max(largest, std::abs(corner));
            least = std::min(least, corner);
        }
        mixed += least < 0 && truth > 0;
        // Where nothing cancels, relative to the integral itself.
        const double allowed = 1e-12 * (least >= 0 ? double(truth) : largest);
        EXPECT_NEAR(meanPositive(cell, from, to), double(truth), allowed) << trial;
    }
    EXPECT_GT(mixed, 5000);
}

TEST(PositivePart, OfTwoFieldsDiffersNoMoreThanTheFieldsDo) {
    std::mt19937 random(2);
    for (int trial = 0; trial < 2000; ++trial) {
        Bernstein a{}, b{};
        long double furthest = 0;
        for (std::size_t i = 0; i < 4; ++i) {
            a[i] = (long double)uniform(random, -1, 1);
            b[i] = a[i] + (long double)uniform(random, -0.1, 0.1);
            // A cubic lies between its control points, and so does a difference.
            furthest = std::max(furthest, std::abs(a[i] - b[i]));
        }
        EXPECT_LE(std::abs(positiveMean(a) - positiveMean(b)), furthest * (1 + 1e-15L));
    }
}

// The sub-box of a node's error grid that holds a position.
std::size_t subBoxOf(const NodeKey& key, BrickShape shape, const glm::dvec3& index) {
    const double edge = double(shape.edge_cells) * std::ldexp(1.0, key.level);
    std::size_t at = 0, stride = 1;
    for (int a = 0; a < 3; ++a) {
        const std::int32_t corner = a == 0 ? key.x : a == 1 ? key.y : key.z;
        const double part = (index[a] - edge * corner) / edge * kErrorGridEdge;
        at += stride * std::size_t(std::clamp(int(std::floor(part)), 0, kErrorGridEdge - 1));
        stride *= kErrorGridEdge;
    }
    return at;
}

// Sums over points of a segment are what integrals are: if the inequality holds for each, it does for those.
TEST_F(ErrorBounds, ANodeIsWithinItsHalfWidthAlongAnySegment) {
    std::mt19937 random(3);
    for (const double shift : {0.0, -0.2}) {
        const FormulaField field = randomField(11, shift);
        store({&field});
        const auto store = BrickStore::open(path() / "frames/000000.brk");
        ASSERT_TRUE(store) << store.error().message;
        const FieldReader reader(*store, 0);
        int deviating = 0;
        for (int trial = 0; trial < 400; ++trial) {
            const int level = 1 + int(random() % 3);
            const glm::dvec3 begin = somewhere(random, -16, 16), end = begin + somewhere(random, -6, 6);
            double coarse = 0, fine = 0, half_width = 0;
            for (int i = 0; i < 64; ++i) {
                const glm::dvec3 p = begin + (end - begin) * ((i + 0.5) / 64);
                const auto node = reader.find({std::int64_t(std::floor(p.x)), std::int64_t(std::floor(p.y)),
                                               std::int64_t(std::floor(p.z))},
                                              level);
                ASSERT_TRUE(node);
                const auto low = reader.sample(p, level), high = reader.sample(p, 0);
                ASSERT_TRUE(low && high);
                double bound = 0;
                if (*node) {
                    const NodeErrors errors =
                        errorsOfNode((*node)->record(), (*node)->tree->errorGrid((*node)->node));
                    bound = errors.bound[errors.uniform ? 0 : subBoxOf((*node)->key, reader.shape(), p)];
                }
                const double deviation = std::abs((*low)[0] - (*high)[0]);
                EXPECT_LE(deviation, bound + 1e-12) << "level " << level;
                deviating += deviation > 0.1 * bound && bound > 0;
                coarse += std::max(0.0, (*low)[0]);
                fine += std::max(0.0, (*high)[0]);
                half_width += bound;
            }
            EXPECT_LE(std::abs(coarse - fine), half_width + 1e-10) << "level " << level;
        }
        EXPECT_GT(deviating, 1000) << "nothing comes near its bound: the test sees no deviation";
    }
}

TEST_F(ErrorBounds, TheTrueTransmittanceIsWithinTheBoundOfAlpha) {
    std::mt19937 random(4);
    std::size_t pixels = 0, off = 0;
    for (unsigned seed = 0; seed < 10; ++seed) {
        const FormulaField field = randomField(seed, seed % 2 ? -0.15 : 0.0);
        store({&field});
        const ReferenceField truth(field);
        RenderRequest request;
        request.width = request.height = 12;
        request.camera = randomCamera(random);
        request.density_scale = std::exp(uniform(random, -4, 2));
        const PinholeCamera camera = cameraOf(request);
        std::vector<double> alphas;
        for (std::uint32_t i = 0; i < 144; ++i) {
            const long double depth = truth.integral(camera.ray(i % 12, i / 12));
            alphas.push_back(double(-std::expm1(-depth * (long double)*request.density_scale)));
        }
        for (const QualitySettings& quality : kQualities) {
            request.quality = quality;
            const Picture picture = draw(request);
            for (std::size_t i = 0; i < alphas.size(); ++i) {
                const Pixel& p = picture.pixels[i];
                const double error = std::abs(double(p.alpha) - alphas[i]);
                ++pixels;
                off += error > 1e-4;
                EXPECT_LE(error, double(p.bound_alpha) + 1e-12) << "seed " << seed << ", pixel " << i;
                if (quality.reference) EXPECT_LE(error, 2e-6) << "seed " << seed << ", pixel " << i;
                if (quality.strict) EXPECT_LE(double(p.bound_alpha), quality.max_error);
            }
        }
    }
    EXPECT_GT(off, pixels / 20) << "the pictures are exact, and their bounds untested";
}

TEST_F(ErrorBounds, TheTrueEmissionIsWithinTheBoundOfRadiance) {
    std::mt19937 random(5);
    for (unsigned seed = 20; seed < 26; ++seed) {
        const FormulaField smoke = randomField(seed, seed % 2 ? -0.15 : 0.0),
                           glow = randomField(seed + 100, -0.1, "flame");
        store({&smoke, &glow});
        const ReferenceField density(smoke), flame(glow);
        RenderRequest request;
        request.width = request.height = 8;
        request.camera = randomCamera(random);
        request.density_scale = std::exp(uniform(random, -4, 1));
        const double strength = std::exp(uniform(random, -3, 1));
        Emission* emission = request.scene.mutable_medium()->mutable_emission();
        emission->set_channel("flame");
        emission->set_scale(strength);
        for (const float c : {1.0f, 0.5f, 0.25f}) emission->add_color(c);
        const PinholeCamera camera = cameraOf(request);
        std::vector<double> radiances;
        for (std::uint32_t i = 0; i < 64; ++i) {
            const WorldRay ray = camera.ray(i % 8, i / 8);
            radiances.push_back(
                double(emittedRadiance(density.along(ray), (long double)*request.density_scale,
                                       flame.along(ray), (long double)strength)));
        }
        for (const QualitySettings& quality : kQualities) {
            request.quality = quality;
            const Picture picture = draw(request);
            for (std::size_t i = 0; i < radiances.size(); ++i) {
                const Pixel& p = picture.pixels[i];
                for (std::size_t c = 0; c < 3; ++c)
                    EXPECT_LE(std::abs(double(p.radiance[c]) - radiances[i] * std::exp2(-double(c))),
                              double(p.bound_radiance) + 1e-12)
                        << "seed " << seed << ", pixel " << i << ", true radiance " << radiances[i];
            }
        }
    }
}

TEST_F(ErrorBounds, TheTrueScatteredLightIsWithinTheBoundOfRadiance) {
    std::mt19937 random(6);
    for (unsigned seed = 40; seed < 44; ++seed) {
        const FormulaField field = randomField(seed, seed % 2 ? -0.15 : 0.0);
        store({&field});
        const ReferenceField truth(field);
        RenderRequest request;
        request.width = request.height = 5;
        request.camera = randomCamera(random);
        request.density_scale = std::exp(uniform(random, -4, 0));
        const glm::dvec3 to_light = glm::normalize(somewhere(random, -1, 1));
        Light* light = request.scene.add_lights();
        for (int a = 0; a < 3; ++a) light->add_direction(-to_light[a]), light->add_irradiance(8);
        for (int c = 0; c < 3; ++c) request.scene.mutable_medium()->add_albedo(0.75f);
        const PinholeCamera camera = cameraOf(request);
        std::vector<double> radiances;
        for (std::uint32_t i = 0; i < 25; ++i)
            radiances.push_back(0.75 * 8 / (4 * std::numbers::pi) *
                                double(scatteredWeight(truth, camera.ray(i % 5, i / 5),
                                                       (long double)*request.density_scale, to_light)));
        for (const QualitySettings& quality : kQualities) {
            request.quality = quality;
            const Picture picture = draw(request);
            for (std::size_t i = 0; i < radiances.size(); ++i) {
                const Pixel& p = picture.pixels[i];
                // The reference's own quadrature across the kinks of shadows is good to 1e-5.
                EXPECT_LE(std::abs(double(p.radiance[0]) - radiances[i]), double(p.bound_radiance) + 1e-5)
                    << "seed " << seed << ", pixel " << i << ", true radiance " << radiances[i];
            }
        }
    }
}

// A wall of every depth from thin to opaque, something bright and dense behind it.
TEST_F(ErrorBounds, WhatAnOpaqueDepthHidesIsWithinTheBounds) {
    const FormulaField wall("density", {{-18, -18, -18}, {19, 19, 19}},
                            [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                                return z > 6 ? 1.0 : z < -6 ? 2 + std::sin(double(x + 2 * y)) : 0.0;
                            });
    const FormulaField glow("flame", {{-18, -18, -18}, {19, 19, -6}},
                            [](std::int64_t, std::int64_t, std::int64_t, int) { return 1.0; });
    store({&wall, &glow});
    const ReferenceField density(wall), flame(glow);
    for (const double depth : {1.0, 10.0, 20.0, 44.0, 46.0, 48.0, 1e3, 1e6}) {
        RenderRequest request;
        request.width = request.height = 6;
        request.camera = cameraAt({3, 5, 60}, {0, 0, 0}, 20);
        request.density_scale = depth / 12.5;
        Emission* emission = request.scene.mutable_medium()->mutable_emission();
        emission->set_channel("flame");
        emission->set_scale(1e4);
        const PinholeCamera camera = cameraOf(request);
        std::vector<double> alphas, radiances;
        for (std::uint32_t i = 0; i < 36; ++i) {
            const WorldRay ray = camera.ray(i % 6, i / 6);
            const auto scale = (long double)*request.density_scale;
            alphas.push_back(double(-std::expm1(-scale * density.integral(ray))));
            radiances.push_back(double(emittedRadiance(density.along(ray), scale, flame.along(ray), 1e4L)));
        }
        for (const QualitySettings& quality : kQualities) {
            request.quality = quality;
            const Picture picture = draw(request);
            for (std::size_t i = 0; i < alphas.size(); ++i) {
                const Pixel& p = picture.pixels[i];
                EXPECT_LE(std::abs(double(p.alpha) - alphas[i]), double(p.bound_alpha)) << depth;
                EXPECT_LE(std::abs(double(p.radiance[0]) - radiances[i]), double(p.bound_radiance))
                    << depth << ", true radiance " << radiances[i];
            }
        }
    }
}

}  // namespace
}  // namespace brickyard

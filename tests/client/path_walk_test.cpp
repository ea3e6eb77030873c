// Random walks have no bias, tell how noisy they are, and are the same whatever they wait for.
#include "client/trace/path_walk.h"

#include <chrono>
#include <functional>
#include <random>
#include <thread>

#include "client/brick_page.h"
#include "scene_pictures.h"
#include "shuffled_source.h"

namespace brickyard {
namespace {

const Camera kCamera = cameraAt({9, 15, 42}, {1, 0, 2}, 30);

// Round and rough, with a hole.
FormulaField cloud(const std::string& name = "density") {
    return FormulaField(name, {{-12, -11, -10}, {13, 12, 14}},
                        [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                            const double r = std::sqrt(double(x * x + y * y + z * z)) / 11;
                            return std::max(0.0, std::min(1.0, 3 - 3 * r)) *
                                   (0.6 + 0.4 * std::sin(1.7 * double(x) + double(y * z)));
                        });
}

class PathWalkTest : public ScenePictures {
protected:
    // Two images that add up to one everywhere.
    void writeSkies() {
        Picture half(16, 8), rest(16, 8), whole(16, 8);
        std::mt19937 random(3);
        for (std::size_t i = 0; i < half.pixels.size(); ++i) {
            const float share = random() % 4 == 0 ? 0.97f : 0.02f;
            half.pixels[i].radiance = {share, share, share};
            rest.pixels[i].radiance = {1 - share, 1 - share, 1 - share};
            whole.pixels[i].radiance = {1, 1, 1};
        }
        ASSERT_TRUE(writeExr(half, scratch_ / "half.exr"));
        ASSERT_TRUE(writeExr(rest, scratch_ / "rest.exr"));
        ASSERT_TRUE(writeExr(whole, scratch_ / "whole.exr"));
    }
    // Light that is the same from everywhere is the same behind whatever only scatters it.
    void expectFurnace(const std::string& medium, const std::string& lights, std::uint32_t samples) {
        RenderRequest request =
            this->request(kCamera, 16, R"({"media": [)" + medium + R"(], "lights": [)" + lights + "]}");
        request.most_bounces = 100000;
        const Picture picture = path(request, samples, *this);
        for (std::size_t c = 0; c < 3; ++c) {
            const MeanOf all = meanOf(
                picture, [&](const Pixel& pixel) { return double(pixel.radiance[c] + 1 - pixel.alpha); });
            EXPECT_NEAR(all.mean, 1, 4 * all.error + 1e-6) << medium << "\n" << lights;
            EXPECT_LT(all.error, 0.02);
        }
    }
    std::string furnaceMedium(double scale, const std::string& phase) const {
        return R"({"density_scale": )" + std::to_string(scale) + R"(, "albedo": [1, 1, 1], )" + phase + "}";
    }
};

const std::string kSky = R"({"radiance": [1, 1, 1]})";
const std::string kTwoSkies = R"({"image": "half.exr"}, {"image": "rest.exr"})";
const std::string kFourSkies =
    R"({"image": "half.exr", "radiance": [0.5, 0.5, 0.5]}, {"image": "rest.exr", "radiance": [0.5, 0.5, 0.5]},
       {"image": "whole.exr", "radiance": [0.3, 0.3, 0.3]}, {"radiance": [0.2, 0.2, 0.2]})";

TEST_F(PathWalkTest, AWhiteFurnaceStaysWhite) {
    const FormulaField field = cloud();
    store({&field});
    writeSkies();
    for (const char* phase :
         {R"("anisotropy": 0)", R"("anisotropy": 0.7)", R"("anisotropy": -0.4)", R"("phase": "rayleigh")"}) {
        expectFurnace(furnaceMedium(0.03, phase), kSky, 64);
        expectFurnace(furnaceMedium(0.8, phase), kSky, 64);
    }
}

TEST_F(PathWalkTest, AWhiteFurnaceOfImagesStaysWhite) {
    const FormulaField field = cloud();
    store({&field});
    writeSkies();
    for (const char* phase : {R"("anisotropy": 0)", R"("anisotropy": 0.7)", R"("phase": "rayleigh")"})
        for (const std::string& lights : {std::string(R"({"image": "whole.exr"})"), kTwoSkies, kFourSkies}) {
            expectFurnace(furnaceMedium(0.03, phase), lights, 64);
            expectFurnace(furnaceMedium(0.6, phase), lights, 64);
        }
}

TEST_F(PathWalkTest, AWhiteFurnaceOfMediaThatOverlapStaysWhite) {
    const FormulaField field = cloud();
    const FormulaField box("box", {{-3, -20, -3}, {20, 3, 4}}, [](auto...) { return 1.0; });
    store({&field, &box});
    writeSkies();
    const std::string media =
        R"({"density": "density", "density_scale": 0.3, "albedo": [1, 1, 1], "anisotropy": 0.6},
        {"density": "box", "density_scale": 0.1, "albedo": [1, 1, 1], "phase": "rayleigh", "filter": "bspline"})";
    expectFurnace(media, kSky, 64);
    expectFurnace(media, kFourSkies, 64);
}

// An opaque white ball in the middle, and smoke around it.
TEST_F(PathWalkTest, AWhiteFurnaceWithASurfaceStaysWhite) {
    const FormulaField field = cloud();
    const FormulaField ball("ball", {{-9, -9, -9}, {10, 10, 10}},
                            [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                                return std::max(0.0, 8 - std::sqrt(double(x * x + y * y + z * z)));
                            });
    store({&field, &ball});
    writeSkies();
    for (const std::string& lights : {kSky, kTwoSkies})
        for (const char* opacity : {"1", "0.4"}) {
            RenderRequest request =
                this->request(kCamera, 16,
                              R"({"media": [{"density_scale": 0.1, "albedo": [1, 1, 1]}],
                "surfaces": [{"channel": "ball", "iso": 2, "color": [1, 1, 1], "opacity": )" +
                                  std::string(opacity) + R"(}], "lights": [)" + lights + "]}");
            request.most_bounces = 100000;
            const MeanOf all = meanOf(path(request, 64, *this), [](const Pixel& pixel) {
                return double(pixel.radiance[0] + 1 - pixel.alpha);
            });
            EXPECT_NEAR(all.mean, 1, 4 * all.error + 1e-6) << lights << opacity;
        }
}

// Inside of an opaque shell no light gets in.
TEST_F(PathWalkTest, AClosedShellIsDarkInside) {
    const FormulaField shell(
        "shell", {{-14, -14, -14}, {15, 15, 15}}, [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
            return std::max(0.0, 4 - std::abs(std::sqrt(double(x * x + y * y + z * z)) - 9));
        });
    const FormulaField mist("density", {{-14, -14, -14}, {15, 15, 15}}, [](auto...) { return 1.0; });
    store({&shell, &mist});
    writeSkies();
    for (const std::string& lights : {kSky, kTwoSkies, std::string(R"({"direction": [1, 2, -3]})")})
        for (const char* media : {"", R"("media": [{"density": "density", "density_scale": 0.03}], )"}) {
            const Picture picture = path(
                request(cameraAt({0, 1, 0}, {3, 1, 2}, 90), 16,
                        "{" + std::string(media) +
                            R"("surfaces": [{"channel": "shell", "iso": 2}], "lights": [)" + lights + "]}"),
                16, *this);
            double most = 0;
            for (const Pixel& pixel : picture.pixels) {
                most = std::max(most, double(pixel.radiance[0]));
                ASSERT_EQ(pixel.alpha, 1);
            }
            EXPECT_EQ(most, 0) << lights << media;
        }
}

// What the marcher integrates without noise.
TEST_F(PathWalkTest, OneScatteringIsWhatTheMarcherGives) {
    const FormulaField field = cloud();
    store({&field});
    writeSkies();
    const std::string lights[] = {
        R"({"direction": [0.5, -1, -0.3], "irradiance": [3, 2, 1]})",
        R"({"position": [5, 18, 9], "intensity": [900, 800, 700]})",
        R"({"position": [0, 24, 0], "direction": [0.1, -1, 0], "intensity": [2000, 2000, 2000], "cone_degrees": 40, "cone_softness": 0.5})",
        R"({"position": [0, 24, 0], "direction": [0.1, -1, 0], "intensity": [2000, 2000, 2000], "shadows": "none"})",
        R"({"radiance": [1, 0.8, 0.5], "samples": 60})",
        R"({"image": "half.exr", "radiance": [1, 0.8, 0.5], "samples": 60})",
        R"({"direction": [0.5, -1, -0.3], "irradiance": [3, 2, 1]}, {"position": [5, 18, 9], "intensity": [900, 800, 700]},
           {"direction": [-0.5, -1, -0.3], "irradiance": [1, 2, 1]}, {"direction": [0.5, 1, -0.3], "irradiance": [1, 1, 3]})"};
    for (const std::string& light : lights) {
        RenderRequest request = this->request(
            kCamera, 16,
            R"({"media": [{"density_scale": 0.15, "albedo": [0.9, 0.8, 0.7], "anisotropy": 0.4}],
            "lights": [)" +
                light + "]}");
        request.most_bounces = 0;
        RenderRequest marched = request;
        const bool sky = light.find("samples") != std::string::npos;
        marched.samples = sky ? 1 : 16;
        const Picture expected = draw(marched), actual = path(request, 128, *this);
        for (std::size_t c = 0; c < 3; ++c) {
            auto radiance = [&](const Pixel& pixel) { return double(pixel.radiance[c]); };
            const MeanOf wanted = meanOf(expected, radiance), got = meanOf(actual, radiance);
            EXPECT_GT(wanted.mean, 0.003);
            EXPECT_NEAR(got.mean, wanted.mean, 4 * got.error + (sky ? 0.01 : 0.003) * wanted.mean)
                << light << " channel " << c;
        }
    }
}

class PathNoiseTest : public PathWalkTest {
protected:
    void SetUp() override {
        const FormulaField field = cloud();
        store({&field});
        request_ = request(
            kCamera, 12, R"({"media": [{"density_scale": 0.1, "albedo": [0.9, 0.9, 0.9], "anisotropy": 0.3}],
            "lights": [{"direction": [0.5, -1, -0.3], "irradiance": [4, 4, 4]}, {"radiance": [0.3, 0.3, 0.3]}]})");
    }
    RenderRequest request_;
};

TEST_F(PathNoiseTest, TheErrorFallsAsOneOverTheRootOfTheSamplesAndIsToldRightly) {
    request_.seed = 77;
    const Picture truth = path(request_, 4096, *this);
    std::vector<double> errors, ratios;
    for (const std::uint32_t samples : {16u, 64u, 256u}) {
        double square = 0, relative = 0;
        int count = 0;
        for (const std::uint64_t seed : {1u, 2u, 3u}) {
            request_.seed = seed;
            const Picture picture = path(request_, samples, *this);
            for (std::size_t i = 0; i < picture.pixels.size(); ++i) {
                const double error = double(picture.pixels[i].radiance[0] - truth.pixels[i].radiance[0]);
                if (!(picture.pixels[i].estimate_radiance > 0)) {
                    ASSERT_NEAR(error, 0, 1e-3);
                    continue;
                }
                square += error * error;
                relative += std::pow(error / std::hypot(double(picture.pixels[i].estimate_radiance),
                                                        double(truth.pixels[i].estimate_radiance)),
                                     2);
                ++count;
            }
        }
        errors.push_back(std::sqrt(square / count));
        ratios.push_back(std::sqrt(relative / count));
    }
    EXPECT_NEAR(std::log(errors[0] / errors[2]) / std::log(16.0), 0.5, 0.1)
        << errors[0] << " " << errors[1] << " " << errors[2];
    // Of few samples the estimate is short: their distribution has a long tail.
    EXPECT_NEAR(ratios[1], 1, 0.3);
    EXPECT_NEAR(ratios[2], 1, 0.1);
}

TEST_F(PathNoiseTest, TheSameSeedGivesTheSamePictureWhateverTheThreads) {
    request_.seed = 5;
    request_.threads = 1;
    const Picture one = path(request_, 12, *this);
    for (const unsigned threads : {2u, 5u}) {
        request_.threads = threads;
        EXPECT_TRUE(same(one, path(request_, 12, *this))) << threads;
    }
    request_.seed = 6;
    const Picture other = path(request_, 12, *this);
    EXPECT_GT(worstDifference(one, other), 1e-3);
    // And it is another noise, not another picture.
    const auto radiance = [](const Pixel& pixel) { return double(pixel.radiance[0]); };
    const MeanOf a = meanOf(one, radiance), b = meanOf(other, radiance);
    EXPECT_NEAR(a.mean, b.mean, 5 * std::hypot(a.error, b.error));
}

TEST_F(PathNoiseTest, PagesThatComeInAnyOrderGiveTheSamePicture) {
    const Picture expected = path(request_, 8, *this);
    for (const unsigned seed : {1u, 2u, 3u}) {
        request_.path = true;
        request_.samples = 8;
        request_.threads = 1 + seed;
        auto inner = openSource(folder().string(), "");
        ASSERT_TRUE(inner);
        ShuffledSource source(std::move(*inner), seed);
        const auto outcome = makeCpuRenderer()->render(source, request_);
        ASSERT_TRUE(outcome) << outcome.error().message;
        EXPECT_TRUE(outcome->final);
        EXPECT_GT(source.heldBack(), 0u);
        EXPECT_TRUE(same(expected, outcome->picture)) << seed;
    }
}

TEST_F(PathNoiseTest, ACacheOfFewBricksGivesTheSamePicture) {
    const Picture expected = path(request_, 4, *this);
    request_.path = true;
    request_.samples = 4;
    for (const std::uint64_t pages : {60, 40}) {
        request_.cache_bytes = pages * pageFloats(BrickShape{8}) * sizeof(float);
        const RenderOutcome outcome = outcomeOf(request_);
        EXPECT_TRUE(outcome.final) << pages;
        EXPECT_LE(outcome.cache_bytes, request_.cache_bytes);
        EXPECT_TRUE(same(expected, outcome.picture)) << pages;
    }
}

TEST_F(PathNoiseTest, TheSamplesGoWhereTheErrorAskedForIsNotReached) {
    request_.quality.reference = false;
    request_.path = true;
    request_.samples = 0;
    request_.quality.max_error = 0.3;
    const RenderOutcome rough = outcomeOf(request_);
    request_.quality.max_error = 0.03;
    const RenderOutcome fine = outcomeOf(request_);
    EXPECT_TRUE(rough.final);
    EXPECT_TRUE(fine.final);
    EXPECT_GT(fine.samples, 2 * rough.samples);
    EXPECT_LT(fine.samples, 4096u);
    for (const Pixel& pixel : fine.picture.pixels)
        EXPECT_LE(std::max(pixel.estimate_radiance, pixel.estimate_alpha), 0.03f / 3);
    // Held against the truth.
    request_.samples = 1024;
    request_.seed = 9;
    const Picture truth = draw(request_);
    int off = 0;
    for (std::size_t i = 0; i < truth.pixels.size(); ++i)
        off += std::abs(truth.pixels[i].radiance[0] - fine.picture.pixels[i].radiance[0]) > 0.03f;
    EXPECT_LE(off, 3);
}

TEST_F(PathNoiseTest, ADeadlineShowsWhatThereIs) {
    request_.path = true;
    request_.samples = 1u << 20;
    request_.deadline = std::chrono::duration<double>(0.5);
    const auto begin = std::chrono::steady_clock::now();
    const RenderOutcome outcome = outcomeOf(request_);
    EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(5));
    EXPECT_FALSE(outcome.final);
    EXPECT_GT(outcome.not_final.queued, 0u);
    EXPECT_GT(outcome.samples, 1u);
    EXPECT_LT(outcome.samples, request_.samples);
    const MeanOf alpha = meanOf(outcome.picture, [](const Pixel& pixel) { return double(pixel.alpha); });
    EXPECT_GT(alpha.mean, 0.1);
}

// What of one sample nobody knows: it is not said to be exact.
TEST_F(PathNoiseTest, OneSampleClaimsNoPrecision) {
    const Picture picture = path(request_, 1, *this);
    for (const Pixel& pixel : picture.pixels)
        if (pixel.radiance[0] > 0) {
            ASSERT_GT(pixel.estimate_radiance, 0.01f);
        }
}

// The camera ray is integrated: nothing is left to chance.
TEST_F(PathWalkTest, WhatOnlyGlowsHasNoNoise) {
    const FormulaField field = cloud();
    const FormulaField glow("glow", {{-9, -9, -9}, {10, 10, 10}},
                            [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                                return std::exp(-double(x * x + 2 * y * y + z * z) / 30);
                            });
    store({&field, &glow});
    RenderRequest request = this->request(
        kCamera, 16, R"({"media": [{"density": "density", "density_scale": 0.2, "albedo": [0, 0, 0],
        "emission": {"channel": "glow", "scale": 0.4, "color": [1, 1, 1]}}]})");
    request.samples = 1;
    const Picture marched = draw(request), walked = path(request, 1, *this);
    EXPECT_LT(worstDifference(marched, walked), 1e-6);
    // It lights what scatters, as a light does: brighter than without, and never out of proportion.
    request.scene.mutable_media(0)->clear_albedo();
    for (const float a : {1.0f, 1.0f, 1.0f}) request.scene.mutable_media(0)->add_albedo(a);
    const Picture lit = path(request, 256, *this);
    const auto radiance = [](const Pixel& pixel) { return double(pixel.radiance[0]); };
    const MeanOf without = meanOf(marched, radiance), with = meanOf(lit, radiance);
    EXPECT_GT(with.mean, without.mean + 10 * with.error);
}

}  // namespace
}  // namespace brickyard

// Lit pictures against an integrator of their own, packets of pixels against single rays, and what a picture
// says of why it is not final.
#include "client/cpu/beam_tile.h"

#include <gmock/gmock.h>

#include <numbers>
#include <random>

#include "blob_field.h"
#include "dense_light.h"
#include "stored_fields.h"

namespace brickyard {
namespace {

double uniform(std::mt19937& random, double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
}
glm::dvec3 somewhere(std::mt19937& random, double low, double high) {
    return {uniform(random, low, high), uniform(random, low, high), uniform(random, low, high)};
}

// Puffs of several sizes with rough edges, never negative; another cloud for each seed.
FormulaField cloudOf(unsigned seed) {
    std::mt19937 random(seed);
    struct Puff {
        glm::dvec3 centre;
        double width, strength;
    };
    std::vector<Puff> puffs;
    for (int i = 0; i < 12; ++i)
        puffs.push_back({somewhere(random, -20, 20), uniform(random, 3, 12), uniform(random, 0.3, 1)});
    const glm::dvec3 wave = somewhere(random, 0.3, 1.3);
    return FormulaField(
        "density", {{-30, -30, -30}, {31, 31, 31}}, [=](std::int64_t x, std::int64_t y, std::int64_t z, int) {
            const glm::dvec3 p(x, y, z);
            double sum = 0;
            for (const Puff& puff : puffs) {
                const glm::dvec3 d = (p - puff.centre) / puff.width;
                sum += puff.strength * std::exp(-glm::dot(d, d));
            }
            const double rough =
                std::sin(wave.x * p.x + 0.4 * p.y) * std::sin(wave.y * p.y) * std::sin(wave.z * p.z);
            return std::max(0.0, sum * (1 + 0.5 * rough) - 0.06);
        });
}

class Pictures : public testing::Test {
protected:
    std::filesystem::path path() const { return folder_ / "test.bricks"; }
    std::filesystem::path frame() const { return path() / "frames/000000.brk"; }
    RenderOutcome draw(const RenderRequest& request) const {
        auto outcome = drawStored(path(), request);
        EXPECT_TRUE(outcome) << outcome.error().message;
        return std::move(*outcome);
    }
    ScratchFolder folder_;
};

// A cloud in light, and its true radiance.
class LitPictures : public Pictures {
protected:
    void store(unsigned seed, int edge, double density_scale, double anisotropy) {
        std::mt19937 random(seed + 1000);
        const FormulaField cloud = cloudOf(seed);
        ASSERT_TRUE(storeFields(path(), {&cloud}, edge));
        const DenseLight truth(cloud);
        request_ = RenderRequest();
        request_.width = request_.height = 48;
        request_.camera = cameraAt(110.0 * glm::normalize(somewhere(random, -1, 1)), {0, 0, 0}, 35);
        request_.density_scale = density_scale;
        const glm::dvec3 to_light = glm::normalize(somewhere(random, -1, 1));
        // All of its light from one side: a radiance of 0.8 at most where scattering has no direction.
        Light* light = request_.scene.add_lights();
        for (int a = 0; a < 3; ++a) {
            light->add_direction(-to_light[a]);
            light->add_irradiance(float(4 * std::numbers::pi));
            request_.scene.mutable_medium()->add_albedo(0.8f);
        }
        request_.scene.mutable_medium()->set_anisotropy(anisotropy);
        const auto camera = PinholeCamera::create(*request_.camera, request_.width, request_.height);
        radiances_.clear();
        for (std::uint32_t i = 0; i < request_.width * request_.height; ++i) {
            const WorldRay ray = camera->ray(i % request_.width, i / request_.width);
            const double g = anisotropy, cosine = glm::dot(to_light, ray.direction);
            const double phase = (1 - g * g) / std::pow(1 + g * g - 2 * g * cosine, 1.5);
            radiances_.push_back(double(0.8f) * phase * truth.scatteredWeight(ray, density_scale, to_light));
        }
    }

    RenderRequest request_;
    std::vector<double> radiances_;
};

// What the estimates of some pictures are worth.
struct Calibration {
    double squares = 0, estimates = 0;
    std::size_t pixels = 0, beyond_three = 0;

    void add(double error, double estimate) {
        ++pixels;
        squares += error * error;
        estimates += estimate;
        beyond_three += error > 3 * estimate + 1e-5;
    }
    double beyond() const { return double(beyond_three) / double(pixels); }
    double meanOverRms() const { return estimates / double(pixels) / std::sqrt(squares / double(pixels)); }
};

TEST_F(LitPictures, EstimatesTellTheErrorOfRadianceAndBoundsHold) {
    Calibration all;
    for (const int edge : {8, 16, 32})
        for (const unsigned seed : {1u, 2u, 3u})
            for (const double density : {0.02, 0.1, 0.6}) {
                store(seed, edge, density, seed == 2 ? 0.6 : 0);
                for (const double max_error : {0.0, 0.3, 0.1, 0.03, 0.01}) {
                    SCOPED_TRACE(testing::Message() << "edge " << edge << ", seed " << seed << ", density "
                                                    << density << ", error " << max_error);
                    request_.quality = {.reference = max_error == 0, .max_error = max_error};
                    const RenderOutcome outcome = draw(request_);
                    EXPECT_TRUE(outcome.final);
                    Calibration here;
                    std::size_t off = 0;
                    for (std::size_t i = 0; i < radiances_.size(); ++i) {
                        const Pixel& p = outcome.picture.pixels[i];
                        if (radiances_[i] == 0 && p.alpha == 0) continue;
                        const double error = std::abs(double(p.radiance[0]) - radiances_[i]);
                        EXPECT_LE(error, double(p.bound_radiance) + 1e-5) << "pixel " << i;
                        here.add(error, double(p.estimate_radiance));
                        all.add(error, double(p.estimate_radiance));
                        // A lattice ends at a point per voxel, or sixteen along a brick: some estimates stay
                        // above.
                        off += double(p.estimate_radiance) <= max_error / 3 && error > max_error;
                    }
                    EXPECT_LE(here.beyond(), 0.01);
                    EXPECT_LE(double(off), 0.003 * double(here.pixels));
                    EXPECT_GE(here.meanOverRms(), 0.6);
                    EXPECT_LE(here.meanOverRms(), 4);
                }
            }
    EXPECT_LE(all.beyond(), 0.003);
    RecordProperty("beyond_three", std::to_string(all.beyond()));
    RecordProperty("mean_over_rms", std::to_string(all.meanOverRms()));
}

// A haze that a float cannot tell from nothing still scatters.
TEST_F(Pictures, AThinHazeInBrightLightHasTheRadianceOfItsDepth) {
    const FormulaField slab("density", {{0, 0, 0}, {65, 65, 65}},
                            [](std::int64_t, std::int64_t, std::int64_t, int) { return 1.0; });
    ASSERT_TRUE(storeFields(path(), {&slab}, 16));
    RenderRequest request;
    request.width = request.height = 4;
    request.camera = cameraAt({32.3, 32.4, 200}, {32, 32, 5}, 1);
    Light* light = request.scene.add_lights();
    for (const double d : {0.1, 0.2, -1.0}) light->add_direction(d), light->add_irradiance(1e6f);
    for (int c = 0; c < 3; ++c) request.scene.mutable_medium()->add_albedo(1);
    request.quality.reference = true;
    for (const double scale : {1e-9, 2e-8, 1e-7, 3e-7}) {
        request.density_scale = scale;
        const RenderOutcome outcome = draw(request);
        const double expected = 1e6 / (4 * std::numbers::pi) * scale * 65;
        for (const Pixel& pixel : outcome.picture.pixels)
            EXPECT_NEAR(double(pixel.radiance[0]) / expected, 1, 1e-3) << scale;
    }
}

// Rays that leave a brick all but along its face: rounding to float must not take them out before.
TEST_F(Pictures, ARayAlongAFaceBetweenBricksLosesNothing) {
    // Rough, so that its leaves are at level 0 and x = 16 is a face.
    const FormulaField slab("density", {{0, 0, 0}, {33, 33, 33}},
                            [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                                return 1 + 0.5 * std::sin(double(x + 3 * y)) * std::cos(2.0 * double(z));
                            });
    ASSERT_TRUE(storeFields(path(), {&slab}, 8));
    const DenseLight truth(slab);
    for (const double beside : {1e-13, 1e-11, 1e-9, 1e-7, -1e-9}) {
        RenderRequest request;
        request.width = request.height = 1;
        request.density_scale = 0.01;
        // Over the face inside the fourth brick.
        request.camera = cameraAt({16 + beside, 16.3, 100}, {16 - beside, 17.1, -93}, 1);
        request.quality.reference = true;
        const Pixel pixel = draw(request).picture.pixels[0];
        const WorldRay ray = PinholeCamera::create(*request.camera, 1, 1)->ray(0, 0);
        const double alpha = -std::expm1(-0.01 * truth.depth({ray.origin, ray.direction + 1e-18}));
        EXPECT_NEAR(double(pixel.alpha), alpha, double(pixel.bound_alpha) + 1e-7) << beside;
    }
}

Camera anyCamera(std::mt19937& random) {
    const double away[] = {3, 40, 90, 300, 1e5};
    return cameraAt(away[random() % 5] * glm::normalize(somewhere(random, -1, 1)), somewhere(random, -60, 60),
                    uniform(random, 5, 140), somewhere(random, -1, 1));
}

Result<PagedChannel> channelOf(const std::filesystem::path& frame) {
    auto store = BrickStore::open(frame);
    if (!store) return tl::unexpected(store.error());
    const FrameFooter& footer = (*store)->footer();
    return PagedChannel::create(footer.channels(0), 0, int(footer.brick_edge()), (*store)->fileBytes());
}

// The same rays as one by one, and a box is left out only where none of its pixels sees the medium.
TEST_F(Pictures, PacketsHaveTheRaysOfTheCameraAndDropNone) {
    std::mt19937 random(3);
    FormulaField cloud = cloudOf(1);
    const double columns[16] = {0.3, 0.4, 0, 0, -0.5, 0.4, 0.1, 0, 0.2, 0, 0.7, 0, 3, -4, 5, 1};
    cloud.setTransform(*Affine::fromColumns(columns));
    ASSERT_TRUE(storeFields(path(), {&cloud}));
    const auto channel = channelOf(frame());
    ASSERT_TRUE(channel);
    std::size_t seen = 0, empty = 0;
    for (int trial = 0; trial < 300; ++trial) {
        const std::uint32_t width = 16 + random() % 40, height = 16 + random() % 40;
        const auto camera = PinholeCamera::create(anyCamera(random), width, height);
        ASSERT_TRUE(camera);
        PixelBox box{std::uint32_t(random() % 16), std::uint32_t(random() % 16), 0, 0};
        box.x1 = std::min(width, box.x0 + 1 + std::uint32_t(random() % 32));
        box.y1 = std::min(height, box.y0 + 1 + std::uint32_t(random() % 32));
        const PixelPackets packets = packetsOf(*camera, *channel, box);
        empty += packets.packets.empty();
        std::vector<int> times(std::size_t(width) * height);
        for (std::size_t p = 0; p < packets.packets.size(); ++p)
            for (int lane = 0; lane < RayPacket::kRays; ++lane) {
                const RayPacket& packet = packets.packets[p];
                if (!hasLane(packets.lanes[p].used, lane)) {
                    EXPECT_FALSE(packet.live(lane));
                    continue;
                }
                const PixelPlace at = packets.lanes[p].place[lane];
                ASSERT_TRUE(at.x >= box.x0 && at.x < box.x1 && at.y >= box.y0 && at.y < box.y1);
                ++times[at.y * width + at.x];
                const IndexRay ray(camera->ray(at.x, at.y), channel->transform());
                for (int a = 0; a < 3; ++a) {
                    EXPECT_NEAR(packet.direction[a][lane], ray.direction[a],
                                1e-14 * glm::length(ray.direction));
                    EXPECT_EQ(packet.origin[a][lane], ray.origin[a]);
                }
                EXPECT_NEAR(packets.lanes[p].unit[lane], ray.unitLength(), 1e-13 * ray.unitLength());
            }
        for (const PixelPlace& at : packets.others) ++times[at.y * width + at.x];
        for (std::uint32_t y = box.y0; y < box.y1; ++y)
            for (std::uint32_t x = box.x0; x < box.x1; ++x) {
                const IndexRay ray(camera->ray(x, y), channel->transform());
                const RaySpan span = ray.clip(channel->clipLow(), channel->clipHigh(), {0, 1e300});
                EXPECT_LE(times[y * width + x], 1);
                // A hair's breadth of medium is a matter of rounding.
                if (!(span.end - span.begin > 1e-9 * span.end)) continue;
                ++seen;
                EXPECT_EQ(times[y * width + x], 1) << x << "," << y << " of trial " << trial;
            }
    }
    EXPECT_GT(seen, 5000u);
    EXPECT_GT(empty, 20u) << "nothing is ever left out";
}

class Explanations : public Pictures {
protected:
    void SetUp() override {
        const FormulaField field = roughBlobField();
        ASSERT_TRUE(storeFields(path(), {&field}));
        request_.width = request_.height = 40;
        request_.camera = cameraAt({10, 20, 150}, {0, 0, 5});
        request_.density_scale = 0.05;
        request_.quality.reference = true;
        request_.explain = true;
    }
    RenderRequest request_;
};

TEST_F(Explanations, AFinalReferenceHasLevelZeroAndNothingMissing) {
    const RenderOutcome outcome = draw(request_);
    ASSERT_TRUE(outcome.final);
    ASSERT_EQ(outcome.why.size(), outcome.picture.pixels.size());
    for (const PixelWhy& why : outcome.why) {
        EXPECT_EQ(why.level, 0);
        EXPECT_EQ(why.queued + why.over_budget + why.failed + why.no_finer_data, 0);
    }
}

TEST_F(Explanations, APictureThatIsCutShortSaysWhereSomethingIsMissing) {
    const RenderOutcome whole = draw(request_);
    // With a limit the levels in between are streamed too.
    request_.max_stream_bytes = std::uint64_t(1) << 40;
    const RenderOutcome ample = draw(request_);
    EXPECT_TRUE(ample.final);
    for (const PixelWhy& why : ample.why) EXPECT_EQ(why.queued + why.over_budget + why.failed, 0);
    request_.max_stream_bytes = ample.streamed.bytes_streamed * 19 / 20;
    const RenderOutcome cut = draw(request_);
    EXPECT_FALSE(cut.final);
    std::size_t missing = 0, complete = 0;
    for (std::size_t i = 0; i < cut.why.size(); ++i) {
        const PixelWhy& why = cut.why[i];
        const Pixel &pixel = cut.picture.pixels[i], &truth = whole.picture.pixels[i];
        EXPECT_EQ(why.queued + why.failed, 0) << "pixel " << i;
        if (why.over_budget > 0) {
            ++missing;
            EXPECT_GT(pixel.bound_alpha, truth.bound_alpha) << "pixel " << i << " misses nothing";
        } else {
            complete += truth.alpha > 0;
            EXPECT_EQ(why.level, 0) << "pixel " << i;
            EXPECT_NEAR(double(pixel.alpha), double(truth.alpha), 4e-6) << "pixel " << i;
        }
    }
    EXPECT_GT(missing, 10u);
    EXPECT_GT(complete, 10u) << "the test sees no complete pixel";
}

TEST_F(Explanations, ABrickThatCannotBeReadIsSeenWhereItIsMissed) {
    const RenderOutcome whole = draw(request_);
    const auto channel = channelOf(frame());
    ASSERT_TRUE(channel);
    // A leaf's payload near the middle.
    std::uint64_t offset = 0;
    {
        const auto store = BrickStore::open(frame());
        ASSERT_TRUE(store);
        const auto block = (*store)->loadBlock(0, std::uint32_t(channel->blockCount() - 1));
        ASSERT_TRUE(block);
        std::uint32_t most = 0;
        for (std::uint32_t n = 0; n < block->nodeCount(); ++n)
            if (block->isLeaf(n) && block->record(n).payload_bytes > most)
                most = block->record(n).payload_bytes, offset = block->record(n).payload_offset;
        ASSERT_GT(most, 0u);
    }
    std::string bytes = readFile(frame());
    bytes[offset + 5] = char(bytes[offset + 5] ^ 0x20);
    writeFile(frame(), bytes);

    const RenderOutcome damaged = draw(request_);
    EXPECT_FALSE(damaged.final);
    EXPECT_EQ(damaged.not_final.failed, 1u);
    std::size_t failed = 0;
    for (std::size_t i = 0; i < damaged.why.size(); ++i) {
        const bool differs = damaged.picture.pixels[i].alpha != whole.picture.pixels[i].alpha;
        failed += damaged.why[i].failed > 0;
        EXPECT_EQ(damaged.why[i].queued + damaged.why[i].over_budget, 0);
        const double error =
            std::abs(double(damaged.picture.pixels[i].alpha) - double(whole.picture.pixels[i].alpha));
        EXPECT_LE(error, double(damaged.picture.pixels[i].bound_alpha) + 1e-6);
        if (error > 4e-6) EXPECT_GT(damaged.why[i].failed, 0) << "pixel " << i << " differs: " << differs;
        if (damaged.why[i].failed > 0) EXPECT_GT(damaged.picture.pixels[i].bound_alpha, 4e-6f);
    }
    EXPECT_GT(failed, 0u);
}

}  // namespace
}  // namespace brickyard

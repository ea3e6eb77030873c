#include "client/trace/surface_tracer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "stored_channel.h"

namespace brickyard {
namespace {

using Found = SurfaceTracer::Found;

const glm::dvec3 kCentre(3.3, -1.7, 5.2);
constexpr double kRadius = 18.4;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

// A narrow band: distance to a sphere, cut off at three voxels.
FormulaField levelSet(const std::vector<double>& transform = {}) {
    auto distance = [](std::int64_t x, std::int64_t y, std::int64_t z) {
        const double d = glm::length(glm::dvec3(double(x), double(y), double(z)) - kCentre) - kRadius;
        return float(std::clamp(d, -3.0, 3.0));
    };
    return {{{-25, -30, -25}, {32, 30, 35}}, 3.0f, distance, transform};
}
// The same as a density: 1 inside, falling to 0 over four voxels.
FormulaField softBall() {
    auto density = [](std::int64_t x, std::int64_t y, std::int64_t z) {
        const double d = glm::length(glm::dvec3(double(x), double(y), double(z)) - kCentre) - kRadius;
        return float(std::clamp(0.5 - d / 4, 0.0, 1.0));
    };
    return {{{-25, -30, -25}, {32, 30, 35}}, 0.0f, density};
}

struct RandomRays {
    std::mt19937_64 random;
    explicit RandomRays(unsigned seed) : random(seed) {}
    double uniform(double low, double high) { return std::uniform_real_distribution(low, high)(random); }
    glm::dvec3 direction() {
        for (;;) {
            const glm::dvec3 d(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
            if (const double length = glm::length(d); length > 0.1 && length < 1) return d / length;
        }
    }
    // Through the ball; every other one through a vertex of the lattice, along an axis, a plane or a diagonal
    // of it.
    WorldRay ray(int trial) {
        glm::dvec3 target = kCentre + direction() * uniform(0, kRadius + 1), d = direction();
        if (trial % 2) {
            target = glm::floor(target);
            const glm::dvec3 kinds[] = {{1, 0, 0}, {0, 1, 0},  {0, 0, 1},  {1, 1, 0},  {0, -1, 1}, {1, 0, -1},
                                        {1, 1, 1}, {1, -1, 1}, {-1, 1, 1}, {-1, 0, 0}, {0, 0, -1}, {2, 1, 0}};
            const std::size_t kind = std::size_t(trial / 2) % 13;
            if (kind < 12) d = glm::normalize(kinds[kind]);
            // Borders of bricks and of nodes above them.
            if (trial % 4 == 3) target = 8.0 * glm::round(target / 8.0);
        }
        return {target - 100.0 * d, d};
    }
};

// Everywhere, whatever stands in the way: what a ray crosses closes.
void expectClosed(StoredChannel& stored, const SurfaceTracer& tracer, int trials, double slack) {
    RandomRays rays(1);
    const RayContext context = stored.context();
    int crossed = 0;
    std::vector<SurfaceHit> hits;
    for (int trial = 0; trial < trials; ++trial) {
        const WorldRay world = rays.ray(trial);
        const IndexRay ray(world, stored.channel().transform());
        const Found found = tracer.crossings(ray, {0, kInfinity}, context, SIZE_MAX, hits);
        ASSERT_NE(found, Found::kMissing);
        ASSERT_EQ(found == Found::kHit, !hits.empty());
        ASSERT_EQ(hits.size() % 2, 0u) << "trial " << trial << " of level " << tracer.level();
        for (std::size_t i = 0; i < hits.size(); ++i) {
            ASSERT_EQ(hits[i].entering, i % 2 == 0);
            if (i > 0) {
                ASSERT_GE(hits[i].t, hits[i - 1].t);
            }
            ASSERT_LT(glm::length(ray.origin + hits[i].t * ray.direction - hits[i].index), 1e-9);
            ASSERT_NEAR(glm::length(hits[i].index - kCentre), kRadius,
                        slack + 0.1 + 0.2 * (1 << 2 * tracer.level()));
        }
        const double aside = glm::length(glm::cross(kCentre - world.origin, world.direction));
        // Coarse levels are quantised, so two bricks' faces differ by a little: a wall as high as that may
        // stand where the surface crosses the face.
        if (aside < kRadius - 2 * (1 << tracer.level())) {
            if (slack == 0)
                ASSERT_EQ(hits.size(), 2u) << "trial " << trial;
            else
                ASSERT_TRUE(hits.size() >= 2 && hits.size() <= 6) << "trial " << trial;
        }
        SurfaceHit first;
        ASSERT_EQ(tracer.first(ray, {0, kInfinity}, context, first), found);
        if (!hits.empty()) {
            ASSERT_EQ(first.t, hits[0].t);
            // From within, the same is found.
            const double middle = 0.5 * (hits[0].t + hits[1].t);
            if (hits[1].t - hits[0].t > 0.01) {
                ASSERT_EQ(tracer.first(ray, {middle, kInfinity}, context, first), Found::kHit);
                ASSERT_FALSE(first.entering);
                ASSERT_NEAR(first.t, hits[1].t, 1e-9);
            }
        }
        crossed += !hits.empty();
    }
    EXPECT_GT(crossed, trials / 2);
    EXPECT_TRUE(stored.wants().empty());
}

TEST(SurfaceTracerTest, ALevelSetIsClosedAtEveryLevel) {
    StoredChannel stored(levelSet());
    stored.arriveAll();
    for (int level = 0; level < 3; ++level)
        expectClosed(stored, SurfaceTracer(stored.channel(), 0, /*inside_below=*/true, level), 20000,
                     level == 0 ? 0 : 0.3);
}

TEST(SurfaceTracerTest, ADensityIsClosedAtEveryLevel) {
    StoredChannel stored(softBall());
    stored.arriveAll();
    for (int level = 0; level < 3; ++level)
        expectClosed(stored, SurfaceTracer(stored.channel(), 0.5, /*inside_below=*/false, level), 20000,
                     level == 0 ? 0 : 0.3);
}

// Smooth parts are leaves of coarse levels, and no two bricks agree on the face between them.
TEST(SurfaceTracerTest, ALossyLevelSetIsClosedWhereLeavesOfDifferentLevelsMeet) {
    // Ripples on one side only.
    const FormulaField wide(
        {{-35, -40, -35}, {42, 40, 45}}, 50, [](std::int64_t x, std::int64_t y, std::int64_t z) {
            const glm::dvec3 p = glm::dvec3(double(x), double(y), double(z));
            const glm::dvec3 d = p - kCentre,
                             wave(std::sin(0.9 * p.x), std::sin(0.8 * p.y), std::sin(0.7 * p.z));
            const double ripple = d.x > 0 ? 0.5 * wave.x * wave.y * wave.z : 0;
            return float((glm::dot(d, d) - kRadius * kRadius) / (2 * kRadius) + ripple);
        });
    StoredChannel stored(wide, /*max_error=*/0.2);
    stored.arriveAll();
    for (int level = 0; level < 3; ++level)
        expectClosed(stored, SurfaceTracer(stored.channel(), 0.1, /*inside_below=*/true, level), 20000, 0.8);
    const SurfaceTracer tracer(stored.channel(), 0.1, /*inside_below=*/true, 0);
    RandomRays rays(1);
    std::size_t hits_of[kMaxLevel + 1] = {};
    for (int trial = 0; trial < 2000; ++trial) {
        SurfaceHit hit;
        if (tracer.first(IndexRay(rays.ray(trial), Affine()), {0, kInfinity}, stored.context(), hit) ==
            Found::kHit)
            ++hits_of[hit.key.level];
    }

    EXPECT_GT(hits_of[0], 100u) << "the leaves are all coarse, which tests nothing";
    EXPECT_GT(hits_of[1] + hits_of[2], 100u) << "the leaves are all fine, which tests nothing";
}

// Noise from sample to sample has several crossings in a cell.
TEST(SurfaceTracerTest, FindsEveryCrossingOfNoise) {
    const FormulaField noise({{-9, -9, -9}, {9, 9, 9}}, 0,
                             [](std::int64_t x, std::int64_t y, std::int64_t z) {
                                 std::mt19937 random(unsigned(x * 73856093 ^ y * 19349663 ^ z * 83492791));
                                 return std::uniform_real_distribution(-1.0f, 1.0f)(random);
                             });
    StoredChannel stored(noise);
    stored.arriveAll();
    const SurfaceTracer tracer(stored.channel(), 0.13, false, 0);
    RandomRays rays(2);
    std::vector<SurfaceHit> hits;
    std::size_t found = 0;
    for (int trial = 0; trial < 400; ++trial) {
        const glm::dvec3 direction = rays.direction();
        const glm::dvec3 target(rays.uniform(-8, 8), rays.uniform(-8, 8), rays.uniform(-8, 8));
        const IndexRay ray({target - 50.0 * direction, direction}, Affine());
        tracer.crossings(ray, {0, kInfinity}, stored.context(), SIZE_MAX, hits);
        EXPECT_EQ(hits.size() % 2, 0u);
        found += hits.size();
        for (const SurfaceHit& hit : hits) EXPECT_NEAR(noise.at(hit.index), 0.13, 1e-9);
        // Between two crossings the field is on the side that the first leads to.
        for (std::size_t i = 0; i + 1 < hits.size(); ++i)
            for (double s = 0.0125; s < 1; s += 0.025) {
                const double t = hits[i].t + s * (hits[i + 1].t - hits[i].t);
                const double value = noise.at(ray.origin + t * ray.direction) - 0.13;
                EXPECT_GT(hits[i].entering ? value : -value, -1e-9);
            }
    }
    EXPECT_GT(found, 2000u);
}

TEST(SurfaceTracerTest, StaysExactFarFromTheWorldsOriginAndWithTinyVoxels) {
    const std::vector<std::vector<double>> transforms = {
        {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1e12, -1e12, 5e11, 1},
        {1e-9, 0, 0, 0, 0, 1e-9, 0, 0, 0, 0, 1e-9, 0, 0, 0, 0, 1},
        {1e-9, 0, 0, 0, 0, 2e-9, 0, 0, 5e-10, 0, 1e-9, 0, 1e-3, 0, -1e-3, 1},
        {1e7, 0, 0, 0, 0, 1e7, 0, 0, 0, 0, 1e7, 0, 1e12, 1e12, 1e12, 1},
    };
    for (const std::vector<double>& transform : transforms) {
        const FormulaField field = levelSet(transform);
        StoredChannel stored(field);
        stored.arriveAll();
        const SurfaceTracer tracer(stored.channel(), 0, true, 0);
        const Affine& affine = stored.channel().transform();
        RandomRays rays(3);
        std::vector<SurfaceHit> hits;
        for (int trial = 0; trial < 2000; ++trial) {
            const WorldRay index_ray = rays.ray(trial);
            const glm::dvec3 way = affine.vector(index_ray.direction);
            const WorldRay world{affine.point(index_ray.origin), way / glm::length(way)};
            const IndexRay ray(world, affine);
            tracer.crossings(ray, {0, kInfinity}, stored.context(), SIZE_MAX, hits);
            ASSERT_EQ(hits.size() % 2, 0u);
            for (const SurfaceHit& hit : hits) ASSERT_NEAR(field.at(hit.index), 0, 1e-6);
            const double aside = glm::length(glm::cross(kCentre - index_ray.origin, index_ray.direction));
            if (aside < kRadius - 2) {
                ASSERT_EQ(hits.size(), 2u);
            }
        }
    }
}

TEST(SurfaceTracerTest, WantsOnlyWhatTheRayNeedsAndEndsWithTheSame) {
    StoredChannel whole(levelSet()), stored(levelSet());
    whole.arriveAll();
    RandomRays rays(4);
    for (int level = 0; level < 3; ++level) {
        const SurfaceTracer expected(whole.channel(), 0, true, level),
            tracer(stored.channel(), 0, true, level);
        for (int trial = 0; trial < 40; ++trial) {
            const IndexRay ray(rays.ray(trial), Affine());
            SurfaceHit hit, reference;
            stored.forget();
            int rounds = 0;
            while (tracer.first(ray, {0, kInfinity}, stored.context(), hit) == Found::kMissing) {
                SurfaceHit provisional;
                EXPECT_NE(tracer.firstResident(ray, {0, kInfinity}, stored.context(), provisional),
                          Found::kMissing);
                // One page at a time: the most that can be wrong with the order.
                ASSERT_TRUE(stored.arrive(trial % 2 ? 1 : SIZE_MAX)) << "waits for nothing";
                ASSERT_LT(++rounds, 200);
            }
            EXPECT_TRUE(stored.wants().empty());
            const Found found = expected.first(ray, {0, kInfinity}, whole.context(), reference);
            EXPECT_EQ(found == Found::kHit, hit.t > 0);
            EXPECT_EQ(hit.t, reference.t);
            EXPECT_EQ(hit.index, reference.index);
            EXPECT_FALSE(hit.failed);
            EXPECT_LT(stored.bricks(), 12u) << "of " << whole.bricks();
        }
    }
}

TEST(SurfaceTracerTest, WantsNothingWhereNodesAreOnOneSide) {
    StoredChannel stored(levelSet());
    const SurfaceTracer tracer(stored.channel(), 0, true, 0);
    // Beside the ball, but through its nodes.
    const IndexRay ray({kCentre + glm::dvec3(-100, kRadius + 2.5, 0), {1, 0, 0}}, Affine());
    SurfaceHit hit;
    while (tracer.first(ray, {0, kInfinity}, stored.context(), hit) == Found::kMissing)
        ASSERT_TRUE(stored.arrive());
    EXPECT_LE(stored.bricks(), 4u);
    // No room: what is behind is not looked for.
    stored.forget();
    RayContext context = stored.context();
    context.room = 1;
    const IndexRay through({kCentre - glm::dvec3(100, 0, 0), {1, 0, 0}}, Affine());
    EXPECT_EQ(tracer.first(through, {0, kInfinity}, context, hit), Found::kMissing);
    EXPECT_EQ(stored.wants().size(), 1u);
}

TEST(SurfaceTracerTest, APageThatCannotBeHadIsStoodInForByACoarserOne) {
    StoredChannel stored(levelSet());
    stored.arriveAll();
    const SurfaceTracer tracer(stored.channel(), 0, true, 0);
    const IndexRay ray({kCentre - glm::dvec3(100, 0, 0), {1, 0, 0}}, Affine());
    SurfaceHit hit;
    ASSERT_EQ(tracer.first(ray, {0, kInfinity}, stored.context(), hit), Found::kHit);
    const double t = hit.t;
    EXPECT_EQ(hit.key.level, 0);
    stored.fail({false, {0, hit.node.block, hit.node.node}});
    stored.forget();
    while (tracer.first(ray, {0, kInfinity}, stored.context(), hit) == Found::kMissing)
        ASSERT_TRUE(stored.arrive());
    EXPECT_TRUE(hit.failed);
    EXPECT_EQ(hit.key.level, 1);
    EXPECT_NEAR(hit.t, t, 0.5);
    // What closed before is closed still.
    stored.arriveAll();
    expectClosed(stored, tracer, 4000, 0.3);
    // Not even a root: nothing is there, and nothing is waited for.
    StoredChannel lost(levelSet());
    lost.fail({true, {0, 0, 0}});
    EXPECT_EQ(SurfaceTracer(lost.channel(), 0, true, 0).first(ray, {0, kInfinity}, lost.context(), hit),
              Found::kNothing);
    EXPECT_TRUE(hit.failed);
    EXPECT_TRUE(lost.wants().empty());
}

TEST(SurfaceTracerTest, ResidentBricksStandIn) {
    StoredChannel stored(levelSet());
    const IndexRay ray({kCentre - glm::dvec3(100, 0, 0), {1, 0, 0}}, Affine());
    SurfaceHit hit;
    const SurfaceTracer fine(stored.channel(), 0, true, 0), coarse(stored.channel(), 0, true, 2);
    EXPECT_EQ(fine.firstResident(ray, {0, kInfinity}, stored.context(), hit), Found::kNothing);
    EXPECT_TRUE(stored.wants().empty());
    while (coarse.first(ray, {0, kInfinity}, stored.context(), hit) == Found::kMissing)
        ASSERT_TRUE(stored.arrive());
    const double t = hit.t;
    EXPECT_EQ(fine.firstResident(ray, {0, kInfinity}, stored.context(), hit), Found::kHit);
    EXPECT_EQ(hit.t, t);
    EXPECT_TRUE(hit.failed);
    EXPECT_TRUE(stored.wants().empty());
}

TEST(SurfaceNormalTest, PointsAwayFromABall) {
    const FieldFilter filters[] = {FieldFilter::kTrilinear, FieldFilter::kBSpline, FieldFilter::kCatmullRom,
                                   FieldFilter::kMitchell, FieldFilter::kGaussian};
    // Of the distance, whose gradient is the radius; of a density, which falls outwards.
    for (const bool level_set : {true, false}) {
        StoredChannel stored(level_set ? levelSet() : softBall());
        stored.arriveAll();
        for (int level = 0; level < 2; ++level) {
            const SurfaceTracer tracer(stored.channel(), level_set ? 0 : 0.5, level_set, level);
            RandomRays rays(5);
            for (int trial = 0; trial < 2000; ++trial) {
                const WorldRay world = rays.ray(trial);
                SurfaceHit hit;
                if (tracer.first(IndexRay(world, Affine()), {0, kInfinity}, stored.context(), hit) !=
                    Found::kHit)
                    continue;
                for (FieldFilter filter : filters) {
                    glm::dvec3 normal;
                    // A Gaussian as narrow as this does not keep a plane a plane.
                    const double least = filter == FieldFilter::kGaussian ? 0.98
                                         : level == 0                     ? 0.9999
                                                                          : 0.995;
                    ASSERT_EQ(tracer.normal(hit, world.direction, filter, stored.context(), normal),
                              Found::kHit);
                    EXPECT_NEAR(glm::length(normal), 1, 1e-12);
                    EXPECT_GT(glm::dot(normal, glm::normalize(hit.index - kCentre)), least)
                        << "filter " << int(filter) << " at level " << level;
                }
            }
        }
    }
}

TEST(SurfaceNormalTest, GoesThroughAShearedTransform) {
    const std::vector<double> transform = {2, 0.5, 0, 0, -1, 3, 0.25, 0, 0.5, 0, 0.75, 0, 7, 8, 9, 1};
    StoredChannel stored(levelSet(transform));
    stored.arriveAll();
    const Affine& affine = stored.channel().transform();
    const SurfaceTracer tracer(stored.channel(), 0, true, 0);
    RandomRays rays(6);
    for (int trial = 0; trial < 500; ++trial) {
        const WorldRay index_ray = rays.ray(trial);
        const glm::dvec3 way = affine.vector(index_ray.direction);
        const WorldRay world{affine.point(index_ray.origin), way / glm::length(way)};
        SurfaceHit hit;
        if (tracer.first(IndexRay(world, affine), {0, kInfinity}, stored.context(), hit) != Found::kHit)
            continue;
        glm::dvec3 normal;
        ASSERT_EQ(tracer.normal(hit, world.direction, FieldFilter::kTrilinear, stored.context(), normal),
                  Found::kHit);
        // Perpendicular to what is tangential to the ball in index space.
        const glm::dvec3 radius = glm::normalize(hit.index - kCentre);
        const glm::dvec3 tangent = glm::normalize(glm::cross(radius, rays.direction()));
        EXPECT_NEAR(glm::dot(normal, glm::normalize(affine.vector(tangent))), 0, 0.03);
        EXPECT_GT(glm::dot(normal, affine.vector(radius)), 0);
    }
}

TEST(SurfaceNormalTest, WaitsForTheBricksBeside) {
    StoredChannel whole(levelSet()), stored(levelSet());
    whole.arriveAll();
    const SurfaceTracer expected(whole.channel(), 0, true, 0), tracer(stored.channel(), 0, true, 0);
    RandomRays rays(7);
    int waited = 0;
    for (int trial = 0; trial < 100; ++trial) {
        const WorldRay world = rays.ray(trial);
        const IndexRay ray(world, Affine());
        SurfaceHit hit;
        stored.forget();
        Found found;
        while ((found = tracer.first(ray, {0, kInfinity}, stored.context(), hit)) == Found::kMissing)
            ASSERT_TRUE(stored.arrive());
        if (found == Found::kNothing) continue;
        glm::dvec3 normal, reference;
        int rounds = 0;
        while (tracer.normal(hit, world.direction, FieldFilter::kTrilinear, stored.context(), normal) ==
               Found::kMissing) {
            EXPECT_GT(glm::dot(normal, glm::normalize(hit.index - kCentre)), 0.95) << "no stand-in";
            ASSERT_TRUE(stored.arrive());
            ++waited;
            ASSERT_LT(++rounds, 10);
        }
        ASSERT_EQ(expected.normal(hit, world.direction, FieldFilter::kTrilinear, whole.context(), reference),
                  Found::kHit);
        EXPECT_EQ(normal, reference);
    }
    EXPECT_GT(waited, 0);
}

// A box that jumps: where the gradient vanishes there is still an answer.
TEST(SurfaceNormalTest, IsUnitWhereTheGradientVanishes) {
    const FormulaField plateau({{0, 0, 0}, {24, 24, 24}}, 0, [](std::int64_t x, std::int64_t, std::int64_t) {
        return x % 2 ? 1.0f : 3.0f;
    });
    StoredChannel stored(plateau);
    stored.arriveAll();
    const SurfaceTracer tracer(stored.channel(), 1, false, 0);
    RandomRays rays(8);
    for (int trial = 0; trial < 500; ++trial) {
        const WorldRay world{glm::dvec3(12) - 60.0 * rays.direction(), {0, 0, 0}};
        const WorldRay ray{world.origin, glm::normalize(glm::dvec3(12) - world.origin)};
        SurfaceHit hit;
        ASSERT_EQ(tracer.first(IndexRay(ray, Affine()), {0, kInfinity}, stored.context(), hit), Found::kHit);
        glm::dvec3 normal;
        ASSERT_EQ(tracer.normal(hit, ray.direction, FieldFilter::kTrilinear, stored.context(), normal),
                  Found::kHit);
        EXPECT_NEAR(glm::length(normal), 1, 1e-12);
    }
}

TEST(SurfaceOcclusionTest, ABallShadesItselfFromOneSideOnly) {
    for (int level = 0; level < 2; ++level) {
        StoredChannel stored(levelSet());
        stored.arriveAll();
        const SurfaceTracer tracer(stored.channel(), 0, true, level);
        RandomRays rays(9);
        int shaded = 0, lit = 0, wrong = 0;
        for (int trial = 0; trial < 4000; ++trial) {
            const WorldRay world = rays.ray(trial);
            SurfaceHit hit;
            if (tracer.first(IndexRay(world, Affine()), {0, kInfinity}, stored.context(), hit) != Found::kHit)
                continue;
            const glm::dvec3 radius = glm::normalize(hit.index - kCentre), light = rays.direction();
            const double cosine = glm::dot(radius, light);
            // At the terminator the facets of the cells show.
            if (std::abs(cosine) < 0.1 * (1 << level)) continue;
            const Found found = tracer.occludedFrom(hit, light, kInfinity, stored.context());
            wrong += found != (cosine > 0 ? Found::kNothing : Found::kHit);
            (cosine > 0 ? lit : shaded) += 1;
        }
        // Faces of quantised bricks have little walls.
        EXPECT_LE(wrong, level == 0 ? 0 : (lit + shaded) / 1000);
        EXPECT_GT(lit, 500);
        EXPECT_GT(shaded, 500);
    }
}

TEST(SurfaceOcclusionTest, OpennessOfABallIsWholeAndOfAHollowOneDependsOnTheReach) {
    StoredChannel stored(levelSet());
    stored.arriveAll();
    const SurfaceTracer solid(stored.channel(), 0, true, 0), hollow(stored.channel(), 0, false, 0);
    const glm::dvec3 direction(1, 0, 0);
    SurfaceHit hit;
    SurfaceTracer::Openness open;
    ASSERT_EQ(solid.first(IndexRay({kCentre - 100.0 * direction, direction}, Affine()), {0, kInfinity},
                          stored.context(), hit),
              Found::kHit);
    ASSERT_EQ(solid.openness(hit, -direction, 50, 64, 7, stored.context(), open), Found::kHit);
    EXPECT_GT(open.share, 0.95);
    // From within, whatever is inside of what is above the value: walls all around.
    ASSERT_EQ(hollow.first(IndexRay({kCentre, direction}, Affine()), {0, kInfinity}, stored.context(), hit),
              Found::kHit);
    EXPECT_TRUE(hit.entering);
    ASSERT_EQ(hollow.openness(hit, -direction, 100, 64, 7, stored.context(), open), Found::kHit);
    EXPECT_EQ(open.share, 0);
    ASSERT_EQ(hollow.openness(hit, -direction, 1e-2, 64, 7, stored.context(), open), Found::kHit);
    EXPECT_GT(open.share, 0.9);
    // A chord at the angle a to the normal has length 2 r cos(a); with the cosine as weight, cos(a)^2 is
    // uniform.
    for (double reach : {0.25, 0.5, 0.75}) {
        ASSERT_EQ(hollow.openness(hit, -direction, 2 * kRadius * reach, 1024, 3, stored.context(), open),
                  Found::kHit);
        EXPECT_NEAR(open.share, 1 - reach * reach, 0.03) << reach;
        EXPECT_LT(open.deviation, 0.03);
    }
}

TEST(SurfaceOcclusionTest, SaysWhatItWaitsFor) {
    StoredChannel stored(levelSet());
    const SurfaceTracer hollow(stored.channel(), 0, false, 0);
    SurfaceHit hit;
    const IndexRay ray({kCentre, {1, 0, 0}}, Affine());
    while (hollow.first(ray, {0, kInfinity}, stored.context(), hit) == Found::kMissing)
        ASSERT_TRUE(stored.arrive());
    SurfaceTracer::Openness open;
    int rounds = 0;
    while (hollow.openness(hit, {-1, 0, 0}, 30, 64, 1, stored.context(), open) == Found::kMissing) {
        ASSERT_TRUE(stored.arrive());
        ASSERT_LT(++rounds, 10) << "pages come one by one";
    }
    EXPECT_GT(rounds, 0);
    EXPECT_LT(open.share, 1);
}

}  // namespace
}  // namespace brickyard

#include "client/trace/deep_shadow_map.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>
#include <random>
#include <thread>

namespace brickyard {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

class Random {
public:
    explicit Random(unsigned seed) : random_(seed) {}
    double uniform(double low, double high) { return std::uniform_real_distribution(low, high)(random_); }
    glm::dvec3 direction() {
        for (;;) {
            const glm::dvec3 d(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
            if (const double length = glm::length(d); length > 0.1 && length < 1) return d / length;
        }
    }
    glm::dvec3 in(const WorldBox& box) {
        glm::dvec3 p;
        for (int a = 0; a < 3; ++a) p[a] = uniform(box.low[a], box.high[a]);
        return p;
    }

private:
    std::mt19937_64 random_;
};

// By its definition, not by search.
double transmittanceAt(const std::vector<ShadowVertex>& curve, double distance) {
    double depth = 0;
    for (std::size_t i = 0; i < curve.size() && curve[i].distance < distance; ++i) {
        depth = curve[i].depth;
        if (i + 1 < curve.size() && curve[i + 1].distance >= distance)
            depth += (curve[i + 1].depth - depth) * (distance - curve[i].distance) /
                     (curve[i + 1].distance - curve[i].distance);
    }
    return std::exp(-depth);
}

void expectWithin(const std::vector<ShadowVertex>& curve, double error) {
    const std::vector<ShadowVertex> stored = compressShadow(curve, error);
    // A piece may end within one of the given, so that both take a vertex.
    if (error > 1e-12) {
        ASSERT_LE(stored.size(), 2 * curve.size());
    }
    for (std::size_t i = 0; i + 1 < stored.size(); ++i) {
        ASSERT_LE(stored[i].distance, stored[i + 1].distance);
        ASSERT_LE(stored[i].depth, stored[i + 1].depth);
        ASSERT_TRUE(std::isfinite(stored[i + 1].depth));
    }
    std::vector<double> distances = {curve.front().distance - 1, curve.back().distance + 1};
    for (std::size_t i = 0; i + 1 < curve.size(); ++i)
        for (int k = 0; k < 24; ++k)
            distances.push_back(curve[i].distance + k / 24.0 * (curve[i + 1].distance - curve[i].distance));
    for (const ShadowVertex& v : stored) distances.push_back(std::nextafter(v.distance, kInfinity));
    for (double distance : distances) {
        const double expected =
            std::isfinite(transmittanceAt(curve, distance)) ? transmittanceAt(curve, distance) : 0;
        ASSERT_NEAR(transmittanceOf(stored, distance), expected, error * (1 + 1e-9) + 1e-14)
            << "at " << distance;
    }
}

TEST(CompressShadowTest, KeepsEveryCurveWithinTheError) {
    Random random(1);
    for (int trial = 0; trial < 4000; ++trial) {
        std::vector<ShadowVertex> curve = {
            {random.uniform(-5, 5), trial % 7 == 0 ? random.uniform(0, 2) : 0}};
        const int count = 1 + int(random.uniform(0, 60));
        const double step_scale = std::pow(10, random.uniform(-4, 1.5));
        for (int i = 0; i < count; ++i) {
            ShadowVertex v = curve.back();
            // Stretches, jumps, empty stretches, and very different lengths.
            const double kind = random.uniform(0, 1);
            if (kind > 0.1) v.distance += std::pow(10, random.uniform(-3, 1));
            if (kind < 0.8) v.depth += step_scale * std::pow(random.uniform(0, 1), 4);
            curve.push_back(v);
        }
        expectWithin(curve, std::pow(10, random.uniform(-6, -0.3)));
    }
}

TEST(CompressShadowTest, TakesTwoVerticesForAHomogeneousMedium) {
    for (double depth : {0.1, 1.0, 30.0}) {
        std::vector<ShadowVertex> curve;
        for (int i = 0; i <= 1000; ++i) curve.push_back({3 + 0.01 * i, depth * i / 1000});
        EXPECT_EQ(compressShadow(curve, 1e-3).size(), 2u) << depth;
        expectWithin(curve, 1e-3);
    }
    EXPECT_TRUE(compressShadow(std::vector<ShadowVertex>{{1, 0}, {2, 0}, {5, 0}}, 1e-3).empty());
    EXPECT_TRUE(compressShadow({}, 1e-3).empty());
    EXPECT_TRUE(compressShadow(std::vector<ShadowVertex>{{1, 0}, {2, 1e-4}, {5, 5e-4}}, 1e-3).empty());
}

TEST(CompressShadowTest, KeepsOpaqueSurfacesWhereTheyAre) {
    for (const std::vector<ShadowVertex>& curve : {std::vector<ShadowVertex>{{2, 0}, {2, kInfinity}},
                                                   {{0, 0}, {2, 1}, {2, kInfinity}, {3, kInfinity}},
                                                   {{2, kInfinity}},
                                                   {{0, 0}, {2, 0}, {2, 900}, {4, 1e9}}}) {
        const std::vector<ShadowVertex> stored = compressShadow(curve, 0.01);
        EXPECT_NEAR(transmittanceOf(stored, 2), transmittanceAt(curve, 2), 0.01);
        EXPECT_LE(transmittanceOf(stored, std::nextafter(2.0, 3.0)), 0.01);
        EXPECT_LE(stored.size(), 3u);
    }
    // Tolerances below rounding end, too.
    std::vector<ShadowVertex> steep;
    for (int i = 0; i < 100; ++i) steep.push_back({0.1 * i, 0.37 * i});
    expectWithin(steep, 1e-30);
}

TEST(CompressShadowTest, NoiseTakesFewVertices) {
    Random random(2);
    std::size_t given = 0, stored = 0;
    for (int trial = 0; trial < 200; ++trial) {
        std::vector<ShadowVertex> curve = {{0, 0}};
        for (int i = 1; i <= 300; ++i)
            curve.push_back({double(i), curve.back().depth + 0.02 * random.uniform(0, 1)});
        given += curve.size();
        stored += compressShadow(curve, 5e-3).size();
    }
    EXPECT_LT(stored * 8, given);
}

struct Case {
    const char* name;
    LightProjection projection;
};
const WorldBox kBox{{-2, 1, 3}, {4, 9, 6}};
std::vector<Case> projections(std::uint32_t edge, const WorldBox& box = kBox) {
    const glm::dvec3 middle = 0.5 * (box.low + box.high), size = box.high - box.low;
    const glm::dvec3 slanted = glm::normalize(glm::dvec3(0.3, 0.8, -0.5));
    return {
        {"along an axis", LightProjection::directional({0, 1, 0}, box, edge)},
        {"slanted", LightProjection::directional(slanted, box, edge)},
        {"point outside", LightProjection::point(middle + size * glm::dvec3(2, 1, -0.7), box, edge)},
        {"point far outside", LightProjection::point(middle + size * glm::dvec3(200, 10, -7), box, edge)},
        {"point above a face", LightProjection::point(middle + size * glm::dvec3(0.1, 0.6, 0), box, edge)},
        {"point inside", LightProjection::point(middle + size * glm::dvec3(0.2, -0.1, 0.3), box, edge)},
        {"spot on the box",
         LightProjection::spot(middle + 2.0 * slanted * glm::length(size), slanted, 0.8, box, edge)},
        {"spot on a part",
         LightProjection::spot(middle + slanted * glm::length(size), slanted, 0.99, box, edge)},
        {"spot inside", LightProjection::spot(middle, slanted, 0.8, box, edge)},
        {"wide spot", LightProjection::spot(middle + slanted * glm::length(size), slanted, 0.1, box, edge)},
    };
}

TEST(LightProjectionTest, FindsEveryPixelWhereItsRayIs) {
    Random random(3);
    const WorldBox boxes[] = {
        kBox,
        {glm::dvec3(1e12, -1e12, 1e12), glm::dvec3(1e12 + 3e4, -1e12 + 2e4, 1e12 + 5e4)},
        {glm::dvec3(-2e-9, 1e-9, 0), glm::dvec3(1e-9, 3e-9, 4e-9)}};
    for (const WorldBox& box : boxes)
        for (const Case& c : projections(33, box)) {
            ASSERT_GT(c.projection.pixelCount(), 33u) << c.name;
            for (int trial = 0; trial < 500; ++trial) {
                const auto pixel = std::uint32_t(random.uniform(0, c.projection.pixelCount()));
                const WorldRay ray = c.projection.ray(pixel);
                if (c.projection.span(pixel).empty()) continue;
                EXPECT_NEAR(glm::length(ray.direction), 1, 1e-14);
                const double distance =
                    random.uniform(c.projection.nearest(), c.projection.farthest()) + 1e-30;
                const LightProjection::Place place =
                    c.projection.place(ray.origin + distance * ray.direction);
                ASSERT_TRUE(place.covered) << c.name;
                EXPECT_NEAR(place.distance, distance, 1e-7 * c.projection.farthest());
                // Faces share the rays of their edges: it may be another pixel with the same ray.
                double weight = 0;
                for (std::size_t i = 0; i < 4; ++i)
                    if (glm::length(c.projection.ray(place.pixel[i]).direction - ray.direction) < 1e-9 &&
                        glm::length(c.projection.ray(place.pixel[i]).origin - ray.origin) <
                            1e-3 * c.projection.farthest() / 33)
                        weight += place.weight[i];
                EXPECT_NEAR(weight, 1, 1e-3) << c.name;
            }
        }
}

TEST(LightProjectionTest, CoversTheBoxAndLittleElse) {
    Random random(4);
    for (const Case& c : projections(65)) {
        std::uint32_t in_box = 0;
        for (std::uint32_t pixel = 0; pixel < c.projection.pixelCount(); ++pixel) {
            const RaySpan span = c.projection.span(pixel);
            in_box += !span.empty();
            if (span.empty()) continue;
            EXPECT_GE(span.begin, c.projection.nearest() - 1e-9);
            EXPECT_LE(span.end, c.projection.farthest() + 1e-9);
            const WorldRay ray = c.projection.ray(pixel);
            const glm::dvec3 middle = ray.origin + 0.5 * (span.begin + span.end) * ray.direction;
            for (int a = 0; a < 3; ++a) {
                EXPECT_GE(middle[a], kBox.low[a] - 1e-9);
                EXPECT_LE(middle[a], kBox.high[a] + 1e-9);
            }
        }
        EXPECT_GT(in_box * 100, c.projection.pixelCount() * 40) << c.name;
        if (std::string(c.name) == "spot on a part" || std::string(c.name) == "spot inside") continue;
        for (int trial = 0; trial < 2000; ++trial) {
            const glm::dvec3 p = random.in(kBox);
            const LightProjection::Place place = c.projection.place(p);
            ASSERT_TRUE(place.covered) << c.name;
            // The four rays are around the point.
            glm::dvec3 mean(0);
            for (std::size_t i = 0; i < 4; ++i) {
                const WorldRay ray = c.projection.ray(place.pixel[i]);
                mean += place.weight[i] * (ray.origin + place.distance * ray.direction);
            }
            ASSERT_LT(glm::length(mean - p), 0.01 * glm::length(kBox.high - kBox.low)) << c.name;
        }
    }
}

// exp(-extinction * what of the way from the light is in the box).
struct Homogeneous {
    double extinction = 0.3;
    std::vector<ShadowVertex> curve(const RaySpan& span) const {
        return {{span.begin, 0}, {span.end, extinction * (span.end - span.begin)}};
    }
    void fill(DeepShadowMap& map) const {
        for (std::uint32_t pixel = 0; pixel < map.projection().pixelCount(); ++pixel)
            if (const RaySpan span = map.projection().span(pixel); !span.empty()) map.set(pixel, curve(span));
        map.calibrate();
    }
};

// exp(-r^2 / 2) about the middle of the box: depths are error functions.
double blobDepth(const WorldRay& ray, double distance) {
    const glm::dvec3 to_middle = 0.5 * (kBox.low + kBox.high) - ray.origin;
    const double nearest = glm::dot(to_middle, ray.direction);
    const double aside = glm::length(to_middle - nearest * ray.direction);
    return std::exp(-0.5 * aside * aside) * std::sqrt(std::numbers::pi / 2) *
           (std::erf((distance - nearest) / std::numbers::sqrt2) + std::erf(nearest / std::numbers::sqrt2));
}

TEST(DeepShadowMapTest, GivesTheClosedFormOfAGaussianBlob) {
    Random random(5);
    for (const Case& c : projections(65)) {
        DeepShadowMap map(c.projection, 1e-3);
        for (std::uint32_t pixel = 0; pixel < c.projection.pixelCount(); ++pixel) {
            std::vector<ShadowVertex> curve;
            const WorldRay ray = c.projection.ray(pixel);
            for (int i = 0; i <= 400; ++i) {
                const double distance =
                    c.projection.nearest() + i / 400.0 * (c.projection.farthest() - c.projection.nearest());
                curve.push_back({distance, blobDepth(ray, distance)});
            }
            map.set(pixel, curve);
        }
        map.calibrate();
        double squares = 0, variances = 0;
        int beyond = 0, count = 0;
        for (int trial = 0; trial < 3000; ++trial) {
            const glm::dvec3 p = random.in(kBox);
            const LightProjection::Place place = c.projection.place(p);
            if (!place.covered) continue;
            // A ray to the point itself.
            WorldRay ray = c.projection.ray(0);
            if (std::string(c.name) == "along an axis" || std::string(c.name) == "slanted")
                ray.origin = p - place.distance * ray.direction;
            else
                ray.direction = glm::normalize(p - ray.origin);
            double deviation = 0;
            const double error =
                map.transmittance(p, &deviation) - std::exp(-blobDepth(ray, glm::length(p - ray.origin)));
            ASSERT_LT(std::abs(error), 0.02) << c.name;
            squares += error * error;
            variances += deviation * deviation;
            ++count;
            beyond += std::abs(error) > 3 * deviation;
        }
        ASSERT_GT(count, 20) << c.name;
        EXPECT_LT(std::sqrt(squares / count), 2e-3) << c.name;
        EXPECT_LT(std::sqrt(variances / count), 1e-2) << c.name;
        EXPECT_LT(beyond, 0.003 * count + 1) << c.name;
    }
}

TEST(DeepShadowMapTest, GivesTheClosedFormOfAHomogeneousMedium) {
    const Homogeneous medium;
    // Along an axis there is nothing to interpolate.
    DeepShadowMap map(LightProjection::directional({0, 1, 0}, kBox, 9), 1e-3);
    medium.fill(map);
    EXPECT_NEAR(map.transmittance({1, 3, 4.5}), std::exp(-0.3 * 6), 1e-3);
    EXPECT_EQ(map.transmittance({1, 9.5, 4.5}), 1) << "in front of it";
    EXPECT_NEAR(map.transmittance({1, -7, 4.5}), std::exp(-0.3 * 8), 1e-3) << "behind it";
    EXPECT_EQ(map.transmittance({9, 3, 4.5}), 1) << "beside it";
}

TEST(DeepShadowMapTest, LightIsWholeAtTheLightAndBehindASpot) {
    const Homogeneous medium;
    const glm::dvec3 middle = 0.5 * (kBox.low + kBox.high);
    DeepShadowMap point(LightProjection::point(middle, kBox, 17), 1e-3);
    medium.fill(point);
    EXPECT_EQ(point.projection().faces().size(), 6u);
    double deviation = -1;
    EXPECT_EQ(point.transmittance(middle, &deviation), 1);
    EXPECT_EQ(deviation, 0);
    EXPECT_NEAR(point.transmittance(middle + glm::dvec3(1e-9, 0, 0)), 1, 1e-3);
    Random random(6);
    for (int trial = 0; trial < 1000; ++trial) {
        // Continuous from face to face, and right on all of them.
        const glm::dvec3 p = middle + random.direction();
        EXPECT_NEAR(point.transmittance(p), std::exp(-0.3), 1e-3);
    }
    DeepShadowMap spot(LightProjection::spot(middle, {0, 1, 0}, 0.9, kBox, 17), 1e-3);
    medium.fill(spot);
    EXPECT_EQ(spot.transmittance(middle + glm::dvec3(0, 2, 0)), 1) << "behind";
    EXPECT_EQ(spot.transmittance(middle), 1);
    EXPECT_EQ(spot.transmittance(middle + glm::dvec3(2, -0.1, 0)), 1) << "outside the cone";
    EXPECT_NEAR(spot.transmittance(middle - glm::dvec3(0, 2, 0)), std::exp(-0.6), 1e-3);
    // Turned away from the box.
    const DeepShadowMap away(LightProjection::spot(middle + glm::dvec3(0, 20, 0), {0, -1, 0}, 0.9, kBox, 17),
                             1e-3);
    EXPECT_EQ(away.projection().pixelCount(), 0u);
    EXPECT_EQ(away.transmittance(middle), 1);
}

// Noise in layers along the ray, a medium that a pixel's curve has hundreds of vertices for.
std::vector<ShadowVertex> noisyCurve(std::uint32_t pixel, const RaySpan& span, double per_vertex) {
    std::mt19937 random(pixel + 1);
    std::vector<ShadowVertex> curve = {{span.begin, 0}};
    for (int i = 1; i <= 256; ++i)
        curve.push_back({span.begin + (span.end - span.begin) * i / 256,
                         curve.back().depth + per_vertex * std::uniform_real_distribution(0.0, 1.0)(random)});
    return curve;
}

TEST(DeepShadowMapTest, TakesMuchLessMemoryThanTheCurvesAndKeepsThemWithinTheError) {
    DeepShadowMap map(LightProjection::directional(glm::normalize(glm::dvec3(1, 2, 3)), kBox, 48), 5e-3);
    const LightProjection& projection = map.projection();
    for (std::uint32_t pixel = 0; pixel < projection.pixelCount(); ++pixel)
        if (const RaySpan span = projection.span(pixel); !span.empty())
            map.set(pixel, noisyCurve(pixel, span, 0.02));
    EXPECT_GT(map.givenVertices(), 200000u);
    EXPECT_LT(map.storedVertices() * 6, map.givenVertices());
    EXPECT_LT(map.bytes() * 8, map.givenVertices() * sizeof(ShadowVertex));
    Random random(7);
    for (std::uint32_t pixel = 0; pixel < projection.pixelCount(); ++pixel) {
        const RaySpan span = projection.span(pixel);
        // Where a ray only touches the box, rounding decides.
        if (span.end - span.begin < 1e-6) continue;
        const std::vector<ShadowVertex> curve = noisyCurve(pixel, span, 0.02);
        const WorldRay ray = projection.ray(pixel);
        for (int k = 0; k < 10; ++k) {
            const double distance = random.uniform(span.begin, span.end);
            // At a pixel's own ray, but for rounding, its neighbours have no part.
            EXPECT_NEAR(map.transmittance(ray.origin + distance * ray.direction),
                        transmittanceAt(curve, distance), 5e-3 + 1e-6);
        }
    }
}

// Half of the light stands before an opaque wall with a slanted edge.
TEST(DeepShadowMapTest, DeviationsHoldAtEdgesAndAreSmallInSmoothMedia) {
    auto filled = [](bool edge) {
        auto map = std::make_unique<DeepShadowMap>(LightProjection::directional({0, 0, 1}, kBox, 65), 1e-3);
        for (std::uint32_t pixel = 0; pixel < map->projection().pixelCount(); ++pixel) {
            const RaySpan span{0, 3};
            const glm::dvec3 p = map->projection().ray(pixel).origin;
            const double depth =
                edge ? (p.x + 0.37 * p.y > 2.8 ? kInfinity : 0) : 1 + std::sin(p.x + 0.5 * p.y);
            map->set(pixel, std::vector<ShadowVertex>{{0, 0}, {span.end, depth}});
        }
        map->calibrate();
        return map;
    };
    Random random(8);
    for (const bool edge : {true, false}) {
        const auto map = filled(edge);
        double squares = 0, variances = 0;
        int beyond = 0;
        for (int trial = 0; trial < 20000; ++trial) {
            glm::dvec3 p = random.in(kBox);
            p.z = kBox.low.z - 1;
            const double depth =
                edge ? (p.x + 0.37 * p.y > 2.8 ? kInfinity : 0) : 1 + std::sin(p.x + 0.5 * p.y);
            double deviation = 0;
            const double error = map->transmittance(p, &deviation) - std::exp(-depth);
            squares += error * error;
            variances += deviation * deviation;
            beyond += std::abs(error) > 3 * deviation;
        }
        EXPECT_LT(beyond, 60) << edge;
        EXPECT_GT(variances, 0.7 * squares) << edge;
        // Edges: not more than is needed; smooth: near the compression's.
        if (edge) {
            EXPECT_LT(variances, 3 * squares);
        }
        if (!edge) {
            EXPECT_LT(std::sqrt(variances / 20000), 2e-3);
        }
    }
}

TEST(DeepShadowMapTest, ThreadsFillDifferentPixels) {
    const LightProjection projection = LightProjection::point({1, 5, 4}, kBox, 24);
    DeepShadowMap alone(projection, 1e-3), together(projection, 1e-3);
    auto fill = [&](DeepShadowMap& map, std::uint32_t first, std::uint32_t step) {
        for (std::uint32_t pixel = first; pixel < projection.pixelCount(); pixel += step)
            map.set(pixel, noisyCurve(pixel, projection.span(pixel), 0.01));
    };
    fill(alone, 0, 1);
    std::vector<std::thread> threads;
    for (std::uint32_t i = 0; i < 4; ++i) threads.emplace_back([&, i] { fill(together, i, 4); });
    for (std::thread& thread : threads) thread.join();
    EXPECT_EQ(alone.storedVertices(), together.storedVertices());
    EXPECT_EQ(alone.givenVertices(), together.givenVertices());
    Random random(9);
    for (int trial = 0; trial < 1000; ++trial) {
        const glm::dvec3 p = random.in(kBox);
        EXPECT_EQ(alone.transmittance(p), together.transmittance(p));
    }
}

}  // namespace
}  // namespace brickyard

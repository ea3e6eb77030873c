#include "tools/bake/exact_light.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <vector>

namespace brickyard {

namespace {

// Points that one thread takes at a time.
constexpr std::size_t kPiece = 256;

// A light far away, and its share of the whole.
struct Distant {
    glm::dvec3 to_light{0};
    double share = 1;
};

std::vector<Distant> distantLights(const WorldLight& light) {
    if (light.kind != WorldLight::Kind::kEnvironment) return {{light.to_light, 1}};
    std::vector<Distant> all;
    double power = 0;
    for (const auto& part : light.environment->distantLights(std::max(1u, light.samples))) {
        all.push_back({part.to_light, part.irradiance.x + part.irradiance.y + part.irradiance.z});
        power += all.back().share;
    }
    // A black sky has no power to share.
    for (Distant& one : all) one.share = power > 0 ? one.share / power : 1 / double(all.size());
    return all;
}

double throughTo(const glm::dvec3& position, const MediumDepth& depth, const glm::dvec3& point) {
    const glm::dvec3 way = position - point;
    const double length = glm::length(way);
    if (!(length > 0)) return 1;
    return std::exp(-depth.along({point, way / length}, length));
}

}  // namespace

LightSampler exactLight(const WorldLight& light, const MediumDepth& depth, ParallelFor parallel_for) {
    const bool near = light.kind == WorldLight::Kind::kPoint || light.kind == WorldLight::Kind::kSpot;
    const std::vector<Distant> distant = near ? std::vector<Distant>() : distantLights(light);
    const auto through = [&depth, near, distant, position = light.position](const glm::dvec3& point) {
        if (near) return throughTo(position, depth, point);
        double lit = 0;
        for (const Distant& one : distant)
            lit += one.share *
                   std::exp(-depth.along({point, one.to_light}, std::numeric_limits<double>::infinity()));
        return lit;
    };
    return [through, parallel_for](std::span<const glm::dvec3> points,
                                   std::span<float> transmittance) -> Result<void> {
        parallel_for((points.size() + kPiece - 1) / kPiece, [&](std::size_t piece) {
            const std::size_t end = std::min(points.size(), (piece + 1) * kPiece);
            for (std::size_t i = piece * kPiece; i < end; ++i)
                transmittance[i] = float(std::clamp(through(points[i]), 0.0, 1.0));
        });
        return {};
    };
}

}  // namespace brickyard

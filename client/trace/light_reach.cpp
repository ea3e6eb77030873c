#include "client/trace/light_reach.h"

#include <cmath>

namespace brickyard {

namespace {

// Transmittances below exp(-24) count as none.
constexpr double kDark = 24;
// What interpolation between baked voxels is off by, as a part of their spread: one standard deviation.
constexpr double kBakedSpread = 0.1;

}  // namespace

LightArrival arrivalAt(const WorldLight& light, const glm::dvec3& point) {
    if (light.kind == WorldLight::Kind::kDirectional)
        return {light.to_light, std::numeric_limits<double>::infinity(), light.power};
    const glm::dvec3 way = light.position - point;
    const double distance = glm::length(way);
    if (!(distance > 0)) return {glm::dvec3(0, 1, 0), 0, glm::dvec3(0)};
    LightArrival arrival{way / distance, distance, light.power / (distance * distance)};
    if (light.kind == WorldLight::Kind::kSpot) {
        const double cosine = glm::dot(arrival.to_light, light.to_light);
        const double width = light.cos_inner - light.cos_outer;
        double share = width > 0 ? (cosine - light.cos_outer) / width : double(cosine >= light.cos_outer);
        share = std::clamp(share, 0.0, 1.0);
        arrival.irradiance *= share * share * (3 - 2 * share);
    }
    return arrival;
}

Reach LightReach::along(const WorldRay& ray, double distance, double lod, double time) {
    double open = 1;
    if (surfaces_) open = surfaces_->openness(ray, {0, distance});
    if (open == 0) return {0, 0};
    double variance = 0;
    const double depth = opticalDepth(reader_, ray, {0, distance}, lod, time, kDark, &variance);
    const double transmittance = open * std::exp(-depth);
    return {transmittance, transmittance * std::sqrt(variance)};
}

Reach LightReach::of(std::size_t index, const LightArrival& arrival, const glm::dvec3& point, double lod,
                     double time) {
    const TracedLight& light = reader_.world.lights[index];
    switch (light.shadows) {
        case ShadowMethod::kNone: return {};
        case ShadowMethod::kBaked:
            if (light.baked < reader_.baked.size() && reader_.baked[light.baked]) {
                ChannelReader& channel = *reader_.baked[light.baked];
                const PagedChannel& baked = channel.channel();
                const glm::dvec3 at = baked.transform().inversePoint(point);
                const double stored = std::sqrt(channel.squareAt(at, lod) / channel.cellEdgeAt(at, lod));
                return {std::clamp(channel.value(at, lod), 0.0, 1.0),
                        std::hypot(stored, kBakedSpread * channel.spreadAt(at, lod))};
            }
            break;
        case ShadowMethod::kDeepMap:
            if (maps_)
                if (const std::optional<Reach> reach = maps_->at(index, point)) return *reach;
            break;
        case ShadowMethod::kAuto:
        case ShadowMethod::kExact: break;
    }
    return along({point, arrival.to_light}, arrival.distance, lod, time);
}

}  // namespace brickyard

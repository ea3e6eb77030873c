#include "client/trace/ray_march.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <span>

namespace brickyard {

namespace {

constexpr std::uint32_t kAmbientRays = 16;
// Of a gradient-shaded medium or a surface without lights, what faces the eye edge-on keeps.
constexpr double kHeadlightAmbient = 0.25;

// Cells along a ray over which the light of an environment is taken for the same.
constexpr double kMemoCells = 2;
// What a surface of a coarse level may look different by, as a part of what it shows.
constexpr double kCoarseSurface = 0.3;
// Distant lights of one power stand for an environment: their mean is off by this part of what a random
// choice of as many would be.
constexpr double kEvenDirections = 0.5;

double greatest(const glm::dvec3& v) { return std::max({v.x, v.y, v.z}); }
double square(double x) { return x * x; }

// (1 - exp(-x)) / x
double meanTransmittance(double depth) {
    return depth < 1e-6 ? 1 - 0.5 * depth : -std::expm1(-depth) / depth;
}

}  // namespace

struct LightMemo {
    double t = -std::numeric_limits<double>::infinity();
    glm::dvec3 radiance{0};
    double variance = 0;
};

struct RayMarch::Ray {
    WorldRay ray;
    double time = 0;
    double transmittance = 1;
    double depth_variance = 0;  // of the optical depth so far
    glm::dvec3 last_source{0};
    double opaque = 0;      // below this transmittance the ray ends
    double negligible = 0;  // a stretch that takes less of the light than this may be lit carelessly
    std::vector<LightMemo> memos;
    std::vector<MarchStep>* steps = nullptr;
    RaySample out;
};

// In-scattered radiance, of an albedo of 1, of the lights that are parts of environments or of the others.
glm::dvec3 RayMarch::scattered(std::size_t m, bool of_environment, const glm::dvec3& point,
                               const glm::dvec3& direction, double lod, double time, double& variance) {
    const MediumSettings& settings = *reader_.world.media[m].settings;
    glm::dvec3 sum(0);
    double squares = 0, total = 0, count = 0, deviations = 0;
    for (std::size_t l = 0; l < reader_.world.lights.size(); ++l) {
        const TracedLight& light = reader_.world.lights[l];
        if (light.of_environment != of_environment) continue;
        const LightArrival arrival = arrivalAt(light.light, point);
        if (greatest(arrival.irradiance) == 0) continue;
        const Reach reach = lights_.of(l, arrival, point, lod, time);
        // Light goes -to_light before, and -direction (to the eye) after.
        const double phase = settings.phase(glm::dot(arrival.to_light, direction));
        const glm::dvec3 part = reach.transmittance * phase * arrival.irradiance;
        sum += part;
        squares += square(greatest(part));
        total += greatest(part);
        ++count;
        const double deviation = reach.deviation * phase * greatest(arrival.irradiance);
        deviations += deviation;
        if (!of_environment) variance += square(deviation);
    }
    // Maps of one environment are coarse in the same way: their errors go together.
    if (of_environment && count > 0)
        variance +=
            square(deviations) + square(kEvenDirections) * std::max(0.0, squares - total * total / count);
    return sum;
}

// The same of all lights, where it matters: an environment changes little from cell to cell, and a stretch
// that hardly scatters takes what the one before had. A reference takes no such shortcut.
glm::dvec3 RayMarch::lit(Ray& ray, std::size_t m, RaySpan span, const glm::dvec3& point, double weight,
                         double cell, double lod, double& variance) {
    const TracedWorld& world = reader_.world;
    glm::dvec3 sum(0);
    const double middle = 0.5 * (span.begin + span.end);
    for (const bool of_environment : {false, true}) {
        if (of_environment && !world.has_environment) continue;
        LightMemo& memo = ray.memos[2 * m + of_environment];
        const double away = middle - memo.t;
        const bool near = of_environment ? away < kMemoCells * cell : weight < ray.negligible && away < cell;
        if (world.quality.reference || !near) {
            memo.t = middle;
            memo.variance = 0;
            memo.radiance =
                scattered(m, of_environment, point, ray.ray.direction, lod, ray.time, memo.variance);
        }
        sum += memo.radiance;
        variance += memo.variance;
    }
    return sum;
}

// Factor of a transfer function's colour.
double RayMarch::shading(std::size_t m, const glm::dvec3& point, const glm::dvec3& direction, double lod,
                         double time, glm::dvec3& light) {
    const double amount = reader_.world.media[m].settings->transfer_shading;
    light = glm::dvec3(1);
    if (!(amount > 0)) return 0;
    const glm::dvec3 slope = reader_.media[m].gradient(point, lod, time);
    const double length = glm::length(slope);
    if (!(length > 0)) return amount;
    const glm::dvec3 normal = slope / length;
    if (reader_.world.lights.empty()) {
        light =
            glm::dvec3(kHeadlightAmbient + (1 - kHeadlightAmbient) * std::abs(glm::dot(normal, direction)));
        return amount;
    }
    // Towards the eye, so that a shell is lit on the side that is seen.
    const glm::dvec3 facing = glm::dot(normal, direction) > 0 ? -normal : normal;
    glm::dvec3 sum(0);
    for (std::size_t l = 0; l < reader_.world.lights.size(); ++l) {
        const LightArrival arrival = arrivalAt(reader_.world.lights[l].light, point);
        const double cosine = glm::dot(facing, arrival.to_light);
        if (!(cosine > 0) || greatest(arrival.irradiance) == 0) continue;
        sum += lights_.of(l, arrival, point, lod, time).transmittance * cosine * arrival.irradiance;
    }
    light = sum / std::numbers::pi;
    return amount;
}

// A medium with a transfer function: its optical depth in a stretch, and its radiance as if nothing were in
// front within it. Where much is stopped, the stretch is taken in more pieces, so that an edge lies where it
// lies.
glm::dvec3 RayMarch::transferred(Ray& ray, const MediaWalk& walk, std::size_t m, RaySpan span,
                                 double& depth) {
    constexpr double kMuch = 0.02;
    constexpr std::size_t kDensePieces = 8;
    MediumReader& reader = reader_.media[m];
    const MediumSettings& settings = *reader.medium().settings;
    const double length = span.end - span.begin, lod = walk.lod(m);
    glm::dvec3 source(0);
    double place = 0, stopped_all = 0;
    auto integrate = [&](std::size_t pieces) {
        source = glm::dvec3(0);
        depth = place = stopped_all = 0;
        double through = 1, values[kDensePieces + 1];
        stretchValues(reader, walk, m, span, ray.time, {values, pieces + 1});
        for (std::size_t i = 0; i < pieces; ++i) {
            const TransferFunction::Sample mean = settings.transfer->mean(values[i], values[i + 1]);
            const double part = settings.density_scale * mean.opacity * length / double(pieces);
            const double stopped = -through * std::expm1(-part);
            source += stopped * mean.color;
            place += stopped * (double(i) + 0.5) / double(pieces);
            stopped_all += stopped;
            through -= stopped;
            depth += part;
        }
    };
    integrate(2);
    if (!(stopped_all > 0)) return source;
    const double taken = ray.transmittance * stopped_all;
    if (taken > kMuch) integrate(kDensePieces);
    if (settings.transfer_shading > 0) {
        LightMemo& memo = ray.memos[2 * m];
        if (taken > ray.negligible || memo.t < 0) {
            memo.t = span.begin + length * place / stopped_all;
            glm::dvec3 light;
            const double amount = shading(m, walk.at(memo.t), ray.ray.direction, lod, ray.time, light);
            memo.radiance = (1 - amount) + amount * light;
        }
        source *= memo.radiance;
    }
    return source / meanTransmittance(depth);
}

void RayMarch::stretch(Ray& ray, const MediaWalk& walk, RaySpan span) {
    const double length = span.end - span.begin;
    const double time = ray.time;
    double depth = 0, variance = 0, light_variance = 0;
    // Radiance of the stretch if nothing were in front of it within it: what grows with the depth, and what
    // glows by itself.
    glm::dvec3 source(0), glow(0), spread(0);
    const glm::dvec3 at[2] = {walk.at(span.begin + kGaussPoint * length),
                              walk.at(span.end - kGaussPoint * length)};
    const glm::dvec3 middle = walk.at(0.5 * (span.begin + span.end));
    for (std::size_t m = 0; m < walk.mediumCount(); ++m) {
        if (!walk.active(m)) continue;
        MediumReader& reader = reader_.media[m];
        const MediumSettings& settings = *reader.medium().settings;
        const double lod = walk.lod(m);
        if (walk.majorant(m).extinction > 0) {
            double own = 0;
            if (settings.transfer) {
                source += transferred(ray, walk, m, span, own);
            } else {
                own = stretchDepth(reader, walk, m, span, time);
                if (own > 0 && !ray.steps && !reader_.world.lights.empty()) {
                    const glm::dvec3 albedo = reader.albedo(middle, lod, time);
                    if (greatest(albedo) > 0) {
                        double deviation = 0;
                        const double cell = reader.cellEdge(middle, lod) * walk.indexRay(m).unitLength();
                        source += own * albedo *
                                  lit(ray, m, span, middle, ray.transmittance * std::min(1.0, own), cell, lod,
                                      deviation);
                        light_variance += own * own * deviation;
                    }
                }
            }
            if (own > 0)
                variance += length * reader.depthVariance(middle, lod, walk.indexRay(m).unitLength());
            depth += own;
        }
        if (walk.majorant(m).emission > 0) {
            const glm::dvec3 a = reader.emission(at[0], lod, time), b = reader.emission(at[1], lod, time);
            glow += 0.5 * length * (a + b);
            spread += 0.5 * length * glm::abs(a - b);
        }
    }
    if (ray.steps && depth > 0)
        ray.steps->push_back({span, ray.transmittance, depth, -std::expm1(-depth), false, {}});
    const double weight = ray.transmittance * meanTransmittance(depth);
    ray.out.radiance += weight * (source + glow);
    // What the levels of detail may change of what lies in front, and in here; and what the midpoint of a
    // light that changes within the stretch may be off by.
    const double share = depth > 0 ? 1 : 0;
    const glm::dvec3 per_depth = depth > 0 ? source / depth : glm::dvec3(0);
    ray.out.radiance_variance += share * variance * square(ray.transmittance * greatest(per_depth)) +
                                 ray.transmittance * ray.transmittance *
                                     (light_variance + square(0.05 * greatest(spread)) +
                                      square(0.05 * greatest(glm::abs(per_depth - ray.last_source)) * depth));
    if (depth > 0) ray.last_source = per_depth;
    ray.depth_variance += variance;
    const double before = 1 - ray.transmittance;
    ray.transmittance *= std::exp(-depth);
    if (depth > 0) marks_.push_back({span.begin, span.end, before, 1 - ray.transmittance});
}

void RayMarch::media(Ray& ray, RaySpan span) {
    if (reader_.media.empty()) return;
    MediaWalk walk(reader_, ray.ray, span, ray.time);
    for (RaySpan piece; ray.transmittance > ray.opaque && walk.next(piece);) stretch(ray, walk, piece);
}

glm::dvec3 RayMarch::shade(const PlacedHit& hit, const glm::dvec3& point, const glm::dvec3& direction,
                           const glm::dvec3& normal, double time, std::uint64_t seed) {
    const TracedWorld& world = reader_.world;
    const SurfaceSettings& surface = *world.surfaces[hit.surface].settings;
    const double ambient = surfaces_->ambient(hit, normal, kAmbientRays, seed);
    auto highlight = [&](const glm::dvec3& to_light) {
        const glm::dvec3 half = glm::normalize(to_light - direction);
        return surface.specular * std::pow(std::max(0.0, glm::dot(half, normal)), 60.0);
    };
    if (world.lights.empty()) {
        const double facing = std::abs(glm::dot(normal, direction));
        return ambient * (kHeadlightAmbient + (1 - kHeadlightAmbient) * facing) * surface.color +
               glm::dvec3(highlight(-direction));
    }
    glm::dvec3 sum(0);
    for (std::size_t l = 0; l < world.lights.size(); ++l) {
        const TracedLight& light = world.lights[l];
        const LightArrival arrival = arrivalAt(light.light, point);
        const double cosine = glm::dot(normal, arrival.to_light);
        if (!(cosine > 0) || greatest(arrival.irradiance) == 0) continue;
        // By a ray: a map is too coarse to tell a surface from what it hides.
        const double reach =
            light.shadows == ShadowMethod::kNone
                ? 1
                : lights_.along({point, arrival.to_light}, arrival.distance, 0, time).transmittance;
        if (reach == 0) continue;
        const double open = light.of_environment ? ambient : 1;
        sum += open * reach * cosine * arrival.irradiance *
               (surface.color / std::numbers::pi + highlight(arrival.to_light));
    }
    return sum;
}

RaySample RayMarch::march(const WorldRay& world_ray, double end, double time, std::uint64_t seed,
                          std::vector<MarchStep>* steps) {
    const TracedWorld& world = reader_.world;
    Ray ray;
    ray.ray = world_ray;
    ray.time = time;
    ray.steps = steps;
    ray.opaque = world.quality.reference ? 1e-9 : std::min(1e-4, 0.02 * world.quality.max_error);
    ray.negligible = world.quality.reference ? 0 : 0.1 * world.quality.max_error;
    ray.memos.assign(2 * world.media.size(), {});
    marks_.clear();
    double from = 0;
    if (surfaces_) {
        const std::vector<PlacedHit> hits = surfaces_->along(world_ray, {0, end});
        for (const PlacedHit& hit : hits) {
            media(ray, {from, hit.hit.t});
            if (!(ray.transmittance > ray.opaque)) break;
            const SurfaceSettings& surface = *world.surfaces[hit.surface].settings;
            if (steps) {
                steps->push_back({{from, hit.hit.t}, ray.transmittance, 0, surface.opacity, true, hit});
            } else {
                const glm::dvec3 point = world_ray.origin + hit.hit.t * world_ray.direction;
                const glm::dvec3 normal = surfaces_->normal(hit, world_ray.direction);
                const glm::dvec3 shown = ray.transmittance * surface.opacity *
                                         shade(hit, point, world_ray.direction, normal, time, seed);
                ray.out.radiance += shown;
                if (world.surfaces[hit.surface].level > 0)
                    ray.out.radiance_variance += square(kCoarseSurface * greatest(shown));
            }
            const double before = 1 - ray.transmittance;
            ray.transmittance *= 1 - surface.opacity;
            marks_.push_back({hit.hit.t, hit.hit.t, before, 1 - ray.transmittance});
            from = hit.hit.t;
        }
    }
    if (ray.transmittance > ray.opaque) media(ray, {from, end});
    // What is behind is not looked at.
    const double cut = ray.transmittance > ray.opaque ? 0 : ray.transmittance;
    ray.transmittance -= cut;

    ray.out.alpha = 1 - ray.transmittance;
    ray.out.alpha_variance = ray.transmittance * ray.transmittance * ray.depth_variance + square(cut);
    ray.out.radiance_variance += square(cut * std::max(1.0, greatest(ray.out.radiance)));
    ray.out.radiance_variance += square(greatest(ray.out.radiance)) * ray.depth_variance * ray.transmittance;
    for (const Mark& mark : marks_)
        if (2 * mark.alpha >= ray.out.alpha && mark.alpha > 0) {
            // In a stretch light dies exponentially.
            const double whole = std::log1p(-mark.alpha_before) - std::log1p(-mark.alpha),
                         half = std::log1p(-mark.alpha_before) - std::log1p(-0.5 * ray.out.alpha);
            const double part = whole > 0 && std::isfinite(whole) ? std::clamp(half / whole, 0.0, 1.0) : 0;
            ray.out.depth = mark.begin + part * (mark.end - mark.begin);
            break;
        }
    // The sky, where the light is to be seen.
    if (end == std::numeric_limits<double>::infinity())
        for (const WorldLight& light : world.settings.lights)
            if (light.visible && light.environment) {
                ray.out.radiance += ray.transmittance * light.environment->backdrop(world_ray.direction);
                ray.out.alpha = 1;
            }
    return ray.out;
}

}  // namespace brickyard

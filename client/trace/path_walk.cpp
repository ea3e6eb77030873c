#include "client/trace/path_walk.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace brickyard {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Bounces before roulette begins.
constexpr std::uint32_t kCertainBounces = 3;
// Tentative collisions per cell of the majorant grid where something glows, at least.
constexpr double kGlowSamples = 10;
// More lights than this are not all sampled at each point, but one of them.
constexpr std::size_t kAllLights = 3;

double greatest(const glm::dvec3& v) { return std::max({v.x, v.y, v.z}); }

// What tracking takes for the extinction of a cell.
double trackedMajorant(const TracedMedium& medium, const MajorantCell& cell) {
    double majorant = double(cell.extinction);
    if (cell.emission > 0)
        majorant =
            std::max(majorant, kGlowSamples / (medium.majorants.cellEdge() * medium.transform().voxelSize()));
    return majorant;
}

double balance(double taken, double other) { return taken > 0 ? taken / (taken + other) : 0; }

}  // namespace

struct PathWalk::Walk {
    Walk(PathRandom& numbers, double moment) : random(numbers), time(moment) {}
    PathRandom& random;
    double time, lod = 0;
    glm::dvec3 weight{1};
    WorldRay ray;
    // Density per steradian with which `ray.direction` was picked.
    double direction_density = 0;
    double light_odds = 1;  // with which a light was picked at the point that `ray` leaves
    // The surface that `ray` leaves, and whether what came to it was about to go inside.
    std::size_t left = SIZE_MAX;
    bool left_entering = true;
    std::uint32_t bounces = 0;
    glm::dvec3 radiance{0};
};

double PathWalk::ratioTrack(Walk& walk, const WorldRay& ray, RaySpan span) {
    double transmittance = 1;
    MediaWalk cells(reader_, ray, span, walk.time, walk.lod, MediaWalk::Steps::kMajorants);
    for (RaySpan cell; cells.next(cell);) {
        double majorant = 0;
        for (std::size_t m = 0; m < cells.mediumCount(); ++m)
            if (cells.active(m)) majorant += double(cells.majorant(m).extinction);
        if (!(majorant > 0)) continue;
        double t = cell.begin;
        for (;;) {
            t -= std::log1p(-walk.random.uniform()) / majorant;
            if (!(t < cell.end)) break;
            double extinction = 0;
            for (std::size_t m = 0; m < cells.mediumCount(); ++m)
                if (cells.active(m) && cells.majorant(m).extinction > 0)
                    extinction += reader_.media[m].extinction(cells.at(t), walk.lod, walk.time);
            transmittance *= 1 - extinction / majorant;
            // Roulette: far into the dark it makes no difference.
            if (std::abs(transmittance) < 0.05) {
                constexpr double kSurvives = 0.25;
                if (walk.random.uniform() >= kSurvives) return 0;
                transmittance /= kSurvives;
            }
        }
    }
    return transmittance;
}

double PathWalk::openTo(Walk& walk, const WorldRay& ray, double distance) {
    if (surfaces_) {
        const double open = surfaces_->openness(ray, {0, distance}, walk.left != SIZE_MAX);
        return open > 0 ? open * ratioTrack(walk, ray, {0, distance}) : 0;
    }
    return ratioTrack(walk, ray, {0, distance});
}

PathWalk::Event PathWalk::fly(Walk& walk, const WorldRay& ray) {
    Event event;
    RaySpan span{0, kInfinity};
    if (surfaces_) {
        // The first that does not let the walk through. A walk that begins on a surface does not meet it
        // again.
        const std::vector<PlacedHit>& hits = surfaces_->along(ray, {0, kInfinity}, walk.left != SIZE_MAX);
        for (const PlacedHit& hit : hits) {
            const SurfaceSettings& surface = *reader_.world.surfaces[hit.surface].settings;
            if (surface.opacity < 1 && walk.random.uniform() >= surface.opacity) continue;
            // Normals are smoother than the surface: a grazing direction may begin on the wrong side of it,
            // and what is opaque keeps what is in there.
            if (surface.opacity >= 1 && hit.surface == walk.left && hit.hit.entering != walk.left_entering)
                return {Event::Kind::kLost, hit.hit.t, 0, hit};
            event = {Event::Kind::kSurface, hit.hit.t, 0, hit};
            span.end = hit.hit.t;
            break;
        }
    }
    MediaWalk cells(reader_, ray, span, walk.time, walk.lod, MediaWalk::Steps::kMajorants);
    for (RaySpan cell; cells.next(cell);) {
        double majorant = 0;
        for (std::size_t m = 0; m < cells.mediumCount(); ++m)
            if (cells.active(m)) majorant += trackedMajorant(reader_.world.media[m], cells.majorant(m));
        if (!(majorant > 0)) continue;
        double t = cell.begin;
        for (;;) {
            t -= std::log1p(-walk.random.uniform()) / majorant;
            if (!(t < cell.end)) break;
            const glm::dvec3 point = cells.at(t);
            double pick = walk.random.uniform() * majorant;
            bool collided = false;
            for (std::size_t m = 0; m < cells.mediumCount() && !collided; ++m) {
                if (!cells.active(m)) continue;
                MediumReader& medium = reader_.media[m];
                if (cells.majorant(m).emission > 0)
                    walk.radiance += walk.weight * medium.emission(point, walk.lod, walk.time) / majorant;
                if (cells.majorant(m).extinction == 0) continue;
                const double extinction = medium.extinction(point, walk.lod, walk.time);
                if (medium.medium().settings->transfer && extinction > 0)
                    walk.radiance += walk.weight * extinction / majorant *
                                     medium.medium()
                                         .settings->transfer->at(medium.density(point, walk.lod, walk.time))
                                         .color;
                if (pick < extinction) {
                    event = {Event::Kind::kMedium, t, m, {}};
                    collided = true;
                }
                pick -= extinction;
            }
            if (collided) return event;
        }
    }
    return event;
}

// Light that comes straight from lights to a point of a medium and is scattered into `direction` (the way a
// walk came, on from the eye).
void PathWalk::lightMedium(Walk& walk, std::size_t m, const glm::dvec3& point, const glm::dvec3& direction) {
    const TracedWorld& world = reader_.world;
    const PhaseFunction& phase = world.media[m].settings->phase;
    const std::size_t count = world.settings.lights.size();
    if (count == 0) return;
    const bool all = count <= kAllLights;
    const std::size_t one = all ? 0 : std::min(count - 1, std::size_t(walk.random.uniform() * double(count)));
    const double factor = all ? 1 : double(count);
    walk.light_odds = 1 / factor;
    for (std::size_t l = all ? 0 : one; l < (all ? count : one + 1); ++l) {
        const WorldLight& light = world.settings.lights[l];
        if (light.kind == WorldLight::Kind::kEnvironment) {
            if (light.environment->constant()) continue;  // met where walks escape
            const EnvironmentMap::Pick pick =
                light.environment->pick(walk.random.uniform(), walk.random.uniform());
            if (!(pick.density > 0)) continue;
            const double scattered = phase(glm::dot(pick.direction, direction));
            const double open = openTo(walk, {point, pick.direction}, kInfinity);
            walk.radiance += factor * walk.weight * pick.radiance *
                             (scattered / pick.density * balance(pick.density / factor, scattered) * open);
            continue;
        }
        const LightArrival arrival = arrivalAt(light, point);
        if (greatest(arrival.irradiance) == 0) continue;
        const double scattered = phase(glm::dot(arrival.to_light, direction));
        const double open = light.shadows == ShadowMethod::kNone
                                ? 1
                                : openTo(walk, {point, arrival.to_light}, arrival.distance);
        walk.radiance += factor * scattered * open * walk.weight * arrival.irradiance;
    }
}

void PathWalk::lightSurface(Walk& walk, const PlacedHit& hit, const glm::dvec3& point,
                            const glm::dvec3& normal) {
    const TracedWorld& world = reader_.world;
    const glm::dvec3 reflected = world.surfaces[hit.surface].settings->color / std::numbers::pi;
    walk.light_odds = 1;
    for (const WorldLight& light : world.settings.lights) {
        if (light.kind == WorldLight::Kind::kEnvironment) {
            if (light.environment->constant()) continue;
            const EnvironmentMap::Pick pick =
                light.environment->pick(walk.random.uniform(), walk.random.uniform());
            const double cosine = glm::dot(pick.direction, normal);
            if (!(pick.density > 0) || !(cosine > 0)) continue;
            const double open = openTo(walk, {point, pick.direction}, kInfinity);
            walk.radiance +=
                walk.weight * reflected * pick.radiance *
                (cosine / pick.density * balance(pick.density, cosine / std::numbers::pi) * open);
            continue;
        }
        const LightArrival arrival = arrivalAt(light, point);
        const double cosine = glm::dot(arrival.to_light, normal);
        if (!(cosine > 0) || greatest(arrival.irradiance) == 0) continue;
        const double open = light.shadows == ShadowMethod::kNone
                                ? 1
                                : openTo(walk, {point, arrival.to_light}, arrival.distance);
        walk.radiance += cosine * open * walk.weight * reflected * arrival.irradiance;
    }
}

// On and on from walk.ray, whose direction was just picked.
void PathWalk::scatterFrom(Walk& walk) {
    const TracedWorld& world = reader_.world;
    // Behind the last scattering nothing scatters, but the sky and what glows are still seen: unlike other
    // lights they are met, not picked.
    const bool met =
        std::any_of(world.settings.lights.begin(), world.settings.lights.end(),
                    [](const WorldLight& light) { return light.kind == WorldLight::Kind::kEnvironment; }) ||
        std::any_of(world.media.begin(), world.media.end(),
                    [](const TracedMedium& medium) { return medium.glows() || medium.settings->transfer; });
    while (walk.bounces < most_bounces_ || (walk.bounces == most_bounces_ && met)) {
        ++walk.bounces;
        if (walk.bounces > kCertainBounces) {
            const double survives = std::min(1.0, greatest(walk.weight));
            if (!(survives > 0) || walk.random.uniform() >= survives) return;
            walk.weight /= survives;
        }
        const Event event = fly(walk, walk.ray);
        const glm::dvec3 point = walk.ray.origin + event.t * walk.ray.direction;
        if (event.kind == Event::Kind::kEscaped) {
            for (const WorldLight& light : world.settings.lights) {
                if (light.kind != WorldLight::Kind::kEnvironment) continue;
                const double other = light.environment->constant()
                                         ? 0
                                         : walk.light_odds * light.environment->density(walk.ray.direction);
                walk.radiance += walk.weight * light.environment->radiance(walk.ray.direction) *
                                 balance(walk.direction_density, other);
            }
            return;
        }
        if (walk.bounces > most_bounces_ || event.kind == Event::Kind::kLost) return;
        if (event.kind == Event::Kind::kMedium) {
            MediumReader& medium = reader_.media[event.medium];
            if (medium.medium().settings->transfer) return;  // absorbs
            walk.weight *= medium.albedo(point, walk.lod, walk.time);
            if (!(greatest(walk.weight) > 0)) return;
            scatter(walk, event.medium, point);
        } else {
            reflect(walk, event.hit, point);
        }
    }
}

void PathWalk::scatter(Walk& walk, std::size_t m, const glm::dvec3& point) {
    const PhaseFunction& phase = reader_.world.media[m].settings->phase;
    walk.left = SIZE_MAX;
    lightMedium(walk, m, point, walk.ray.direction);
    const double cosine = phase.pickCosine(walk.random.uniform());
    walk.ray = {point, aroundAxis(walk.ray.direction, cosine, walk.random.uniform())};
    walk.direction_density = phase(cosine);
}

void PathWalk::reflect(Walk& walk, const PlacedHit& hit, const glm::dvec3& point) {
    walk.left = hit.surface;
    walk.left_entering = hit.hit.entering;
    const glm::dvec3 normal = surfaces_->normal(hit, walk.ray.direction);
    lightSurface(walk, hit, point, normal);
    walk.weight *= reader_.world.surfaces[hit.surface].settings->color;
    const double cosine = std::sqrt(walk.random.uniform());
    walk.ray = {point, aroundAxis(normal, cosine, walk.random.uniform())};
    walk.direction_density = cosine / std::numbers::pi;
}

RaySample PathWalk::sample(const WorldRay& ray, double end, double time, PathRandom& random) {
    steps_.clear();
    RaySample out = march_.march(ray, end, time, 0, &steps_);
    const TracedWorld& world = reader_.world;
    Walk walk(random, time);
    walk.ray = ray;
    double total = 0;
    cumulative_.clear();
    for (const MarchStep& step : steps_) cumulative_.push_back(total += step.transmittance * step.stopped);
    if (!(total > 0)) return out;
    const double picked = random.uniform() * total;
    const std::size_t index = std::min(
        std::size_t(std::upper_bound(cumulative_.begin(), cumulative_.end(), picked) - cumulative_.begin()),
        steps_.size() - 1);
    const MarchStep step = steps_[index];
    const double odds = (cumulative_[index] - (index > 0 ? cumulative_[index - 1] : 0)) / total;
    if (step.surface) {
        const glm::dvec3 point = ray.origin + step.span.end * ray.direction;
        walk.weight = glm::dvec3(step.transmittance * step.stopped / odds);
        if (!world.media.empty()) walk.lod = world.lodAt(world.media[0], point);
        reflect(walk, step.hit, point);
    } else {
        const double length = step.span.end - step.span.begin;
        const double t = step.span.begin + random.uniform() * length;
        const glm::dvec3 point = ray.origin + t * ray.direction;
        double extinction = 0;
        std::size_t chosen = 0;
        for (std::size_t m = 0; m < reader_.media.size(); ++m) {
            const double own = reader_.media[m].extinction(point, world.lodAt(world.media[m], point), time);
            extinction += own;
            if (own > 0 && random.uniform() * extinction < own) chosen = m;
        }
        if (!(extinction > 0) || world.media[chosen].settings->transfer) return out;
        walk.lod = world.lodAt(world.media[chosen], point);
        const double within = ratioTrack(walk, ray, {step.span.begin, t});
        walk.weight = reader_.media[chosen].albedo(point, walk.lod, time) *
                      (step.transmittance * within * extinction * length / odds);
        if (walk.weight == glm::dvec3(0)) return out;
        scatter(walk, chosen, point);
    }
    scatterFrom(walk);
    out.radiance += walk.radiance;
    const double level = world.level_deviation * greatest(walk.radiance);
    out.radiance_variance += level * level;
    return out;
}

}  // namespace brickyard

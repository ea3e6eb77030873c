#include "client/trace/surface_hits.h"

#include <algorithm>

namespace brickyard {

SurfaceHits::SurfaceHits(const TracedWorld& world, std::span<const RayContext> contexts)
    : world_(world), contexts_(contexts) {
    for (const TracedSurface& surface : world.surfaces)
        tracers_.emplace_back(*surface.channel.channel, *surface.settings, surface.level);
}

const std::vector<PlacedHit>& SurfaceHits::along(const WorldRay& ray, RaySpan span, bool leaves) {
    hits_.clear();
    span = world_.clipped(ray, span);
    if (span.empty()) return hits_;
    for (std::size_t s = 0; s < tracers_.size(); ++s) {
        const SurfaceSettings& settings = *world_.surfaces[s].settings;
        const RayContext& context = contexts_[world_.surfaces[s].channel.frame];
        const IndexRay index(ray, tracers_[s].channel().transform());
        RaySpan rest = span;
        if (leaves) rest.begin = std::max(rest.begin, 2 * tracers_[s].hair(index));
        if (rest.empty()) continue;
        found_.clear();
        const std::size_t most = settings.opacity >= 1 ? 1 : kMostCrossings;
        missed_ |=
            tracers_[s].crossings(index, rest, context, most, found_) == SurfaceTracer::Found::kMissing;
        for (const SurfaceHit& hit : found_) hits_.push_back({s, hit});
    }
    std::sort(hits_.begin(), hits_.end(), [](const PlacedHit& a, const PlacedHit& b) {
        return a.hit.t != b.hit.t ? a.hit.t < b.hit.t : a.surface < b.surface;
    });
    for (std::size_t i = 0; i < hits_.size(); ++i)
        if (world_.surfaces[hits_[i].surface].settings->opacity >= 1) {
            hits_.resize(i + 1);
            break;
        }
    return hits_;
}

double SurfaceHits::openness(const WorldRay& ray, RaySpan span, bool leaves) {
    double open = 1;
    span = world_.clipped(ray, span);
    for (std::size_t s = 0; s < tracers_.size() && open > 0; ++s) {
        const SurfaceSettings& settings = *world_.surfaces[s].settings;
        const RayContext& context = contexts_[world_.surfaces[s].channel.frame];
        const IndexRay index(ray, tracers_[s].channel().transform());
        RaySpan rest = span;
        if (leaves) rest.begin = std::max(rest.begin, 2 * tracers_[s].hair(index));
        if (rest.empty()) continue;
        found_.clear();
        const std::size_t most = settings.opacity >= 1 ? 1 : kMostCrossings;
        missed_ |=
            tracers_[s].crossings(index, rest, context, most, found_) == SurfaceTracer::Found::kMissing;
        for (std::size_t i = 0; i < found_.size(); ++i) open *= 1 - settings.opacity;
    }
    return open;
}

glm::dvec3 SurfaceHits::normal(const PlacedHit& hit, const glm::dvec3& direction) {
    const TracedSurface& surface = world_.surfaces[hit.surface];
    glm::dvec3 normal;
    missed_ |= tracers_[hit.surface].normal(hit.hit, direction, surface.settings->normal_filter,
                                            contexts_[surface.channel.frame],
                                            normal) == SurfaceTracer::Found::kMissing;
    return glm::dot(normal, direction) > 0 ? -normal : normal;
}

double SurfaceHits::ambient(const PlacedHit& hit, const glm::dvec3& normal, std::uint32_t rays,
                            std::uint64_t seed) {
    const TracedSurface& surface = world_.surfaces[hit.surface];
    if (!(surface.settings->ambient_occlusion > 0)) return 1;
    SurfaceTracer::Openness open;
    missed_ |= tracers_[hit.surface].openness(hit.hit, normal, surface.settings->ambient_occlusion, rays,
                                              seed, contexts_[surface.channel.frame],
                                              open) == SurfaceTracer::Found::kMissing;
    return open.share;
}

}  // namespace brickyard

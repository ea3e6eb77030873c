#include "client/trace/surface_hits.h"

#include <algorithm>

namespace brickyard {

SurfaceHits::SurfaceHits(const TracedWorld& world, std::span<const RayContext> contexts)
    : world_(world), contexts_(contexts) {
    for (const TracedSurface& surface : world.surfaces)
        tracers_.emplace_back(*surface.channel.channel, *surface.settings, surface.level);
}

// Of one surface: all crossings of a clear one, the first of one that is opaque.
const std::vector<SurfaceHit>& SurfaceHits::crossings(std::size_t s, const WorldRay& ray, RaySpan span,
                                                      bool leaves) {
    const TracedSurface& surface = world_.surfaces[s];
    const IndexRay index(ray, tracers_[s].channel().transform());
    if (leaves) span.begin = std::max(span.begin, 2 * tracers_[s].hair(index));
    found_.clear();
    if (span.empty()) return found_;
    const std::size_t most = surface.settings->opacity >= 1 ? 1 : kMostCrossings;
    missed_ |= tracers_[s].crossings(index, span, contexts_[surface.channel.frame], most, found_) ==
               SurfaceTracer::Found::kMissing;
    return found_;
}

const std::vector<PlacedHit>& SurfaceHits::along(const WorldRay& ray, RaySpan span, bool leaves) {
    hits_.clear();
    span = world_.clipped(ray, span);
    if (span.empty()) return hits_;
    for (std::size_t s = 0; s < tracers_.size(); ++s)
        for (const SurfaceHit& hit : crossings(s, ray, span, leaves)) hits_.push_back({s, hit});
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
    for (std::size_t s = 0; s < tracers_.size() && open > 0; ++s)
        for (std::size_t n = crossings(s, ray, span, leaves).size(); n > 0; --n)
            open *= 1 - world_.surfaces[s].settings->opacity;
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

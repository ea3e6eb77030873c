// The surfaces of a scene along a ray. One thread, one pass.
#pragma once

#include <span>
#include <vector>

#include "client/trace/surface_tracer.h"
#include "client/trace/traced_world.h"

namespace brickyard {

struct PlacedHit {
    std::size_t surface = 0;  // index in TracedWorld::surfaces
    SurfaceHit hit;
};

class SurfaceHits {
public:
    // All of it outlives the object. `contexts`: one a frame.
    SurfaceHits(const TracedWorld& world, std::span<const RayContext> contexts);

    // All crossings up to the first opaque one, front to back. Valid until the next call. With `leaves` the
    // ray begins on a surface, perhaps: a hair off it.
    const std::vector<PlacedHit>& along(const WorldRay& ray, RaySpan span, bool leaves = false);
    // What surfaces let through: the product of 1 - opacity over crossings. `leaves` as above.
    double openness(const WorldRay& ray, RaySpan span, bool leaves = true);

    // Unit, world, on the side that the ray came from.
    glm::dvec3 normal(const PlacedHit& hit, const glm::dvec3& direction);
    // Share of directions about the normal that are free as far as the surface's reach; 1 where it has none.
    double ambient(const PlacedHit& hit, const glm::dvec3& normal, std::uint32_t rays, std::uint64_t seed);

    bool takeMissed() {
        const bool missed = missed_;
        missed_ = false;
        return missed;
    }

private:
    const std::vector<SurfaceHit>& crossings(std::size_t surface, const WorldRay& ray, RaySpan span,
                                             bool leaves);
    static constexpr std::size_t kMostCrossings = 64;
    const TracedWorld& world_;
    std::span<const RayContext> contexts_;
    std::vector<SurfaceTracer> tracers_;
    std::vector<PlacedHit> hits_;
    std::vector<SurfaceHit> found_;
    bool missed_ = false;
};

}  // namespace brickyard

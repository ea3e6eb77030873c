// What of a light reaches a point: by a ray (exact), from a deep shadow map, or from a baked channel. One
// thread.
#pragma once

#include <limits>

#include "client/trace/media_walk.h"
#include "client/trace/shadow_maps.h"
#include "client/trace/surface_hits.h"

namespace brickyard {

// A light as a point sees it, without what is in the way.
struct LightArrival {
    glm::dvec3 to_light{0, 1, 0};                               // unit
    double distance = std::numeric_limits<double>::infinity();  // world
    glm::dvec3 irradiance{0};                                   // on a surface that faces it
};
// REQUIRES: no environment.
LightArrival arrivalAt(const WorldLight& light, const glm::dvec3& point);

struct Reach {
    double transmittance = 1;
    double deviation = 0;  // standard deviation of its expected error
};

class LightReach {
public:
    // All of it outlives the object. `maps` may be nullptr: lights that would use one are traced.
    LightReach(WorldReader& reader, SurfaceHits* surfaces, const ShadowMaps* maps)
        : reader_(reader), surfaces_(surfaces), maps_(maps) {}

    // `light`: index in TracedWorld::lights.
    Reach of(std::size_t light, const LightArrival& arrival, const glm::dvec3& point, double lod,
             double time);
    // Along a ray, by a march.
    Reach along(const WorldRay& ray, double distance, double lod, double time);

private:
    WorldReader& reader_;
    SurfaceHits* surfaces_;
    const ShadowMaps* maps_;
};

}  // namespace brickyard

// A ray through media and surfaces, integrated front to back: emission, single scattering, shaded surfaces.
// Deterministic: the same ray gives the same result. One thread, one pass.
#pragma once

#include <vector>

#include "client/trace/light_reach.h"
#include "client/trace/media_walk.h"
#include "client/trace/surface_hits.h"

namespace brickyard {

struct RaySample {
    glm::dvec3 radiance{0};
    double alpha = 0;
    double depth = 0;           // where half the final opacity is reached; 0 where empty
    double alpha_variance = 0;  // of the expected error, from levels of detail
    double radiance_variance = 0;
};

// What of a ray path tracing picks from: a stretch of media, or a surface where the span ends.
struct MarchStep {
    RaySpan span;
    double transmittance = 1;  // in front of it
    double depth = 0;          // optical, of all media
    double stopped = 0;        // share of the light from behind that does not come through
    bool surface = false;
    PlacedHit hit;
};

class RayMarch {
public:
    // All of it outlives the object.
    RayMarch(WorldReader& reader, LightReach& lights, SurfaceHits* surfaces)
        : reader_(reader), lights_(lights), surfaces_(surfaces) {}

    // As far as `end`. With `steps`: no light scatters and no surface is lit (the caller sees to that), and
    // what could is written there. `seed` turns the directions of ambient occlusion.
    RaySample march(const WorldRay& ray, double end, double time, std::uint64_t seed,
                    std::vector<MarchStep>* steps = nullptr);

    // Radiance of a surface towards the eye, of a hit that a ray in `direction` makes, of light that comes
    // straight from lights. `normal`: on the ray's side.
    glm::dvec3 shade(const PlacedHit& hit, const glm::dvec3& point, const glm::dvec3& direction,
                     const glm::dvec3& normal, double time, std::uint64_t seed);

private:
    struct Ray;
    void media(Ray& ray, RaySpan span);
    glm::dvec3 transferred(Ray& ray, const MediaWalk& walk, std::size_t medium, RaySpan span, double& depth);
    void stretch(Ray& ray, const MediaWalk& walk, RaySpan span);
    glm::dvec3 scattered(std::size_t medium, bool of_environment, const glm::dvec3& point,
                         const glm::dvec3& direction, double lod, double time, double& variance);
    glm::dvec3 lit(Ray& ray, std::size_t medium, RaySpan span, const glm::dvec3& point, double weight,
                   double cell, double lod, double& variance);
    double shading(std::size_t medium, const glm::dvec3& point, const glm::dvec3& direction, double lod,
                   double time, glm::dvec3& light);

    WorldReader& reader_;
    LightReach& lights_;
    SurfaceHits* surfaces_;
    // Opacity in front of each stretch and behind it, for the depth.
    struct Mark {
        double begin, end, alpha_before, alpha;
    };
    std::vector<Mark> marks_;
};

}  // namespace brickyard

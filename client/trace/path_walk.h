// Multiple scattering by unbiased random walks. The camera ray is integrated exactly (opacity and emission
// have no noise) and the walk begins at a point picked along it; from there flights are sampled by delta
// tracking and shadows estimated by ratio tracking, under the majorants of the bricks (Woodcock et al. 1965;
// Novak, Selle, Jarosz. Residual Ratio Tracking. 2014; Novak et al. Monte Carlo Methods for Volumetric Light
// Transport Simulation. 2018). Emission met on the way is counted at every tentative collision. Walks end by
// Russian roulette, or when light has been scattered `most_bounces` times on its way to the camera ray's own
// scattering. Deterministic for a seed. One thread, one pass.
#pragma once

#include "client/trace/random.h"
#include "client/trace/ray_march.h"

namespace brickyard {

class PathWalk {
public:
    // All of it outlives the object.
    PathWalk(WorldReader& reader, RayMarch& march, SurfaceHits* surfaces, std::uint32_t most_bounces)
        : reader_(reader), march_(march), surfaces_(surfaces), most_bounces_(most_bounces) {}

    // One path through a camera ray. Variances are those of the levels of detail alone.
    RaySample sample(const WorldRay& ray, double end, double time, PathRandom& random);

private:
    struct Event {
        enum class Kind { kEscaped, kMedium, kSurface, kLost } kind = Kind::kEscaped;
        double t = 0;
        std::size_t medium = 0;
        PlacedHit hit;
    };
    struct Walk;
    void scatterFrom(Walk& walk);
    // Light and a new direction at a point where the walk's ray has ended.
    void scatter(Walk& walk, std::size_t medium, const glm::dvec3& point);
    void reflect(Walk& walk, const PlacedHit& hit, const glm::dvec3& point);
    void lightMedium(Walk& walk, std::size_t medium, const glm::dvec3& point, const glm::dvec3& direction);
    void lightSurface(Walk& walk, const PlacedHit& hit, const glm::dvec3& point, const glm::dvec3& normal);
    Event fly(Walk& walk, const WorldRay& ray);
    double ratioTrack(Walk& walk, const WorldRay& ray, RaySpan span);
    double openTo(Walk& walk, const WorldRay& ray, double distance);

    WorldReader& reader_;
    RayMarch& march_;
    SurfaceHits* surfaces_;
    std::uint32_t most_bounces_;
    std::vector<MarchStep> steps_;
    std::vector<double> cumulative_;
};

}  // namespace brickyard

// Transmittance from points of a segment to the directional light: exact shadow rays through the density's
// octree, at the coarsest level whose error is below a tolerance. Keeps its place when a page is missing, so
// a cache of a few pages is enough. One thread at a time.
#pragma once

#include "client/cpu/channel_ray.h"
#include "client/cpu/render_plan.h"

namespace brickyard {

class ShadowTracer {
public:
    struct Tolerances {
        double depth = 0;  // standard deviation of the optical depth to the light; 0 goes to the finest level
        double least_weight = 0;  // a step that scatters less is not traced
        // Between two steps whose shadows differ by less than this over the weight between them, shadows are
        // interpolated; 0 traces every step.
        double interpolation = 0;
    };
    // REQUIRES: plan.scene.light.
    ShadowTracer(const RenderPlan& plan, const Tolerances& tolerances);

    // Lights the steps of one integrated segment of `ray`. `transmittance` is that in front of the segment.
    // False while a page is missing (it is wanted).
    bool light(const ChannelRay& ray, RaySegment& segment, double transmittance,
               const RayContext& context) const;

private:
    struct Steps;
    bool lightStep(const Steps& steps, std::size_t step, const RayContext& context) const;
    bool lightBetween(const Steps& steps, std::size_t first, std::size_t last,
                      const RayContext& context) const;
    bool trace(const glm::dvec3& from, RaySegment& segment, const RayContext& context, double worth) const;

    const RenderPlan& plan_;
    glm::dvec3 direction_;  // to the light, index units per world unit
    double unit_length_;
    Tolerances tolerances_;
};

}  // namespace brickyard

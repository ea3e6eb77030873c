// Transmittance from points of a segment to the directional light: exact shadow rays through the density's octree, at the
// coarsest level whose error is below a tolerance. Keeps its place when a page is missing, so a cache of a few pages
// is enough. One thread at a time.
#pragma once

#include "client/cpu/channel_ray.h"
#include "client/cpu/render_plan.h"

namespace brickyard {

class ShadowTracer {
public:
    // `tolerance`: standard deviation of the optical depth to the light that may be made; 0 goes to the finest level.
    // REQUIRES: plan.scene.light.
    ShadowTracer(const RenderPlan& plan, double tolerance);

    // Lights the steps of one integrated segment of `ray`. `transmittance` is that in front of the segment; steps that
    // scatter less than `least_weight` are not traced. False while a page is missing (it is wanted).
    bool light(const ChannelRay& ray, RaySegment& segment, double transmittance, double least_weight,
               const RayContext& context) const;

private:
    bool trace(const glm::dvec3& from, RaySegment& segment, const RayContext& context, double worth) const;

    const RenderPlan& plan_;
    glm::dvec3 direction_;  // to the light, index units per world unit
    double unit_length_;
    double tolerance_;
};

}  // namespace brickyard

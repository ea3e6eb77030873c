#include "client/cpu/render_plan.h"

#include <glm/geometric.hpp>

namespace brickyard {

bool eyeIsFar(const RenderPlan& plan) {
    // 1e-16 of this many extents is a thousandth of what a float pixel shows.
    constexpr double kMostExtents = 1e8;
    const glm::dvec3 low = plan.density->clipLow(), high = plan.density->clipHigh();
    const glm::dvec3 eye = plan.density->transform().inversePoint(plan.camera->eye());
    return glm::length(eye - 0.5 * (low + high)) > kMostExtents * glm::length(high - low);
}

}  // namespace brickyard

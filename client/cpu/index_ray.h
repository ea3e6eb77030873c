// A world ray in the index space of one channel. The parameter t is world distance from the eye in every
// channel. Plain value, any thread.
#pragma once

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <limits>

#include "core/affine.h"
#include "core/camera.h"

namespace brickyard {

struct RaySpan {
    double begin = 0, end = 0;  // world distances
    bool empty() const { return !(begin < end); }
};

struct IndexRay {
    glm::dvec3 origin{0};     // index space
    glm::dvec3 direction{0};  // index units per world unit
    glm::dvec3 inverse{0};    // 1 / direction; unused where parallel
    bool parallel[3] = {};

    IndexRay() = default;
    IndexRay(const WorldRay& ray, const Affine& transform)
        : origin(transform.inversePoint(ray.origin)), direction(transform.inverseVector(ray.direction)) {
        const double longest =
            std::max({std::abs(direction.x), std::abs(direction.y), std::abs(direction.z)});
        for (int a = 0; a < 3; ++a) {
            // Below this an axis moves less than a rounding over any distance that matters: it counts as
            // parallel.
            parallel[a] = !(std::abs(direction[a]) > longest * 1e-280);
            inverse[a] = parallel[a] ? 0 : 1 / direction[a];
        }
    }

    // World length of one index unit along the ray.
    double unitLength() const { return 1 / glm::length(direction); }
    // Where the ray meets the plane at `position` of `axis`. One formula everywhere: two boxes that share a
    // face get the same t, so spans tile without gap or overlap. REQUIRES: !parallel[axis].
    double planeAt(int axis, double position) const { return (position - origin[axis]) * inverse[axis]; }

    // The part of `span` inside the box [low, high]; a parallel ray on a shared face belongs to the box above
    // it.
    RaySpan clip(const glm::dvec3& low, const glm::dvec3& high, RaySpan span) const {
        for (int a = 0; a < 3; ++a) {
            if (parallel[a]) {
                if (origin[a] < low[a] || origin[a] >= high[a]) return {0, 0};
                continue;
            }
            const double p = planeAt(a, low[a]), q = planeAt(a, high[a]);
            span.begin = std::max(span.begin, std::min(p, q));
            span.end = std::min(span.end, std::max(p, q));
        }
        return span;
    }
};

}  // namespace brickyard

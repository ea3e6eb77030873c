// The cells of one brick along a ray, and the exact integral of the field through each. Pure functions, any
// thread.
//
// Along a ray a trilinear cell is a cubic, which two Gauss points integrate exactly (DESIGN.md, section 8).
// Cell walk: Amanatides, Woo. A Fast Voxel Traversal Algorithm for Ray Tracing. 1987
#pragma once

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <glm/vec3.hpp>

#include "client/cpu/index_ray.h"
#include "client/cpu/octree_walk.h"
#include "core/brick_shape.h"

namespace brickyard {

// Integral of max(0, cubic) over [0, 1], given the cubic at 0, 1/3, 2/3 and 1: split at its roots, then
// exact.
double integratePositiveCubic(double v0, double v1, double v2, double v3);

// One trilinear cell; corner (i, j, k) is at index i + 2j + 4k.
struct Cell {
    double corner[8];

    double at(double x, double y, double z) const {
        const double x00 = corner[0] + (corner[1] - corner[0]) * x,
                     x10 = corner[2] + (corner[3] - corner[2]) * x;
        const double x01 = corner[4] + (corner[5] - corner[4]) * x,
                     x11 = corner[6] + (corner[7] - corner[6]) * x;
        const double y0 = x00 + (x10 - x00) * y, y1 = x01 + (x11 - x01) * y;
        return y0 + (y1 - y0) * z;
    }
    double at(const glm::dvec3& p) const { return at(p.x, p.y, p.z); }
};

// Mean of max(0, field) on the straight way from `from` to `to`, both in [0, 1]^3.
inline double meanPositive(const Cell& cell, const glm::dvec3& from, const glm::dvec3& to) {
    double low = cell.corner[0], high = cell.corner[0];
    for (int i = 1; i < 8; ++i) {
        low = std::min(low, cell.corner[i]);
        high = std::max(high, cell.corner[i]);
    }
    if (high <= 0) return 0;
    if (low >= 0) {
        constexpr double kGauss = 0.21132486540518711775;  // (1 - 1/sqrt(3)) / 2
        const glm::dvec3 way = to - from;
        return 0.5 * (cell.at(from + kGauss * way) + cell.at(from + (1 - kGauss) * way));
    }
    const glm::dvec3 way = to - from;
    return integratePositiveCubic(cell.at(from), cell.at(from + way / 3.0), cell.at(from + way * (2.0 / 3.0)),
                                  cell.at(to));
}

// Calls visit(cell, from, to, t_begin, t_end) for each cell of the brick that the ray meets within `span`, in
// order; `from` and `to` are positions in the cell. Cells outside the node's box [box_begin, box_end) are
// passed over: there the field is the background. `samples` has (N + 1)^3 floats.
template <class Visit>
void walkCells(const float* samples, BrickShape shape, const NodeKey& key, const NodeRecord& record,
               const IndexRay& ray, RaySpan span, Visit&& visit) {
    const double edge = cellEdge(key.level);  // of a cell, in index units
    const glm::dvec3 low = nodeLow(key, shape);
    glm::dvec3 box_low, box_high;
    for (int a = 0; a < 3; ++a) {
        box_low[a] = low[a] + edge * record.box_begin[std::size_t(a)];
        box_high[a] = low[a] + edge * record.box_end[std::size_t(a)];
    }
    span = ray.clip(box_low, box_high, span);
    if (span.empty()) return;

    // Relative to the brick, in cells.
    const glm::dvec3 origin = (ray.origin - low) / edge, direction = ray.direction / edge;
    int cell[3], step[3];
    double t_next[3];
    for (int a = 0; a < 3; ++a) {
        const double position = origin[a] + span.begin * direction[a];
        const int first = record.box_begin[std::size_t(a)], last = record.box_end[std::size_t(a)] - 1;
        cell[a] = std::clamp(int(std::clamp(std::floor(position), -1.0, double(kMaxBrickEdge))), first, last);
        step[a] = ray.parallel[a] ? 0 : (direction[a] > 0 ? 1 : -1);
    }
    auto planeBehind = [&](int a) {
        if (step[a] == 0) return std::numeric_limits<double>::infinity();
        const int plane = cell[a] + (step[a] > 0 ? 1 : 0);
        // The far side of the box does not end the walk: `span` does, and rounding must not lose its last
        // bit.
        if (plane == (step[a] > 0 ? record.box_end[std::size_t(a)] : record.box_begin[std::size_t(a)]))
            return std::numeric_limits<double>::infinity();
        return ray.planeAt(a, low[a] + edge * plane);
    };
    for (int a = 0; a < 3; ++a) t_next[a] = planeBehind(a);

    const int s = shape.edgeSamples();
    const std::size_t sy = std::size_t(s), sz = std::size_t(s) * std::size_t(s);
    double t = span.begin;
    while (t < span.end) {
        const int a =
            t_next[0] < t_next[1] ? (t_next[0] < t_next[2] ? 0 : 2) : (t_next[1] < t_next[2] ? 1 : 2);
        const double t_exit = std::min(t_next[a], span.end);
        if (t_exit > t) {
            const float* c = samples + shape.sampleAt(cell[0], cell[1], cell[2]);
            const Cell values{{c[0], c[1], c[sy], c[sy + 1], c[sz], c[sz + 1], c[sz + sy], c[sz + sy + 1]}};
            const glm::dvec3 corner(cell[0], cell[1], cell[2]);
            const glm::dvec3 from = glm::clamp(origin + t * direction - corner, 0.0, 1.0);
            const glm::dvec3 to = glm::clamp(origin + t_exit * direction - corner, 0.0, 1.0);
            visit(values, from, to, t, t_exit);
            t = t_exit;
        }
        if (t_next[a] >= span.end) break;
        cell[a] += step[a];
        t_next[a] = planeBehind(a);
    }
}

}  // namespace brickyard

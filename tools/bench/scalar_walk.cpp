#include "tools/bench/scalar_walk.h"

#include <openvdb/tools/Interpolation.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "tools/bench/source_grid_data.h"

namespace brickyard {
namespace {

using Accessor = openvdb::FloatGrid::ConstUnsafeAccessor;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kGaussTwo = 0.28867513459481287;  // 1 / (2 sqrt(3))

// Places and weights on [-1/2, 1/2].
constexpr struct {
    double place, weight;
} kGaussFour[] = {{-0.43056815579702629, 0.17392742256872693},
                  {-0.16999052179242813, 0.32607257743127307},
                  {0.16999052179242813, 0.32607257743127307},
                  {0.43056815579702629, 0.17392742256872693}};

// A ray in index space; `t` are world lengths.
struct IndexRay {
    glm::dvec3 origin, direction;
    glm::dvec3 at(double t) const { return origin + t * direction; }
};

// One cell's eight corners.
class Cell {
public:
    Cell(const Accessor& accessor, const openvdb::Coord& corner) : corner_(corner) {
        for (int i = 0; i < 8; ++i)
            corners_[i] = double(accessor.getValue(corner.offsetBy(i >> 2 & 1, i >> 1 & 1, i & 1)));
    }
    double density(const glm::dvec3& p) const {
        const double x = p.x - corner_.x(), y = p.y - corner_.y(), z = p.z - corner_.z();
        const auto along = [](double a, double b, double f) { return a + (b - a) * f; };
        const double near = along(along(corners_[0], corners_[1], z), along(corners_[2], corners_[3], z), y);
        const double far = along(along(corners_[4], corners_[5], z), along(corners_[6], corners_[7], z), y);
        return std::max(along(near, far, x), 0.0);
    }
    double integral(const IndexRay& ray, double t0, double t1) const {
        const double middle = 0.5 * (t0 + t1), offset = (t1 - t0) * kGaussTwo;
        return 0.5 * (t1 - t0) * (density(ray.at(middle - offset)) + density(ray.at(middle + offset)));
    }

private:
    openvdb::Coord corner_;
    double corners_[8];
};

// The medium ends one sample beyond the box of its active voxels. Gives [begin, end), empty where it is
// missed.
std::pair<double, double> clip(const IndexRay& ray, const openvdb::CoordBBox& box) {
    if (box.empty()) return {0, 0};
    double begin = 0, end = kInfinity;
    for (int a = 0; a < 3; ++a) {
        const double low = box.min()[a] - 1, high = box.max()[a] + 1;
        if (ray.direction[a] == 0) {
            if (ray.origin[a] < low || ray.origin[a] > high) return {0, 0};
            continue;
        }
        double enter = (low - ray.origin[a]) / ray.direction[a],
               leave = (high - ray.origin[a]) / ray.direction[a];
        if (enter > leave) std::swap(enter, leave);
        begin = std::max(begin, enter);
        end = std::min(end, leave);
    }
    return {begin, end};
}

// visit(cell, t0, t1) for each cell in order.
template <class Visit>
void walk(const SourceGridData& data, const Accessor& accessor, const IndexRay& ray, const Visit& visit) {
    const auto [begin, end] = clip(ray, data.active_box);
    if (!(begin < end)) return;
    glm::dvec3 next, step;
    for (int a = 0; a < 3; ++a) {
        const double d = ray.direction[a], x = ray.at(begin)[a];
        next[a] = d > 0 ? (std::floor(x) + 1 - ray.origin[a]) / d
                        : (d < 0 ? (std::ceil(x) - 1 - ray.origin[a]) / d : kInfinity);
        step[a] = d == 0 ? kInfinity : 1 / std::abs(d);
    }
    for (double t = begin; t < end;) {
        const int axis = next.x < next.y ? (next.x < next.z ? 0 : 2) : (next.y < next.z ? 1 : 2);
        const double leave = std::min(next[axis], end);
        if (leave > t) {
            const glm::dvec3 inside = ray.at(0.5 * (t + leave));
            visit(Cell(accessor, openvdb::Coord::floor(openvdb::Vec3d(inside.x, inside.y, inside.z))), t,
                  leave);
            t = leave;
        }
        next[axis] += step[axis];
    }
}

IndexRay indexRay(const Affine& transform, const glm::dvec3& origin, const glm::dvec3& direction) {
    return {transform.inversePoint(origin), transform.inverseVector(direction)};
}

double depthAlong(const SourceGridData& data, const Accessor& accessor, const IndexRay& ray) {
    double depth = 0;
    walk(data, accessor, ray,
         [&](const Cell& cell, double t0, double t1) { depth += cell.integral(ray, t0, t1); });
    return depth;
}

double scatteredAlong(const SourceGridData& data, const Accessor& accessor, const IndexRay& ray, double scale,
                      const glm::dvec3& to_light) {
    double radiance = 0, before = 0;
    const glm::dvec3 light = data.transform.inverseVector(to_light);
    walk(data, accessor, ray, [&](const Cell& cell, double t0, double t1) {
        const double inside = cell.integral(ray, t0, t1);
        if (inside > 0)
            for (const auto& gauss : kGaussFour) {
                const double t = 0.5 * (t0 + t1) + gauss.place * (t1 - t0);
                const double density = cell.density(ray.at(t));
                if (density == 0) continue;
                const double to_eye = before + cell.integral(ray, t0, t);
                const double shadow = depthAlong(data, accessor, {ray.at(t), light});
                radiance += gauss.weight * (t1 - t0) * scale * density * std::exp(-scale * (to_eye + shadow));
            }
        before += inside;
    });
    return radiance;
}

}  // namespace

std::vector<double> ScalarWalk::depths(const PinholeCamera& camera, const ParallelFor& parallel_for) const {
    const SourceGridData& data = grid_.data();
    std::vector<double> result(std::size_t(camera.width()) * camera.height());
    parallel_for(camera.height(), [&](std::size_t y) {
        const Accessor accessor = data.grid->getConstUnsafeAccessor();
        for (std::uint32_t x = 0; x < camera.width(); ++x) {
            const WorldRay ray = camera.ray(x, std::uint32_t(y));
            result[y * camera.width() + x] =
                depthAlong(data, accessor, indexRay(data.transform, ray.origin, ray.direction));
        }
    });
    return result;
}

std::vector<double> ScalarWalk::scattered(const PinholeCamera& camera, double density_scale,
                                          const glm::dvec3& to_light, std::uint32_t stride,
                                          const ParallelFor& parallel_for) const {
    const SourceGridData& data = grid_.data();
    const std::uint32_t columns = camera.width() / stride, rows = camera.height() / stride;
    std::vector<double> result(std::size_t(columns) * rows);
    parallel_for(rows, [&](std::size_t row) {
        const Accessor accessor = data.grid->getConstUnsafeAccessor();
        for (std::uint32_t column = 0; column < columns; ++column) {
            const WorldRay ray =
                camera.ray(stride * column + stride / 2, stride * std::uint32_t(row) + stride / 2);
            result[row * columns + column] = scatteredAlong(
                data, accessor, indexRay(data.transform, ray.origin, ray.direction), density_scale, to_light);
        }
    });
    return result;
}

}  // namespace brickyard

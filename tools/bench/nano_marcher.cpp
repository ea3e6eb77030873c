#include "tools/bench/nano_marcher.h"

// A namespace of its own for this file's copy of NanoVDB: were it shared with files that are compiled for any
// processor, the linker would keep one copy of each inline function, of either kind.
#define nanovdb nanovdb_native
#include <nanovdb/NanoVDB.h>
#include <nanovdb/util/SampleFromVoxels.h>
#undef nanovdb

#include <cmath>

namespace brickyard {
namespace {

namespace nano = nanovdb_native;
using Leaf = nano::NanoLeaf<float>;

// A ray ends where less than this much light is left: no step size that a user would choose shows it.
constexpr float kOpaque = 1e-4f;

struct MarchRay {
    float origin[3], direction[3], inverse[3];  // unit direction in index space
    float at(int axis, float t) const { return origin[axis] + t * direction[axis]; }

    // Both are cut to where the ray is within [low, high].
    void clip(int axis, float low, float high, float& begin, float& end) const {
        if (direction[axis] == 0) {
            if (origin[axis] < low || origin[axis] > high) end = begin;
            return;
        }
        const float a = (low - origin[axis]) * inverse[axis], b = (high - origin[axis]) * inverse[axis];
        begin = a < b ? (a > begin ? a : begin) : (b > begin ? b : begin);
        end = a < b ? (b < end ? b : end) : (a < end ? a : end);
    }
};

// The eight values around a point whose cell lies inside one leaf: no accessor is needed for them.
inline float sampleLeaf(const Leaf& leaf, int x, int y, int z, float fx, float fy, float fz) {
    const float* v = leaf.data()->mValues + ((x & 7) << 6 | (y & 7) << 3 | (z & 7));
    const float v00 = v[0] + (v[1] - v[0]) * fz, v01 = v[8] + (v[9] - v[8]) * fz;
    const float v10 = v[64] + (v[65] - v[64]) * fz, v11 = v[72] + (v[73] - v[72]) * fz;
    const float v0 = v00 + (v01 - v00) * fy, v1 = v10 + (v11 - v10) * fy;
    return v0 + (v1 - v0) * fx;
}

using Cells = nano::NanoGrid<nano::ValueMask>;

class Marcher {
public:
    Marcher(const nano::NanoGrid<float>& density, const Cells& cells)
        : accessor_(density.getAccessor()), sampler_(accessor_), cells_(cells.getAccessor()) {
        // Of the cells' lowest corners; the last cell reaches to the one after it.
        const nano::CoordBBox box = cells.tree().bbox();
        for (int a = 0; a < 3; ++a) {
            low_[a] = box.empty() ? 0 : float(box.min()[a]);
            high_[a] = box.empty() ? 0 : float(box.max()[a] + 1);
        }
    }

    // Density at the middles of steps, added up; at `limit` nothing more is to be seen.
    float march(const MarchRay& ray, float step, float limit) {
        float begin = 0, end = 1e30f;
        for (int a = 0; a < 3; ++a) ray.clip(a, low_[a], high_[a], begin, end);
        float sum = 0;
        for (float t = begin + 0.5f * step; t < end && sum < limit;) {
            const float p[3] = {ray.at(0, t), ray.at(1, t), ray.at(2, t)};
            const float f[3] = {std::floor(p[0]), std::floor(p[1]), std::floor(p[2])};
            const int x = int(f[0]), y = int(f[1]), z = int(f[2]);
            enter(x, y, z);
            if (empty_edge_ > 0) {
                t += step * std::fmax(1.0f, std::ceil((leaveAt(ray) - t) / step));
                continue;
            }
            const bool inside = leaf_ && (x & 7) != 7 && (y & 7) != 7 && (z & 7) != 7;
            const float density = inside ? sampleLeaf(*leaf_, x, y, z, p[0] - f[0], p[1] - f[1], p[2] - f[2])
                                         : sampler_(nano::Vec3<float>(p[0], p[1], p[2]));
            sum += density > 0 ? density : 0;
            t += step;
        }
        return sum;
    }

private:
    // Finds the node around a cell, unless it is the one of the sample before.
    void enter(int x, int y, int z) {
        const int lx = x & ~7, ly = y & ~7, lz = z & ~7;
        if (lx == leaf_low_[0] && ly == leaf_low_[1] && lz == leaf_low_[2]) return;
        leaf_low_[0] = lx, leaf_low_[1] = ly, leaf_low_[2] = lz;
        const nano::Coord cell(x, y, z);
        leaf_ = accessor_.probeLeaf(cell);
        empty_edge_ = 0;
        if (cells_.probeLeaf(cell) || cells_.isActive(cell)) return;
        empty_edge_ = int(cells_.getDim(cell, /*ray=*/0));
        empty_low_[0] = x & ~(empty_edge_ - 1);
        empty_low_[1] = y & ~(empty_edge_ - 1);
        empty_low_[2] = z & ~(empty_edge_ - 1);
    }

    // Where the ray leaves the empty node that it is in.
    float leaveAt(const MarchRay& ray) const {
        float leave = 1e30f;
        for (int a = 0; a < 3; ++a) {
            const int face = ray.direction[a] > 0 ? empty_low_[a] + empty_edge_ : empty_low_[a];
            if (ray.direction[a] != 0)
                leave = std::fmin(leave, (float(face) - ray.origin[a]) * ray.inverse[a]);
        }
        return leave;
    }

    using Accessor = nano::DefaultReadAccessor<float>;
    Accessor accessor_;
    nano::SampleFromVoxels<Accessor, 1, false> sampler_;
    nano::DefaultReadAccessor<nano::ValueMask> cells_;
    float low_[3], high_[3];
    int leaf_low_[3] = {1, 1, 1};  // no multiples of 8: nothing is entered yet
    const Leaf* leaf_ = nullptr;
    int empty_low_[3] = {0, 0, 0};
    int empty_edge_ = 0;  // 0: the node has cells with density
};

}  // namespace

void marchNano(const void* density, const void* cells, const NanoView& view, std::uint32_t x0,
               std::uint32_t x1, std::uint32_t y0, std::uint32_t y1, float* alpha) {
    Marcher marcher(*static_cast<const nano::NanoGrid<float>*>(density), *static_cast<const Cells*>(cells));
    for (std::uint32_t y = y0; y < y1; ++y)
        for (std::uint32_t x = x0; x < x1; ++x) {
            double index[3], index_length = 0, world_length = 0;
            for (int a = 0; a < 3; ++a) {
                index[a] = view.corner[a] + x * view.along_x[a] + y * view.along_y[a];
                const double world =
                    view.world_corner[a] + x * view.world_along_x[a] + y * view.world_along_y[a];
                index_length += index[a] * index[a];
                world_length += world * world;
            }
            index_length = std::sqrt(index_length);
            MarchRay ray;
            for (int a = 0; a < 3; ++a) {
                ray.origin[a] = float(view.origin[a]);
                ray.direction[a] = float(index[a] / index_length);
                ray.inverse[a] = 1 / ray.direction[a];
            }
            const double extinction =
                view.density_scale * view.step_voxels * std::sqrt(world_length) / index_length;
            const float sum =
                marcher.march(ray, float(view.step_voxels), float(-std::log(double(kOpaque)) / extinction));
            alpha[std::size_t(y) * view.width + x] = float(-std::expm1(-extinction * double(sum)));
        }
}

}  // namespace brickyard

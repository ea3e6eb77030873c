#include "tools/synth/cloud_field.h"

#include <algorithm>
#include <cmath>

#include "tools/synth/position_hash.h"

namespace brickyard {
namespace {

constexpr std::int32_t kBlockEdge = 128, kLeafEdge = 8;
// How much the two octaves of noise eat away, and the part of an ellipsoid that they leave on average
// (measured).
constexpr float kCoarse = 0.45f, kFine = 0.25f;
constexpr double kFilled = 0.5;

// Noise in a leaf: linear between random values at the corners of a cell of `period` voxels, which holds the
// leaf.
struct LeafNoise {
    std::array<float, 8> corner;  // x, y, z from the slowest
    std::array<float, 3> begin;
    float step;

    LeafNoise(std::uint64_t seed, const std::array<std::int32_t, 3>& origin, std::int32_t period)
        : step(1.0f / float(period)) {
        std::array<std::int64_t, 3> cell;
        for (std::size_t a = 0; a < 3; ++a) {
            cell[a] = origin[a] / period;
            begin[a] = float(origin[a] % period) * step;
        }
        for (std::size_t i = 0; i < 8; ++i)
            corner[i] = unitHash(seed, cell[0] + std::int64_t(i >> 2), cell[1] + std::int64_t(i >> 1 & 1),
                                 cell[2] + std::int64_t(i & 1));
    }
    // Value and slope along z of the row (x, y).
    std::pair<float, float> row(std::int32_t x, std::int32_t y) const {
        const float tx = begin[0] + float(x) * step, ty = begin[1] + float(y) * step;
        const auto plane = [&](std::size_t z) {
            const float low = corner[z] + tx * (corner[4 + z] - corner[z]);
            const float high = corner[2 + z] + tx * (corner[6 + z] - corner[2 + z]);
            return low + ty * (high - low);
        };
        const float near = plane(0), far = plane(1);
        return {near + begin[2] * (far - near), step * (far - near)};
    }
};

}  // namespace

CloudField::CloudField(std::int64_t edge_voxels, std::uint64_t voxels, std::uint64_t seed) {
    const double edge = double(edge_voxels);
    // Large enough that a small cube holds what is asked, where it can.
    const double largest = std::min(320.0, 0.45 * edge), least = std::min(0.4 * largest, 120.0);
    double made = 0;
    for (std::int64_t i = 0; made < 1.05 * double(voxels) && i < (1 << 20); ++i) {
        const auto number = [&](std::int64_t what) { return double(unitHash(seed, i, what, 77)); };
        const double radius = least + number(0) * (largest - least);
        Cloud cloud{{}, {}, hashOf(seed, i, 9, 78)};
        double volume = 4.18879;
        for (std::size_t a = 0; a < 3; ++a) {
            const double r = radius * (a == 1 ? 0.6 : 0.7 + 0.3 * number(std::int64_t(1 + a)));
            cloud.radius[a] = float(r);
            // Whole voxels, and one away from the border.
            cloud.centre[a] =
                float(std::floor(r + 1 + number(std::int64_t(4 + a)) * std::max(0.0, edge - 2 * r - 2)));
            volume *= r;
        }
        made += kFilled * volume;
        clouds_.push_back(cloud);
    }
}

bool CloudField::touches(const Cloud& cloud, const std::array<std::int32_t, 3>& origin, float edge) const {
    // The nearest point of the box, in the ellipsoid's own unit.
    float square = 0;
    for (std::size_t a = 0; a < 3; ++a) {
        const float begin = float(origin[a]) - cloud.centre[a], end = begin + edge;
        const float d = (begin > 0 ? begin : end < 0 ? end : 0) / cloud.radius[a];
        square += d * d;
    }
    return square < 1;
}

std::vector<std::array<std::int32_t, 3>> CloudField::blocks() const {
    std::vector<std::array<std::int32_t, 3>> found;
    for (const Cloud& cloud : clouds_) {
        std::array<std::int32_t, 3> first, last, at;
        for (std::size_t a = 0; a < 3; ++a) {
            first[a] =
                std::int32_t(std::max(0.0f, cloud.centre[a] - cloud.radius[a])) / kBlockEdge * kBlockEdge;
            last[a] = std::int32_t(cloud.centre[a] + cloud.radius[a]);
        }
        for (at[0] = first[0]; at[0] <= last[0]; at[0] += kBlockEdge)
            for (at[1] = first[1]; at[1] <= last[1]; at[1] += kBlockEdge)
                for (at[2] = first[2]; at[2] <= last[2]; at[2] += kBlockEdge)
                    if (touches(cloud, at, kBlockEdge)) found.push_back(at);
    }
    std::ranges::sort(found);
    found.erase(std::unique(found.begin(), found.end()), found.end());
    return found;
}

// Raises `values` to the cloud's; false where it has nothing here.
bool CloudField::fillLeaf(const Cloud& cloud, const std::array<std::int32_t, 3>& origin,
                          std::array<float, 512>& values) const {
    const LeafNoise coarse(cloud.seed, origin, 32), fine(cloud.seed + 1, origin, kLeafEdge);
    float largest = 0;
    for (std::int32_t x = 0; x < kLeafEdge; ++x)
        for (std::int32_t y = 0; y < kLeafEdge; ++y) {
            const float dx = (float(origin[0] + x) - cloud.centre[0]) / cloud.radius[0],
                        dy = (float(origin[1] + y) - cloud.centre[1]) / cloud.radius[1];
            const auto [coarse_begin, coarse_slope] = coarse.row(x, y);
            const auto [fine_begin, fine_slope] = fine.row(x, y);
            const float row_begin = 1 - dx * dx - dy * dy - kCoarse * coarse_begin - kFine * fine_begin;
            const float row_slope = -kCoarse * coarse_slope - kFine * fine_slope;
            const float z_begin = (float(origin[2]) - cloud.centre[2]) / cloud.radius[2],
                        z_step = 1 / cloud.radius[2];
            float* const row = values.data() + (x * kLeafEdge + y) * kLeafEdge;
            for (std::int32_t z = 0; z < kLeafEdge; ++z) {
                const float dz = z_begin + float(z) * z_step;
                const float density = std::min(1.0f, 2 * (row_begin + row_slope * float(z) - dz * dz));
                row[z] = std::max(row[z], density);
                largest = std::max(largest, density);
            }
        }
    return largest > 0;
}

void CloudField::fill(const std::array<std::int32_t, 3>& block, bool with_values, LeafBlock& out) const {
    out.child_mask = {};
    out.value_masks.clear();
    out.values.clear();
    std::vector<const Cloud*> near;
    for (const Cloud& cloud : clouds_)
        if (touches(cloud, block, kBlockEdge)) near.push_back(&cloud);
    for (std::size_t leaf = 0; leaf < 4096; ++leaf) {
        const std::array<std::int32_t, 3> origin{block[0] + std::int32_t(leaf >> 8) * kLeafEdge,
                                                 block[1] + std::int32_t(leaf >> 4 & 15) * kLeafEdge,
                                                 block[2] + std::int32_t(leaf & 15) * kLeafEdge};
        std::array<float, 512> values{};
        bool any = false;
        for (const Cloud* cloud : near)
            if (touches(*cloud, origin, kLeafEdge)) any = fillLeaf(*cloud, origin, values) || any;
        if (!any) continue;
        out.child_mask[leaf >> 6] |= std::uint64_t(1) << (leaf & 63);
        auto& mask = out.value_masks.emplace_back();
        for (std::size_t i = 0; i < 512; ++i) {
            if (!(values[i] > 0)) continue;
            mask[i >> 6] |= std::uint64_t(1) << (i & 63);
            if (with_values) out.values.push_back(values[i]);
        }
    }
}

}  // namespace brickyard

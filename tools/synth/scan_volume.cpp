#include "tools/synth/scan_volume.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "tools/synth/position_hash.h"

namespace brickyard {
namespace {

// Knots of the smooth part per axis: at 2048 voxels one in 32.
constexpr std::int64_t kCells = 64, kKnots = kCells + 1;
// Densities, in the scanner's unit: what is below the first is air, above the second there is bone.
constexpr float kAir = 300, kBone = 1500;

}  // namespace

ScanVolume::ScanVolume(std::int64_t edge_voxels, std::uint64_t seed)
    : edge_(edge_voxels), seed_(seed), lattice_(std::size_t(kKnots * kKnots * kKnots)) {
    std::size_t at = 0;
    for (std::int64_t k = 0; k < kKnots; ++k)
        for (std::int64_t j = 0; j < kKnots; ++j)
            for (std::int64_t i = 0; i < kKnots; ++i, ++at) {
                const double x = 2.0 * double(i) / kCells - 1, y = 2.0 * double(j) / kCells - 1,
                             z = 2.0 * double(k) / kCells - 1;
                const double r = std::sqrt(1.4 * x * x + 1.2 * y * y + z * z);
                const double layers =
                    0.5 + 0.5 * std::sin(14 * r + 1.5 * std::sin(5 * x + 3 * z) * std::cos(4 * y));
                const double lumps = unitHash(seed ^ 0x51ab, i, j, k);
                // Steep from eight tenths of the edge on: an empty margin all round.
                const double margin = 14000 * std::max(0.0, r - 0.8);
                lattice_[at] = float(3000 * (0.85 - r) + 900 * layers + 500 * lumps - margin);
            }
}

std::uint64_t ScanVolume::slice(std::int64_t z, std::span<std::uint16_t> out) const {
    const double step = double(kCells) / double(edge_);
    const auto locate = [&](std::int64_t i) {
        const double at = double(i) * step;
        const auto cell = std::min<std::int64_t>(std::int64_t(at), kCells - 1);
        return std::pair(cell, float(at - double(cell)));
    };
    const auto [cell_z, tz] = locate(z);
    std::array<float, std::size_t(kKnots)> row;
    std::uint64_t nonzero = 0;
    for (std::int64_t y = 0; y < edge_; ++y) {
        const auto [cell_y, ty] = locate(y);
        const float* const knots = lattice_.data() + (cell_z * kKnots + cell_y) * kKnots;
        for (std::int64_t i = 0; i < kKnots; ++i) {
            const float low = knots[i] + ty * (knots[i + kKnots] - knots[i]);
            const float* const above = knots + kKnots * kKnots;
            const float high = above[i] + ty * (above[i + kKnots] - above[i]);
            row[std::size_t(i)] = low + tz * (high - low);
        }
        const std::uint32_t row_hash = std::uint32_t(hashOf(seed_, y, z, 0));
        std::uint16_t* const to = out.data() + y * edge_;
        std::uint32_t row_nonzero = 0;
        std::int64_t x = 0;
        for (std::int64_t cell = 0; cell < kCells && x < edge_; ++cell) {
            // The voxels of one cell: a line, which the compiler turns into vector code.
            std::int64_t end =
                std::min<std::int64_t>(edge_, std::int64_t(std::ceil(double(cell + 1) / step)));
            if (cell == kCells - 1) end = edge_;
            const float begin_value = row[std::size_t(cell)],
                        slope = row[std::size_t(cell) + 1] - begin_value;
            const float offset = float(double(x) * step - double(cell)), slope_step = slope * float(step);
            const float base = begin_value + slope * offset;
            for (std::int64_t i = 0, n = end - x; i < n; ++i) {
                std::uint32_t noise = (std::uint32_t(x + i) * 0x9e3779b1u) ^ row_hash;
                noise ^= noise >> 15;
                noise *= 0x85ebca77u;
                noise ^= noise >> 13;
                // The sum of two uniform numbers: nearly what a scanner's noise is.
                const float grain = float(std::int32_t(noise & 63) + std::int32_t(noise >> 8 & 63) - 63);
                const float smooth = base + slope_step * float(std::int32_t(i));
                const float value = smooth + (smooth > kBone ? 900.0f : 0.0f) + grain;
                const std::uint16_t voxel =
                    smooth > kAir ? std::uint16_t(std::int32_t(value)) : std::uint16_t(0);
                row_nonzero += voxel != 0;
                to[x + i] = voxel;
            }
            x = end;
        }
        nonzero += row_nonzero;
    }
    return nonzero;
}

}  // namespace brickyard

// A volume as a CT scanner might make it, of any size: layered, smooth structures with noise in air that is
// exactly 0. A slice costs a few operations per voxel, so that writing is what takes the time. Any thread.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace brickyard {

class ScanVolume {
public:
    // REQUIRES: edge_voxels in [1, 65536].
    ScanVolume(std::int64_t edge_voxels, std::uint64_t seed);
    // The voxels of one plane of z, x fastest. REQUIRES: `out` has edge_voxels^2. Returns how many are not 0.
    std::uint64_t slice(std::int64_t z, std::span<std::uint16_t> out) const;

private:
    std::int64_t edge_;
    std::uint64_t seed_;
    std::vector<float> lattice_;  // kKnots^3 knots of the smooth part, x fastest
};

}  // namespace brickyard

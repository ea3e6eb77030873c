// `brickyard verify --against`: a dataset compared with the files that it was made of, voxel by voxel, and
// OpenVDB files at random points with OpenVDB's own sampler as well.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "core/octree_builder.h"
#include "core/result.h"
#include "tools/importers/input_file.h"

namespace brickyard {

// The place where stored and source differ most.
struct WorstVoxel {
    std::uint32_t frame = 0;
    std::string channel;
    std::int64_t x = 0, y = 0, z = 0;
    int component = 0;
    double stored = 0, source = 0, deviation = -1;
};

struct SourceReport {
    std::uint64_t frames = 0, channels = 0;
    std::uint64_t voxels = 0;   // compared one by one; regions of one value count as one each
    std::uint64_t regions = 0;  // of one value, compared at once
    std::uint64_t points = 0;   // compared with OpenVDB's sampler
    double worst_point = 0;     // largest deviation there
    WorstVoxel worst;           // deviation < 0: nothing compared
    std::vector<WorstVoxel>
        worst_of_channels;            // each over all frames; channels of which anything was compared
    std::vector<std::string> faults;  // one line each, at most kMaxFaults
    std::uint64_t fault_count = 0;
};
inline constexpr std::size_t kMaxFaults = 100;

// `reading`: as for openInput; the channels are the dataset's. Errors: those of reading either side;
// kNotFound where the files make a frame or channel that the dataset lacks.
Result<SourceReport> checkAgainst(const std::filesystem::path& dataset,
                                  const std::vector<std::string>& inputs, const ParallelFor& parallel_for,
                                  std::uint64_t points_per_channel = 100'000,
                                  const InputOptions& reading = {});

}  // namespace brickyard

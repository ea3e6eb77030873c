// `brickyard verify`: reads every byte of a dataset and says which of them are not what was written.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "core/octree_builder.h"

namespace brickyard {

// One thing that is wrong. Empty and zero where it does not apply.
struct CheckFault {
    std::string file;
    std::string channel;
    std::string node;                  // "L0(1,2,3)"
    std::uint64_t begin = 0, end = 0;  // bytes of the file
    std::string message;               // one line, complete by itself
};

struct CheckReport {
    std::uint64_t frames = 0, channels = 0, blocks = 0, bricks = 0, bytes = 0;
    std::vector<CheckFault> faults;
};

// Manifest, footers, tree blocks, payloads (checksum and full decoding), and that these together are the
// whole of each file: a flipped bit anywhere is found. `progress` is told frames done, of how many; it may be
// empty.
CheckReport checkDataset(
    const std::filesystem::path& folder, const ParallelFor& parallel_for,
    const std::function<void(std::size_t done, std::size_t total, std::uint64_t bytes)>& progress);

}  // namespace brickyard

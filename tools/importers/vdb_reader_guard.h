// Reading .vdb files that may be broken or hostile. libopenvdb believes the lengths in a file: it may crash,
// hang, or take tens of gigabytes. So a file is first read by a child process under limits, and only then by
// us.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "core/result.h"

namespace brickyard {

struct VdbLimits {
    std::uint64_t memory_bytes = 0;  // address space beyond what the child starts with; 0: by the file's size
    std::chrono::seconds cpu_time{0};  // 0: by the file's size
};

// The name of the subcommand that does the child's work.
inline constexpr const char* kProbeCommand = "probe-vdb";

// The file's outer shape, checked without OpenVDB: magic, version, lengths of names and metadata, and that
// every grid ends inside the file. Errors: kNotFound, kIo, kCorrupt, kTooNew, kUnsupported (older than 2012).
Result<void> checkVdbShape(const std::filesystem::path& file);

// checkVdbShape, then a full read (as readVdb does it) in a child: `program` probe-vdb FILE. `program` is the
// brickyard command; empty means this very program. Errors: those of readVdb; kCorrupt (it crashed or hung
// the reader), kIo (memory).
Result<void> checkVdb(const std::filesystem::path& file, const std::vector<std::string>& channels,
                      const VdbLimits& limits, const std::filesystem::path& program = {});

// The child: sets its own limits, reads, writes the verdict to stdout. Gives the exit status.
int runVdbProbe(const std::filesystem::path& file, const std::vector<std::string>& channels,
                const VdbLimits& limits);

}  // namespace brickyard

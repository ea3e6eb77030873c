// Which input files make which frame. Looks at names and at what exists; opens nothing.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/result.h"

namespace brickyard {

struct FrameInputs {
    std::uint32_t frame = 0;
    std::vector<std::filesystem::path> files;  // in the order they were named
};

// The last run of digits in a file name without its extension: plume.0018.vdb is 18. Nothing where there is
// none, or where it has more than 9 digits (a date or an identifier, not a frame).
std::optional<std::uint32_t> frameNumber(const std::filesystem::path& file);

// The files that `inputs` name; one that does not exist but has *, ? or [ in it is a pattern. A pattern's
// files come in the order of their names. Errors: kNotFound.
Result<std::vector<std::filesystem::path>> expandInputs(const std::vector<std::string>& inputs);

// Groups files by frame number, rising; those without a number count 0, 1, 2 ... in order.
std::vector<FrameInputs> planFrames(const std::vector<std::filesystem::path>& files);

}  // namespace brickyard

// A plane of a channel as a picture: one pixel a sample, nothing between them invented.
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>

#include "tools/field_reader.h"

namespace brickyard {

struct SliceRequest {
    int axis = 2;               // the plane stands across it
    std::int64_t position = 0;  // along it, in voxels of level 0
    std::optional<int> level;   // none: the finest with at most kSlicePixels along either edge
    std::optional<std::array<double, 2>> range;  // black and white; none: the channel's range
};
inline constexpr std::int64_t kSlicePixels = 2048;

struct SliceReport {
    int level = 0;
    std::int64_t width = 0, height = 0;
    IndexBox box;  // of that level
    std::array<double, 2> range{};
    bool diverging = false;  // blue below zero, red above; else grey
};

// "z=40". Errors: kInvalid.
Result<SliceRequest> parseSlice(const std::string& text);

// Writes an 8-bit PNG of the active voxels' box: of a z slice x points right and y up, of a y slice x right
// and z up, of an x slice y right and z up. Vectors show their length. Values that have both signs are drawn
// from blue over white at zero to red, others from black to white. Errors: those of FieldReader; kInvalid
// (the plane misses the box; more than 2^26 pixels); kIo.
Result<SliceReport> writeSlice(const FieldReader& reader, const SliceRequest& request,
                               const std::filesystem::path& file);

}  // namespace brickyard

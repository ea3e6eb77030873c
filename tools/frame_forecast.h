// What a frame would take, from some of its bricks: they are built as they would be, into memory. Nothing is
// written to a disk.
#pragma once

#include <span>

#include "core/octree_builder.h"

namespace brickyard {

struct FrameForecast {
    double bytes = 0, seconds = 0;  // of building all of the frame; reading the file is not in it
    double sampled = 0;             // share of the regions that were built, in [0, 1]
};

// Takes some dozens of regions of 4^3 bricks of each channel, chosen by chance but the same each time.
// Errors: those of buildFrame.
Result<FrameForecast> forecastFrame(std::span<const FieldSource* const> channels,
                                    std::span<const BuildOptions> options);

}  // namespace brickyard

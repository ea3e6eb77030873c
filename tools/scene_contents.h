// What the channels of a frame are likely to be, from their names, classes and types. Pure functions, any
// thread.
#pragma once

#include <cstdint>
#include <optional>

#include "proto/dataset.pb.h"

namespace brickyard {

// Indices in FrameFooter.channels; only of what has active voxels.
struct SceneContents {
    std::optional<std::uint32_t> density, flame, temperature;
    std::optional<std::uint32_t> level_set;
    std::optional<std::uint32_t> scan;      // a dense box of measured values
    std::optional<std::uint32_t> velocity;  // three components
    std::optional<std::uint32_t> color;     // three components
    bool burned_out = false;                // there is a channel for flames, and nothing in it
};

SceneContents sceneContents(const FrameFooter& frame);

}  // namespace brickyard

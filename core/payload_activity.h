// Active states that a payload keeps without a bit: a voxel is active where its bits differ from the
// background's.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/brick_shape.h"
#include "core/sample_type.h"

namespace brickyard {

// One byte per owned voxel, x fastest: 1 where the bits of any component differ from `background`. Bits are
// compared, not numbers: -0.0 is not 0.0 here, and a NaN equals itself. `values` as BrickToEncode::values.
std::vector<std::uint8_t> statesByBackground(std::span<const std::byte> values, BrickShape shape,
                                             SampleType type, int components,
                                             std::span<const ValueBits> background);

}  // namespace brickyard

// Receives the voxels of one level of one channel: a file's writer, a dense array, a histogram. Positions are
// those of the level's own lattice. Not thread-safe.
#pragma once

#include <cstdint>
#include <functional>
#include <span>

#include "core/index_box.h"
#include "core/result.h"
#include "core/sample_type.h"

namespace brickyard {

class VoxelSink {
public:
    virtual ~VoxelSink() = default;
    // A box of one value (a component each) and one state.
    virtual void fill(const IndexBox& box, std::span<const ValueBits> value, bool active) = 0;
    // The voxels of `part`, a box inside `box`. `values` and `active` are those of all of `box`: planar, x
    // fastest, one state byte each.
    virtual void copy(const IndexBox& box, const IndexBox& part, std::span<const std::byte> values,
                      std::span<const std::uint8_t> active) = 0;
};

// Puts the voxels of one channel into `sink`, each at most once, in any order.
using VoxelFiller = std::function<Result<void>(VoxelSink& sink)>;

}  // namespace brickyard

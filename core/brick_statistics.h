// What a brick's samples say of it before it is encoded. Pure functions, any thread.
#pragma once

#include <cstdint>
#include <span>

#include "core/brick_shape.h"
#include "core/sample_cube.h"
#include "core/tree_block.h"

namespace brickyard {

// Range of one component's (N + 1)^3 samples, and the tight box of cells that have a corner other than
// `background`, both added to `record` (`first`: nothing is there yet). Gives the range of the owned samples,
// [0, N)^3. T: float, double, std::int32_t, std::int64_t, std::uint8_t.
struct OwnedRange {
    double min = 0, max = 0;
};
template <class T>
OwnedRange describeSamples(SampleCube<T> samples, BrickShape shape, double background, bool first,
                           NodeRecord& record);

// Whether all (N + 1)^3 samples have the same bits.
template <class T>
bool oneValue(SampleCube<T> samples, BrickShape shape);

// The range of the owned samples, [0, N)^3, that are active. `any` is set where there is one, and tells
// whether `min` and `max` hold something already.
template <class T>
void includeActive(SampleCube<T> samples, SampleCube<std::uint8_t> active, BrickShape shape, bool& any,
                   double& min, double& max);

// Active voxels among the owned, and their box, [begin, end) in voxels of the brick.
struct ActiveVoxels {
    std::size_t count = 0;
    std::array<int, 3> begin{}, end{};
};
ActiveVoxels countActive(SampleCube<std::uint8_t> active, BrickShape shape);

}  // namespace brickyard

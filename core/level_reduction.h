// One level from the level below: full weighting (1/4, 1/2, 1/4 per axis), which keeps the integral and so
// optical depth (Briggs, Henson, McCormick, A Multigrid Tutorial, 2000). Pure functions, any thread.
#pragma once

#include <array>
#include <cstddef>

#include "core/sample_cube.h"

namespace brickyard {

// Samples to write, as SampleCube reads them.
struct SampleTarget {
    double* first = nullptr;
    std::size_t row = 0, plane = 0;
};

// `coarse` gets `extent` samples per axis of `fine`, which has 2 extent + 1: one more on every side than lie
// under the coarse ones. A coarse sample depends on the 27 around it alone: whoever computes it gets the same
// bits. T: float, double, std::int32_t, std::int64_t, std::uint8_t.
template <class T>
void reduceLevel(SampleCube<T> fine, const std::array<std::size_t, 3>& extent, SampleTarget coarse);

// Root mean square of what the step loses over a node's closed region: the (N + 1)^3 samples `coarse`,
// interpolated, less the (2N + 1)^3 samples `fine`. `scale` keeps squares in range.
template <class T>
double reductionRms(SampleCube<T> fine, SampleCube<double> coarse, int edge_cells, double scale);

}  // namespace brickyard

// One step of the level pyramid: full weighting, (1/4, 1/2, 1/4) per axis, which keeps the integral of the
// field and so the optical depth through it. Pure functions, any thread.
#pragma once

#include <span>
#include <vector>

namespace brickyard {

// `fine` has (2N + 3)^3 samples, x fastest, of the level below: from one before the node's first sample to
// one behind its last. Gives the node's (N + 1)^3 samples. Two nodes that share a face get the same bits on
// it.
std::vector<double> reduceLevel(std::span<const double> fine, int edge_cells);

// Root mean square of what the step loses: the (N + 1)^3 samples `coarse`, interpolated, less `fine` (as
// above) over the node's closed region.
double reductionRms(std::span<const double> fine, std::span<const double> coarse, int edge_cells,
                    double scale);

}  // namespace brickyard

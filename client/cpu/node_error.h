// What a node's stored errors say of an integral through it. Pure functions, any thread.
// docs/error-bounds.md.
#pragma once

#include "client/paged_channel.h"

namespace brickyard {

// Square of the effective deviation, rms^0.6 * bound^0.4: deviations have heavy tails, and a ray that grazes
// the busy corner of a sub-box sees more than its mean. Measured in docs/decisions/0002-error-estimate.md.
double effectiveSquare(double rms, double bound);
// The same from the codes of an error grid, for a scale of 1.
double effectiveSquareOfCodes(std::uint8_t rms, std::uint8_t bound);
// Voxels over which the errors of a quantised leaf (a node without an error grid) go together: where the
// field is smooth, neighbours round the same way.
inline constexpr double kLeafCorrelation = 4;

// A node's errors by sub-box of its error grid, x fastest: along a ray, the integral over a stretch is off by
// `bound_scale` x bound[i] x length at most; its expected error has the variance `square_scale` x square[i] x
// length x one voxel of the level. Scales are in the channel's unit (squared), the rest is relative: any
// magnitude fits.
struct NodeErrors {
    double bound_scale = 0, square_scale = 0;  // 0: exact
    bool uniform = true;                       // the same everywhere: 1 in each sub-box
    float bound[kErrorGridCells];
    float square[kErrorGridCells];

    bool exact() const { return bound_scale == 0; }
};
// What the mean square of a node's deviation must be multiplied with for rays, which see the medium's box
// only: its volume over that of what it shares with the box, where the medium is a speck in it; else 1, which
// the error grid allows for.
double speckFactor(const PagedChannel& channel, const NodeKey& key);

// Mean square of a node's effective deviation, as rays see it.
double squareOfNode(const PagedChannel& channel, const NodeKey& key, const NodeRecord& record);

NodeErrors errorsOfNode(const NodeRecord& record, const ErrorGrid* grid);
NodeErrors errorsOfDraft(const NodeRecord& record);

}  // namespace brickyard

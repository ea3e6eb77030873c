// What one unit of a velocity channel means, found from two frames: solvers store cells, metres or domain
// widths, a frame, a step or a second. Pure functions, any thread.
#pragma once

#include "tools/sampled_field.h"

namespace brickyard {

struct VelocityFit {
    double scale = 0;      // world units a frame per unit of the channel
    double explained = 0;  // share of the change from frame to frame that the motion accounts for, at most 1
};

struct MovingFrame {
    const SampledField& density;
    const SampledField& velocity;  // three components
};

// The scale whose motion best takes the density of a frame to the next one's, least squares. What has come to
// x has travelled scale * the mean of the velocities there and where it left: the trapezoidal rule, which on
// a turbulent plume explains half as much again as the velocity of one end. Scales from a tenth of a sample
// to a fifth of the box are tried. All 0 where nothing moves.
VelocityFit fitVelocityScale(const MovingFrame& frame, const MovingFrame& next);

}  // namespace brickyard

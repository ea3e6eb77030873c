// Roots of a cubic in [0, 1]: what the field along a ray through a trilinear cell is. Pure functions, any
// thread.
//
// Split at the extrema, then Newton's method kept within a bracket: Marmitt et al. Fast and Accurate
// Ray-Voxel Intersection Techniques for Iso-Surface Ray Tracing. 2004; Hansson-Soderlund, Evans and
// Akenine-Moller. Ray Tracing of Signed Distance Function Grids. JCGT 2022. Cubics are kept as Bernstein
// control points: both ends are exact, and control points of one sign have no root between them.
#pragma once

#include <array>

namespace brickyard {

struct Cubic {
    std::array<double, 4> control{};  // at(0) is the first, at(1) the last, exactly

    // c0 + c1 s + c2 s^2 + c3 s^3.
    static Cubic fromPowers(double c0, double c1, double c2, double c3);
    // With these values at 0, 1/3, 2/3 and 1.
    static Cubic through(double v0, double v1, double v2, double v3);
    // de Casteljau's way: weighted means only, so the rounding is that of the control points.
    double at(double s) const {
        const double r = 1 - s;
        const double b01 = r * control[0] + s * control[1], b12 = r * control[1] + s * control[2];
        const double b23 = r * control[2] + s * control[3];
        return r * (r * b01 + s * b12) + s * (r * b12 + s * b23);
    }
};

struct CubicRoots {
    int count = 0;
    std::array<double, 3> at{};  // rising
};

// Where the cubic goes from positive to not positive, or back. The count is odd exactly where the first and
// the last control point are on different sides: no rounding can lose or double a crossing of the whole
// interval. A pair of roots that rounding cannot tell from a touch may be missed or found, always both.
CubicRoots signChanges(const Cubic& cubic);

// All roots, touches included: a value within rounding (a few ulps of the largest control point) of 0 at an
// end or an extremum counts as 0 there, so two roots within about 1e-7 of each other may be told as one.
// Where the cubic is 0 everywhere, the root is 0.
CubicRoots realRoots(const Cubic& cubic);

}  // namespace brickyard

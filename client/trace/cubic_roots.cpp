#include "client/trace/cubic_roots.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace brickyard {

namespace {

constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

double largest(const Cubic& cubic) {
    double most = 0;
    for (double b : cubic.control) most = std::max(most, std::abs(b));
    return most;
}

// Products of control points must neither overflow nor vanish. A power of two, so nothing is rounded but what
// vanishes beside the largest.
Cubic scaled(const Cubic& cubic) {
    const double most = largest(cubic);
    if (most == 0 || (most > 1e-90 && most < 1e90)) return cubic;
    int exponent = 0;
    std::frexp(most, &exponent);
    Cubic out;
    for (std::size_t i = 0; i < 4; ++i) out.control[i] = std::ldexp(cubic.control[i], -exponent);
    return out;
}

double slope(const Cubic& cubic, double s) {
    const auto& b = cubic.control;
    const double r = 1 - s;
    return 3 * (r * (r * (b[1] - b[0]) + s * (b[2] - b[1])) + s * (r * (b[2] - b[1]) + s * (b[3] - b[2])));
}

// 0, the extrema between, 1: the cubic is monotone from one to the next. An extremum that is off by the
// square root of a rounding changes the value there by a rounding.
int monotoneKnots(const Cubic& cubic, double (&knots)[4]) {
    const auto& b = cubic.control;
    const double q0 = b[1] - b[0], q1 = b[2] - b[1], q2 = b[3] - b[2];
    knots[0] = 0;
    int count = 1;
    const double discriminant = q1 * q1 - q0 * q2;
    if (discriminant > 0) {
        // (q0 - 2 q1 + q2) s^2 + 2 (q1 - q0) s + q0, without cancellation where a coefficient vanishes.
        const double half = q1 - q0, square = q2 - q1 - half;
        const double sum = -(half + std::copysign(std::sqrt(discriminant), half));
        double extrema[2] = {square != 0 ? sum / square : -1, sum != 0 ? q0 / sum : -1};
        if (extrema[0] > extrema[1]) std::swap(extrema[0], extrema[1]);
        for (double s : extrema)
            if (s > 0 && s < 1) knots[count++] = s;
    }
    knots[count++] = 1;
    return count;
}

// The one change of side in (low, high]. Newton's steps from inside the bracket; whatever would leave it, or
// gets on slowly, is a bisection instead.
double changeBetween(const Cubic& cubic, double low, double high, bool positive_at_low) {
    double s = 0.5 * (low + high);
    double before = high - low;
    // Each step is at most half as long as the one before it, or halves the bracket.
    for (int round = 0; round < 120 && low < high; ++round) {
        const double value = cubic.at(s);
        if (value == 0) return s;
        if ((value > 0) == positive_at_low)
            low = s;
        else
            high = s;
        const double step = value / slope(cubic, s);
        double next = s - step;
        // A NaN fails the comparisons too.
        if (!(next > low && next < high) || !(std::abs(step) < 0.5 * before)) next = 0.5 * (low + high);
        before = std::abs(next - s);
        if (before <= 0.25 * kEpsilon || next == s) return next;
        s = next;
    }
    return s;
}

}  // namespace

Cubic Cubic::fromPowers(double c0, double c1, double c2, double c3) {
    return {{c0, c0 + c1 / 3, c0 + (2 * c1 + c2) / 3, c0 + c1 + c2 + c3}};
}

Cubic Cubic::through(double v0, double v1, double v2, double v3) {
    return {{v0, (-5 * v0 + 18 * v1 - 9 * v2 + 2 * v3) / 6, (2 * v0 - 9 * v1 + 18 * v2 - 5 * v3) / 6, v3}};
}

CubicRoots signChanges(const Cubic& given) {
    CubicRoots roots;
    const bool first = given.control[0] > 0, last = given.control[3] > 0;
    int changes = 0;
    for (std::size_t i = 0; i < 3; ++i) changes += (given.control[i] > 0) != (given.control[i + 1] > 0);
    if (changes == 0) return roots;
    const Cubic cubic = scaled(given);
    // Descartes' rule: one change among the control points is one root.
    if (changes == 1) {
        roots.at[std::size_t(roots.count++)] = changeBetween(cubic, 0, 1, first);
        return roots;
    }
    double knots[4];
    const int count = monotoneKnots(cubic, knots);
    bool side = first;
    for (int i = 1; i < count; ++i) {
        // The ends' sides are those of the control points, so the last piece ends where the cubic does.
        const bool next = i + 1 == count ? last : cubic.at(knots[i]) > 0;
        if (next == side) continue;
        roots.at[std::size_t(roots.count++)] = changeBetween(cubic, knots[i - 1], knots[i], side);
        side = next;
    }
    return roots;
}

CubicRoots realRoots(const Cubic& given) {
    CubicRoots roots;
    const Cubic cubic = scaled(given);
    const double zero = 4 * kEpsilon * largest(cubic);
    if (zero == 0) return {1, {}};
    double knots[4];
    const int count = monotoneKnots(cubic, knots);
    auto add = [&](double s) {
        if (roots.count < 3) roots.at[std::size_t(roots.count++)] = s;
    };
    double before = cubic.at(knots[0]);
    if (std::abs(before) <= zero) add(knots[0]);
    for (int i = 1; i < count; ++i) {
        const double value = cubic.at(knots[i]);
        if (std::abs(value) <= zero)
            add(knots[i]);
        else if (std::abs(before) > zero && (before > 0) != (value > 0))
            add(changeBetween(cubic, knots[i - 1], knots[i], before > 0));
        before = value;
    }
    return roots;
}

}  // namespace brickyard

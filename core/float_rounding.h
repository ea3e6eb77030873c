// Doubles as floats that bound them. Values beyond the float range saturate at the largest finite float: a
// file never holds an infinity (docs/format.md says what a saturated bound means). Pure, any thread.
#pragma once

#include <cmath>
#include <limits>

namespace brickyard {

inline float roundUp(double value) {
    constexpr float kMost = std::numeric_limits<float>::max();
    if (value >= double(kMost)) return kMost;
    if (value <= -double(kMost)) return -kMost;
    const float nearest = float(value);
    return double(nearest) >= value ? nearest : std::nextafter(nearest, kMost);
}

inline float roundDown(double value) { return -roundUp(-value); }

}  // namespace brickyard

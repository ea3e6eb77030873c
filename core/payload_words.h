// From stored words to samples, one function for each encoding, without branches. The encoder measures its
// error with the very functions that the decoder runs.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "core/half.h"

namespace brickyard {

// A quantised sample in double precision; the sum is exact, the product is rounded once.
template <class W>
inline double dequantised(W q, double step, double base) {
    return step * (base + double(q));
}

// The nearest float of a finite or infinite value, within the finite range; 0 for NaN.
inline float rendererFloat(double value) {
    constexpr double kMax = std::numeric_limits<float>::max();
    value = value == value ? value : 0;
    value = value > kMax ? kMax : value;
    return float(value < -kMax ? -kMax : value);
}
inline float rendererFloat(float value) {
    constexpr float kMax = std::numeric_limits<float>::max();
    value = value == value ? value : 0;
    value = value > kMax ? kMax : value;
    return value < -kMax ? -kMax : value;
}

// The number that a lossless word of this width means: binary16, binary32 or binary64, in ordered form.
inline float numberFromOrdered(std::uint16_t word) { return floatFromHalf(bitsFromOrdered(word)); }
inline float numberFromOrdered(std::uint32_t word) { return std::bit_cast<float>(bitsFromOrdered(word)); }
inline double numberFromOrdered(std::uint64_t word) { return std::bit_cast<double>(bitsFromOrdered(word)); }

}  // namespace brickyard

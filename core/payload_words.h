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

// The word of width W that a draft's sample predicts: its nearest number of that width, in ordered form.
// REQUIRES: a finite value; one beyond the finite range of a narrower width saturates. Part of the format:
// writer and reader must agree to the last bit.
template <class W, class T>
inline W orderedFromDraft(T value) {
    static_assert(sizeof(W) >= 2 && sizeof(W) <= sizeof(T));
    if constexpr (sizeof(W) == sizeof(T)) return orderedFromBits(std::bit_cast<W>(value));
    if constexpr (sizeof(W) == 4) return orderedFromBits(std::bit_cast<std::uint32_t>(rendererFloat(value)));
    if constexpr (sizeof(W) == 2 && sizeof(T) == 4) return orderedFromBits(nearestHalf(value));
    if constexpr (sizeof(W) == 2 && sizeof(T) == 8) return orderedFromBits(nearestHalf(rendererFloat(value)));
}

}  // namespace brickyard

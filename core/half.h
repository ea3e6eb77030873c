// IEEE binary16 and the order-preserving integer form of IEEE numbers, bit by bit and without branches: the
// loops that use them vectorise. Every function here is exact.
#pragma once

#include <bit>
#include <cstdint>
#include <limits>

namespace brickyard {

// Integer that sorts as the number does: neighbouring numbers have neighbouring integers, so differences stay
// small. A bijection of all bit patterns, NaNs, denormals and -0.0 included.
template <class W>
constexpr W orderedFromBits(W bits) {
    constexpr W kTop = W(W(1) << (std::numeric_limits<W>::digits - 1));
    const W negative = W(0 - W(bits >> (std::numeric_limits<W>::digits - 1)));
    return W(bits ^ (negative | kTop));
}
template <class W>
constexpr W bitsFromOrdered(W ordered) {
    constexpr W kTop = W(W(1) << (std::numeric_limits<W>::digits - 1));
    const W positive = W(0 - W(ordered >> (std::numeric_limits<W>::digits - 1)));
    return W(ordered ^ (W(~positive) | kTop));
}

// REQUIRES: a finite half, (half & 0x7fff) < 0x7c00.
inline float floatFromHalf(std::uint16_t half) {
    const std::uint32_t magnitude = half & 0x7fffu, sign = std::uint32_t(half & 0x8000u) << 16;
    const std::uint32_t normal = (magnitude << 13) + (112u << 23);
    // A denormal half counts multiples of 2^-24, each of which is a normal float.
    const std::uint32_t denormal = std::bit_cast<std::uint32_t>(float(std::int32_t(magnitude)) * 0x1p-24f);
    return std::bit_cast<float>(sign | (magnitude < 0x400u ? denormal : normal));
}

// The half that is exactly `value`, where isHalf(value); otherwise something.
inline std::uint16_t halfFromFloat(float value) {
    const std::uint32_t bits = std::bit_cast<std::uint32_t>(value), magnitude = bits & 0x7fffffffu;
    const std::uint32_t normal = (magnitude - (112u << 23)) >> 13;
    // Below 2^-14. The others are replaced first, so that the conversion is defined for them as well.
    const bool small = magnitude < (113u << 23);
    const float scaled = small ? std::bit_cast<float>(magnitude) * 0x1p24f : 0.0f;
    const auto denormal = std::uint32_t(std::int32_t(scaled));
    return std::uint16_t((bits >> 16 & 0x8000u) | ((small ? denormal : normal) & 0x7fffu));
}

// The nearest half, ties to even, within the finite range. REQUIRES: not NaN.
inline std::uint16_t nearestHalf(float value) {
    constexpr std::uint32_t kLargest = 0x477fe000u;  // 65504
    const std::uint32_t bits = std::bit_cast<std::uint32_t>(value), sign = bits >> 16 & 0x8000u;
    std::uint32_t magnitude = bits & 0x7fffffffu;
    magnitude = magnitude > kLargest ? kLargest : magnitude;
    // Half of what is cut off, less one where the kept part is even: a carry goes into the exponent, as it
    // should.
    const std::uint32_t normal = (magnitude + 0xfffu + (magnitude >> 13 & 1u) - (112u << 23)) >> 13;
    // Below 2^-14, multiples of 2^-24 are kept; floats near 2^23 are one apart.
    const float scaled = std::bit_cast<float>(magnitude) * 0x1p24f + 0x1p23f;
    const std::uint32_t denormal = std::bit_cast<std::uint32_t>(scaled) & 0x7fffu;
    return std::uint16_t(sign | (magnitude < (113u << 23) ? denormal : normal));
}

// Whether a finite half has exactly these bits as a float.
inline bool isHalf(float value) {
    const std::uint32_t bits = std::bit_cast<std::uint32_t>(value);
    // From 2^16 on, infinity and NaN included, there is no half.
    return bool(int((bits & 0x7fffffffu) < (143u << 23)) &
                int(std::bit_cast<std::uint32_t>(floatFromHalf(halfFromFloat(value))) == bits));
}

}  // namespace brickyard

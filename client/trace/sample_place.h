// Where the rays of a pixel go: evenly over the pixel and over the shutter. Pure functions, any thread.
#pragma once

#include <cmath>
#include <cstdint>
#include <numeric>

namespace brickyard {

struct SamplePlace {
    double x = 0.5, y = 0.5;  // in the pixel, [0, 1)
    double time = 0.5;        // of the shutter, [0, 1)
};

// Sample `index` of `count`. A square number is a grid, as with `--samples`: what is off to one side cancels
// what is off to the other. Others are points of a Fibonacci lattice. Moments are one to each part of the
// shutter, in an order that differs from pixel to pixel (`pixel_bits`).
inline SamplePlace samplePlace(std::uint32_t index, std::uint32_t count, std::uint64_t pixel_bits) {
    if (count <= 1) return {};
    SamplePlace place;
    const auto edge = std::uint32_t(std::lround(std::sqrt(double(count))));
    if (edge * edge == count) {
        place.x = (index % edge + 0.5) / edge;
        place.y = (index / edge + 0.5) / edge;
    } else {
        constexpr double kGolden = 0.61803398874989484820;
        // Moved so that the mean is the middle.
        const double turn = kGolden * (index - 0.5 * (count - 1)) + 0.5;
        place.x = (index + 0.5) / count;
        place.y = turn - std::floor(turn);
    }
    // A stride without a common divisor visits every part once.
    std::uint32_t stride = std::uint32_t(double(count) * 0.38196601125) | 1u;
    while (std::gcd(stride, count) != 1) ++stride;
    const std::uint64_t part = (std::uint64_t(index) * stride + pixel_bits % count) % count;
    place.time = (double(part) + 0.5) / count;
    return place;
}

}  // namespace brickyard

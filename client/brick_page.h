// What a page of the cache holds: the (N + 1)^3 samples of a brick, x fastest, component by component, and
// behind them, of a scalar channel, one float more, the brick's steepness. Pure functions, any thread.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>

#include "core/brick_shape.h"

namespace brickyard {

inline std::size_t pageFloats(BrickShape shape, int components = 1) {
    return shape.samples() * std::size_t(components) + 1;
}

// Largest difference of neighbouring samples along each axis, added up: the trilinear field changes by no
// more than this times the distance in cells.
inline float steepnessOf(std::span<const float> samples, BrickShape shape) {
    const std::size_t edge = std::size_t(shape.edgeSamples());
    float most[3] = {};
    const std::size_t strides[3] = {1, edge, edge * edge};
    for (std::size_t z = 0; z < edge; ++z)
        for (std::size_t y = 0; y < edge; ++y)
            for (std::size_t x = 0; x < edge; ++x) {
                const std::size_t place[3] = {x, y, z}, at = x + edge * (y + edge * z);
                for (int a = 0; a < 3; ++a)
                    if (place[a] + 1 < edge)
                        most[a] = std::max(most[a], std::abs(samples[at + strides[a]] - samples[at]));
            }
    return most[0] + most[1] + most[2];
}

inline float steepnessOfPage(const float* page, BrickShape shape) { return page[shape.samples()]; }

}  // namespace brickyard

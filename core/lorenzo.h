// The 3-D Lorenzo predictor (Ibarria et al., Out-of-core compression and decompression of large n-dimensional
// scalar fields, 2003) in modular arithmetic: a sample less its prediction from the seven samples before it
// is the difference along x, then y, then z. Samples outside the brick count as 0. Lossless at any width,
// because it never leaves it.
#pragma once

#include <cstddef>
#include <limits>
#include <type_traits>

namespace brickyard {

// Differences of 0, -1, 1, -2, 2 ... become 0, 1, 2, 3, 4 ...: high bytes of small ones are zero whatever
// their sign.
template <class W>
constexpr W zigzag(W difference) {
    const W negative = W(0 - W(difference >> (std::numeric_limits<W>::digits - 1)));
    return W(W(difference << 1) ^ negative);
}
template <class W>
constexpr W unzigzag(W code) {
    return W(W(code >> 1) ^ W(0 - W(code & 1)));
}

// Replaces the `edge`^3 samples, x fastest, by their residuals, zigzagged.
template <class W>
void subtractPrediction(W* samples, std::size_t edge) {
    static_assert(std::is_unsigned_v<W>);
    const std::size_t row = edge, slice = edge * edge, count = slice * edge;
    // From the last to the first, so that each difference is taken against a sample that is still itself.
    for (std::size_t at = count - row; at >= slice; at -= row)
        for (std::size_t x = 0; x < row; ++x) samples[at + x] = W(samples[at + x] - samples[at + x - slice]);
    for (std::size_t z = 0; z < edge; ++z)
        for (std::size_t y = edge - 1; y > 0; --y) {
            W* const here = samples + z * slice + y * row;
            const W* const before = here - row;
            for (std::size_t x = 0; x < row; ++x) here[x] = W(here[x] - before[x]);
        }
    for (std::size_t at = 0; at < count; at += row) {
        W before = 0;
        for (std::size_t x = 0; x < row; ++x) {
            const W here = samples[at + x];
            samples[at + x] = zigzag(W(here - before));
            before = here;
        }
    }
}

// The inverse.
template <class W>
void addPrediction(W* samples, std::size_t edge) {
    static_assert(std::is_unsigned_v<W>);
    const std::size_t row = edge, slice = edge * edge, count = slice * edge;
    for (std::size_t at = 0; at < count; at += row) {
        W sum = 0;  // the one pass that a row cannot do in parallel
        for (std::size_t x = 0; x < row; ++x) samples[at + x] = sum = W(sum + unzigzag(samples[at + x]));
    }
    for (std::size_t z = 0; z < edge; ++z)
        for (std::size_t y = 1; y < edge; ++y) {
            W* const here = samples + z * slice + y * row;
            const W* const before = here - row;
            for (std::size_t x = 0; x < row; ++x) here[x] = W(here[x] + before[x]);
        }
    for (std::size_t at = slice; at < count; at += row)
        for (std::size_t x = 0; x < row; ++x) samples[at + x] = W(samples[at + x] + samples[at + x - slice]);
}

}  // namespace brickyard

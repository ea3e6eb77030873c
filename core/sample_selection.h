// Which samples of a brick a payload keeps words of, where most have one and the same: background around thin
// smoke. A bit per sample, x fastest, lowest bit first; at least one is set. Pure functions, any thread.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

namespace brickyard {

inline std::size_t selectionBytes(std::size_t samples) { return (samples + 7) / 8; }

inline std::size_t countSelected(std::span<const std::byte> mask) {
    std::size_t count = 0;
    for (std::byte bits : mask) count += std::size_t(std::popcount(std::uint8_t(bits)));
    return count;
}

// The selected of `samples` words, in order, to `out`. Gives the end of what it wrote.
template <class W>
W* gatherSelected(const W* words, std::size_t samples, std::span<const std::byte> mask, W* out) {
    for (std::size_t i = 0; i < samples; i += 8) {
        const auto bits = std::uint8_t(mask[i / 8]);
        if (bits == 0xff) {
            std::memcpy(out, words + i, 8 * sizeof(W));
            out += 8;
        } else {
            for (unsigned rest = bits; rest != 0; rest &= rest - 1)
                *out++ = words[i + std::size_t(std::countr_zero(rest))];
        }
    }
    return out;
}

// The inverse: `filler` where nothing is selected. Gives the end of what it read.
template <class W>
const W* scatterSelected(const W* selected, std::size_t samples, std::span<const std::byte> mask, W filler,
                         W* words) {
    for (std::size_t i = 0; i < samples; i += 8) {
        const auto bits = std::uint8_t(mask[i / 8]);
        const std::size_t group = samples - i < 8 ? samples - i : 8;
        if (bits == 0xff) {
            std::memcpy(words + i, selected, 8 * sizeof(W));
            selected += 8;
        } else {
            for (std::size_t k = 0; k < group; ++k) words[i + k] = filler;
            for (unsigned rest = bits; rest != 0; rest &= rest - 1)
                words[i + std::size_t(std::countr_zero(rest))] = *selected++;
        }
    }
    return selected;
}

}  // namespace brickyard

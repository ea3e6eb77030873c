// Numbers that look random and depend on a seed and a position only: made data are the same whatever the
// order and the number of threads that make them.
#pragma once

#include <cstdint>

namespace brickyard {

inline std::uint64_t hashOf(std::uint64_t seed, std::int64_t x, std::int64_t y, std::int64_t z) {
    std::uint64_t h = seed + 0x9e3779b97f4a7c15u * std::uint64_t(x) + 0xc2b2ae3d27d4eb4fu * std::uint64_t(y) +
                      0x165667b19e3779f9u * std::uint64_t(z);
    // The finaliser of splitmix64.
    h = (h ^ (h >> 30)) * 0xbf58476d1ce4e5b9u;
    h = (h ^ (h >> 27)) * 0x94d049bb133111ebu;
    return h ^ (h >> 31);
}

// In [0, 1).
inline float unitHash(std::uint64_t seed, std::int64_t x, std::int64_t y, std::int64_t z) {
    return float(hashOf(seed, x, y, z) >> 40) * 0x1p-24f;
}

}  // namespace brickyard

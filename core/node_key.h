// The name of an octree node: its level and its signed brick coordinates. Plain value, any thread.
//
// Level l has its samples at the multiples of 2^l of index space. With N cells per brick edge, node (l; x, y,
// z) owns the cells of [x, x+1) * N * 2^l per axis, and its eight children tile it exactly. Octants are x +
// 2y + 4z.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>

namespace brickyard {

// Levels 0 to 31: with N >= 8, two nodes per axis at level 29 already span all of int32.
inline constexpr std::int32_t kMaxLevel = 31;

struct NodeKey {
    std::int32_t level = 0;
    std::int32_t x = 0, y = 0, z = 0;

    // Arithmetic shift: the parent of -1 is -1.
    NodeKey parent() const { return {level + 1, x >> 1, y >> 1, z >> 1}; }
    int octant() const { return (x & 1) | (y & 1) << 1 | (z & 1) << 2; }
    NodeKey child(int octant) const {
        return {level - 1, 2 * x + (octant & 1), 2 * y + (octant >> 1 & 1), 2 * z + (octant >> 2 & 1)};
    }
    bool operator==(const NodeKey&) const = default;
};

// "L2(-1,0,3)", as messages show it.
std::string toString(const NodeKey& key);

// Bit-interleaved order of the coordinates within one level: near in space is near in the file.
bool mortonLess(const NodeKey& a, const NodeKey& b);

struct NodeKeyHash {
    std::size_t operator()(const NodeKey& key) const {
        auto mix = [](std::uint64_t h) { return (h ^ (h >> 29)) * 0xbf58476d1ce4e5b9ull; };
        std::uint64_t h =
            mix(std::uint64_t(std::uint32_t(key.x)) | std::uint64_t(std::uint32_t(key.y)) << 32);
        h = mix(h ^ (std::uint64_t(std::uint32_t(key.z)) | std::uint64_t(std::uint32_t(key.level)) << 32));
        return std::size_t(h ^ (h >> 32));
    }
};

}  // namespace brickyard

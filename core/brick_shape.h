// A brick's extents: N^3 cells, (N+1)^3 samples at their corners, x fastest. A brick needs no neighbour to be
// reconstructed; the price is one shared face per axis. (DESIGN.md, sections 3 and 13.)
#pragma once

#include <cstddef>
#include <cstdint>

namespace brickyard {

inline constexpr int kDefaultBrickEdge = 16;
inline constexpr int kMaxBrickEdge = 64;
inline constexpr std::size_t kMaxBrickSamples =
    std::size_t(kMaxBrickEdge + 1) * (kMaxBrickEdge + 1) * (kMaxBrickEdge + 1);

constexpr bool isBrickEdge(std::int64_t n) { return n == 8 || n == 16 || n == 32 || n == 64; }

struct BrickShape {
    int edge_cells = kDefaultBrickEdge;  // N

    int edgeSamples() const { return edge_cells + 1; }
    std::size_t samples() const {
        return std::size_t(edgeSamples()) * std::size_t(edgeSamples()) * std::size_t(edgeSamples());
    }
    std::size_t cells() const {
        return std::size_t(edge_cells) * std::size_t(edge_cells) * std::size_t(edge_cells);
    }
    // Index of sample (i, j, k), each in [0, N]; of owned voxel (i, j, k), each in [0, N).
    std::size_t sampleAt(int i, int j, int k) const {
        return std::size_t(i) +
               std::size_t(edgeSamples()) * (std::size_t(j) + std::size_t(edgeSamples()) * std::size_t(k));
    }
    std::size_t cellAt(int i, int j, int k) const {
        return std::size_t(i) +
               std::size_t(edge_cells) * (std::size_t(j) + std::size_t(edge_cells) * std::size_t(k));
    }
};

}  // namespace brickyard

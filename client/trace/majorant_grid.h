// Upper bounds of a medium's extinction and emission, cell by cell of a coarse grid over its box: what
// unbiased tracking needs, and what empty space is skipped with. Made from topology; then immutable: any
// thread. Novak et al. Monte Carlo Methods for Volumetric Light Transport Simulation. 2018, section 5.
#pragma once

#include <cstdint>
#include <functional>
#include <glm/vec3.hpp>
#include <vector>

#include "client/cpu/index_ray.h"

namespace brickyard {

struct MajorantCell {
    float extinction = 0;  // per world unit; rounded up
    float emission = 0;    // above 0 where something glows
    bool empty() const { return extinction == 0 && emission == 0; }
};

class MajorantGrid {
public:
    MajorantGrid() = default;
    // Covers [low, high] of index space by cells of `cell_edge`, aligned to its multiples. REQUIRES: low <
    // high.
    MajorantGrid(const glm::dvec3& low, const glm::dvec3& high, double cell_edge);

    // Longest edge in cells that a grid has.
    static constexpr int kMostCells = 96;
    std::size_t cellCount() const { return cells_.size(); }
    MajorantCell& cell(std::size_t index) { return cells_[index]; }
    const MajorantCell& cell(std::size_t index) const { return cells_[index]; }
    // Of a cell, in index space.
    glm::dvec3 cellLow(std::size_t index) const;
    double cellEdge() const { return edge_; }
    float mostExtinction() const;

    // The cell in which a ray is just behind `t`, and where it leaves it. Beyond the grid: an empty cell.
    struct Place {
        MajorantCell cell;
        double exit = 0;
    };
    Place at(const IndexRay& ray, double t) const;

private:
    glm::dvec3 low_{0};
    double edge_ = 1;
    int size_[3] = {};
    std::vector<MajorantCell> cells_;
};

// Where a ray crosses the next plane of the lattice {(k + shift) * edge} on any axis, behind `t` by more than
// a rounding.
inline double nextLatticePlane(const IndexRay& ray, double t, double edge, double shift = 0) {
    const double nudge = 1e-7 * edge * ray.unitLength();
    double next = std::numeric_limits<double>::infinity();
    for (int a = 0; a < 3; ++a) {
        if (ray.parallel[a]) continue;
        const double place = (ray.origin[a] + (t + nudge) * ray.direction[a]) / edge - shift;
        const double plane = ray.direction[a] > 0 ? std::floor(place) + 1 : std::ceil(place) - 1;
        next = std::min(next, ray.planeAt(a, (plane + shift) * edge));
    }
    return std::max(next, t + nudge);
}

}  // namespace brickyard

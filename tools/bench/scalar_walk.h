// The plain program that anybody would write to have the exact picture: from cell to cell of the
// full-resolution grid, in double precision, two Gauss points in each. Along a ray a trilinear cell is a
// cubic, so they are exact (where no density is below 0). One of the peers, and the truth that all pictures
// are held to.
//
// Walk: Amanatides, Woo. A Fast Voxel Traversal Algorithm for Ray Tracing. 1987. It shares no code with the
// renderer. Any thread.
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <vector>

#include "core/camera.h"
#include "core/octree_builder.h"
#include "tools/bench/source_grid.h"

namespace brickyard {

class ScalarWalk {
public:
    explicit ScalarWalk(SourceGrid grid) : grid_(std::move(grid)) {}

    // Density integrated along the ray of each pixel, in density times world units: times a density scale it
    // is the optical depth.
    std::vector<double> depths(const PinholeCamera& camera, const ParallelFor& parallel_for) const;

    // Light scattered once towards the eye, for the pixels (stride * i + stride / 2, stride * j + stride /
    // 2), row by row: the integral of extinction, transmittance to the eye and transmittance to the light (of
    // irradiance 1 from direction `to_light`, unit length). Albedo and phase function are factors on top of
    // it. Four Gauss points a cell, an exact shadow ray from each: slow.
    std::vector<double> scattered(const PinholeCamera& camera, double density_scale,
                                  const glm::dvec3& to_light, std::uint32_t stride,
                                  const ParallelFor& parallel_for) const;

private:
    SourceGrid grid_;
};

}  // namespace brickyard

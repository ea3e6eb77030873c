// What a user would take instead: a NanoVDB ray marcher on the CPU. Trilinear samples at the middles of equal
// steps, cached accessor, empty leaves and tiles skipped, early exit; absorption only.
//
// Its source is compiled for the very processor of the build (-march=native), so nothing in this header may
// be inline code that other files share: the linker would be free to take the copy that needs this processor.
#pragma once

#include <cstdint>

namespace brickyard {

// Index-space rays of a picture. The ray of pixel (x, y) begins at `origin` and has the direction corner + x
// * along_x + y * along_y, of any length; world_* is the same direction in the world.
struct NanoView {
    double origin[3], corner[3], along_x[3], along_y[3];
    double world_corner[3], world_along_x[3], world_along_y[3];
    std::uint32_t width;
    double density_scale;
    double step_voxels;  // length of a step in index space
};

// Pixels [x0, x1) x [y0, y1) into `alpha`, which is the whole picture, row by row. `grid` is
// NanoGrid::data(). Any thread.
void marchNano(const void* grid, const NanoView& view, std::uint32_t x0, std::uint32_t x1, std::uint32_t y0,
               std::uint32_t y1, float* alpha);

}  // namespace brickyard

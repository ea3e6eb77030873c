// A node's brick as the kernels take it. Pure functions, any thread.
#pragma once

#include "client/brick_page.h"
#include "client/cpu/octree_walk.h"
#include "client/cpu/packet_kernel.h"
#include "client/cpu/render_plan.h"

namespace brickyard {

// `samples`: a page of the node's brick.
inline BrickCells cellsOf(const PagedChannel& channel, const WalkedNode& node, const float* samples) {
    BrickCells cells;
    cells.samples = samples;
    cells.edge_samples = channel.shape().edgeSamples();
    cells.cell_edge = cellEdge(node.key.level);
    const glm::dvec3 low = nodeLow(node.key, channel.shape());
    for (std::size_t a = 0; a < 3; ++a) {
        cells.low[a] = low[int(a)];
        cells.box_begin[a] = node.record().box_begin[a];
        cells.box_end[a] = node.record().box_end[a];
    }
    cells.negative = node.record().value_min < 0 || channel.background() < 0;
    return cells;
}

// Whether the float kernel takes the brick: its densest voxel has little enough optical depth that the
// rounding stays below what a pixel of floats shows (measured: 4e-7 of alpha at 13 a voxel), or well below
// the error that is allowed; and no value is near a float's limits. Other bricks are summed in double.
inline bool fitsKernel(const PagedChannel& channel, const NodeRecord& record, int level,
                       const RenderPlan& plan) {
    constexpr double kMostVoxelDepth = 16, kMostPerError = 1e4, kLeastValue = 1e-30, kMostValue = 1e34;
    const double allowed =
        kMostVoxelDepth + (plan.quality.reference ? 0 : kMostPerError * plan.quality.max_error);
    const double most = std::max(std::abs(double(record.value_max)), std::abs(double(record.value_min)));
    return most * plan.scene.density_scale * cellEdge(level) * channel.transform().voxelSize() <= allowed &&
           most >= kLeastValue && most <= kMostValue;
}

// One ray of a packet.
inline IndexRay rayOf(const RayPacket& packet, int lane) {
    IndexRay ray;
    for (int a = 0; a < 3; ++a) {
        ray.origin[a] = packet.origin[a][lane];
        ray.direction[a] = packet.direction[a][lane];
        ray.inverse[a] = packet.inverse[a][lane];
    }
    return ray;
}

}  // namespace brickyard

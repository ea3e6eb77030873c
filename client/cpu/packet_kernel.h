// The inner loops of the renderer: packets of rays against boxes and through the cells of a brick, with the
// widest SIMD that the machine has, chosen at run time (Google Highway). Each ray's result depends on that
// ray alone, never on its neighbours in the packet. Pure functions, any thread. docs/performance.md has what
// bounds them.
#pragma once

#include <cstddef>
#include <cstdint>

#include "client/cpu/ray_packet.h"

namespace brickyard {

// A brick as its kernels see it. The field is trilinear between the (N + 1)^3 samples, x fastest.
struct BrickCells {
    const float* samples = nullptr;
    int edge_samples = 0;  // N + 1
    double low[3] = {};    // corner of the brick in index space
    double cell_edge = 1;  // in index units
    int box_begin[3] = {},
        box_end[3] = {};  // cells that hold anything but background; the rest is passed over
};

// Spans of eight rays, in world distances; empty where begin >= end.
struct alignas(64) PacketSpans {
    double begin[RayPacket::kRays];
    double end[RayPacket::kRays];
};

// Of the packets that `in` names, those with a live ray that meets the box [low, high]; their number. `in`
// and `out` may not overlap. The planes are IndexRay::planeAt's, so boxes that share a face tile a ray
// without gap or overlap.
std::size_t clipPackets(const RayPacket* packets, const std::uint16_t* in, std::size_t count,
                        const double low[3], const double high[3], std::uint16_t* out);
// The live part of each ray inside the box.
void clipPacket(const RayPacket& packet, const double low[3], const double high[3], PacketSpans& spans);

// Adds to sums[i] the integral of max(0, field) over ray i's span, in field unit x world distance: per cell
// the exact integral of the cubic (two Gauss points; split at its roots where a corner is negative),
// positions and sums in double, interpolation in float. Error: below kKernelRounding x (largest sample of the
// brick) x (length of the span).
void integrateBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans, double* sums);
inline constexpr double kKernelRounding = 6 * 0x1p-24;

// Where the integral reaches targets[i], given sums[i] at the begin of the span; linear within a cell. Leaves
// found[i] alone where it does not. Adds to sums[i] as integrateBrick() does.
void findInBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                 const double* targets, double* sums, double* found);

// The steps of eight rays through a brick, one cell or less each: end[k][i] is where step k of ray i ends and
// amount[k][i] the integral over it; count[i] of them. Beyond the last, amounts are 0.
struct alignas(64) PacketSteps {
    static constexpr int kMost = 3 * 64 + 3;  // kMaxBrickEdge cells on each axis
    double begin[RayPacket::kRays];           // of the first step
    double end[kMost][RayPacket::kRays];
    double amount[kMost][RayPacket::kRays];
    int count = 0;  // of the ray with the most
};
void stepThroughBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                      PacketSteps& steps);

// Integrals over each span of two step functions on a grid of 4x4x4 sub-boxes of [low, low + edge]^3, x
// fastest.
void integrateGrid(const RayPacket& packet, const double low[3], double edge, const PacketSpans& spans,
                   const double first[64], const double second[64], double* first_sums, double* second_sums);

// What was chosen, for reports: "AVX3", "AVX2", ...
const char* kernelTarget();

}  // namespace brickyard

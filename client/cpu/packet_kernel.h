// The inner loops of the renderer: packets of rays against boxes and through the cells of a brick, with the
// widest SIMD that the machine has, chosen at run time (Google Highway). Each ray's result depends on that
// ray alone, never on its neighbours in the packet. Pure functions, any thread. docs/performance.md has what
// bounds them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "client/cpu/ray_packet.h"

namespace brickyard {

// A brick as its kernels see it. The field is trilinear between the (N + 1)^3 samples, x fastest.
struct BrickCells {
    const float* samples = nullptr;
    // The same as CornerQuads has them, or nullptr: then each corner is gathered by itself.
    const float* quads = nullptr;
    int edge_samples = 0;  // N + 1
    double low[3] = {};    // corner of the brick in index space
    double cell_edge = 1;  // in index units
    // Cells that hold anything but background; the rest is passed over.
    int box_begin[3] = {}, box_end[3] = {};
    bool negative = false;  // whether a sample may be below 0
};

// The four corners of each cell's lower face, side by side: 16 bytes, one load. Four times the size of the
// samples, so made for a brick while many rays pass through it, into a buffer that is used again.
class CornerQuads {
public:
    // Fills in the cells of the brick's box. Valid until the next call.
    const float* of(const BrickCells& brick);

private:
    std::vector<float> quads_;
};
// Rays from which on the quads of a brick are worth making. Measured in docs/performance.md.
inline constexpr std::size_t kRaysForQuads = 128;

// Spans of a packet's rays, in world distances; empty where begin >= end.
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
// the exact integral of the cubic (two Gauss points; split at its roots where a corner is negative).
// Arithmetic is in float, relative to the brick's middle. Error: at most (kPositionRounding x N x steepness
// (see brick_page.h) + kSampleRounding x largest |sample|) x length of the span, and what the samples can
// make of kLostLength cells; docs/error-bounds.md derives it.
void integrateBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans, double* sums);
inline constexpr double kPositionRounding = 1.5 / 16 * 0x1p-20;
inline constexpr double kSampleRounding = 12 * 0x1p-24;
inline constexpr double kLostLength = 0x1p-18;

// A light's transmittance over the box of a brick, on a lattice (see light_lattice.h).
struct LightCells {
    const float* quads = nullptr;
    int points[3] = {};
    float per_cell[3] = {};  // lattice cells per cell of the brick
};
inline constexpr int kMostLightCells = 16;  // along an axis of the lattice

// What rays make of a brick that is lit.
struct alignas(64) PacketScatter {
    double depth[RayPacket::kRays] = {};  // integral of the field, in front of the density scale
    double weight[RayPacket::kRays] =
        {};                           // integral of T x S over optical depth; T is 1 where the span begins
    double passed[RayPacket::kRays];  // T where it ends
    double last[RayPacket::kRays];    // S there
};
// As integrateBrick(), with S the light's transmittance: its optical depth is linear between as many
// points of the span as the lattice has along its longest axis. `scale` turns the field's integral into
// optical depth. Fills in all of `out`; rays without a span have depth and weight 0, passed 1 and last 1.
void scatterInBrick(const RayPacket& packet, const BrickCells& brick, const LightCells& light,
                    const PacketSpans& spans, double scale, PacketScatter& out);

// Where the integral reaches targets[i], given sums[i] at the begin of the span; linear within a cell. Leaves
// found[i] alone where it does not. Adds to sums[i] the integral of the cells up to there, or of all.
void findInBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                 const double* targets, double* sums, double* found);

// Integrals over each span of two step functions on a grid of 4x4x4 sub-boxes of [low, low + edge]^3, x
// fastest.
void integrateGrid(const RayPacket& packet, const double low[3], double edge, const PacketSpans& spans,
                   const float first[64], const float second[64], double* first_sums, double* second_sums);

// What was chosen, for reports: "AVX3", "AVX2", ...
const char* kernelTarget();

}  // namespace brickyard

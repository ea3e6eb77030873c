// Refines a tile's cut until its rays expect little enough error, on topology alone: a tile goes from its
// coarse look to the cut that its error asks for in one step, and pays for no brick on the way.
// Deterministic.
#pragma once

#include <functional>
#include <vector>

#include "client/cpu/channel_ray.h"
#include "client/cpu/packet_walk.h"
#include "client/cpu/render_plan.h"
#include "client/cpu/tile_cut.h"

namespace brickyard {

// A packet that asks for less error. Rays that are content have begin >= end.
struct alignas(64) CutRays {
    RayPacket packet;
    double unit[RayPacket::kRays] = {};    // world length of an index unit along each ray
    double effect[RayPacket::kRays] = {};  // d(pixel) / d(integral of the field)
    std::uint16_t touched = 0;             // out: lanes that meet a node that was split
};

// d(radiance) / d(integral of the field) of a lane of packet `place` at a world distance; empty where nothing
// is lit.
using LitEffect = std::function<double(std::size_t place, int lane, double distance)>;

// Splits nodes of `cut`, worst first, until each ray's error is as plan.quality asks for or nothing is left
// to split. False while a tree block is missing: it is wanted, and the cut is as before.
bool refineCut(const RenderPlan& plan, const FrontToBack& order, std::vector<CutRays>& rays,
               const LitEffect& lit, const RayContext& context, TileCut& cut);

}  // namespace brickyard

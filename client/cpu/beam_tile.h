// A tile of pixels traced together: packets of rays through the octree, a brick at a time, for pictures of
// absorption.
//
// Reference: the leaves. Else the tile has one cut for all of its rays, refined from the roots until each
// ray's error is small enough; rays that are good enough keep what they have. Each decision rests on stored
// data, never on what was resident, so a finished pixel is the same, bit for bit, however its pages came. A
// ray that misses a brick keeps its place and goes on later, so a cache of a few pages is enough.
// docs/design.md, section "A tile". Not thread-safe: one thread works on a tile.
#pragma once

#include <optional>
#include <vector>

#include "client/cpu/channel_ray.h"
#include "client/cpu/drawn_nodes.h"
#include "client/cpu/light_lattice.h"
#include "client/cpu/node_error.h"
#include "client/cpu/packet_kernel.h"
#include "client/cpu/packet_walk.h"
#include "client/cpu/pixel_packets.h"
#include "client/cpu/ray_composite.h"
#include "client/cpu/render_plan.h"
#include "client/cpu/tile_cut.h"

namespace brickyard {

// What a packet's rays have collected. Integrals are of the field, before the density scale.
struct alignas(64) BeamRays {
    static constexpr int kRays = RayPacket::kRays;
    double depth[kRays] = {}, low[kRays] = {}, high[kRays] = {}, variance[kRays] = {};
    double first[kRays] = {}, last[kRays] = {};  // all of the ray inside the medium
    double at_least[kRays] = {};                 // of the depth, in front of a blocked ray's scout
    double resume[kRays] = {};                   // where a blocked ray goes on
    double transmittance[kRays] = {};            // of the last cut; 1 at first
    // With a light: variance weighted by the square of the transmittance in front; the single-scattered
    // weight, the standard deviation that shadows give it, and the moments from which its variance follows
    // (docs/error-bounds.md).
    double lit_variance[kRays] = {};
    double front[kRays] = {};  // transmittance so far
    double weight[kRays] = {}, shadow_deviation[kRays] = {}, shadow_variance[kRays] = {}, moment1[kRays] = {},
           moment2[kRays] = {};
    double distance[kRays] = {};        // to half the opacity
    double level[kRays] = {};           // integral of level over depth
    std::uint16_t waiting[kRays] = {};  // stretches that a finer page would change
    std::uint16_t blocked = 0;          // lanes that miss a page of this pass
    std::uint16_t settled = 0;          // lanes that later cuts leave alone
    std::uint16_t stuck = 0;            // settled, though not good enough: nothing finer could help
    std::uint8_t cut[kRays] = {};       // number of the cut that a lane's marks are of
    std::uint16_t located = 0;          // lanes whose `distance` is known
    std::int32_t last_mark = -1;
};

inline bool hasLane(std::uint16_t mask, int lane) { return mask >> lane & 1; }
inline void addLane(std::uint16_t& mask, int lane) { mask = std::uint16_t(mask | 1u << lane); }

class BeamTile {
public:
    // Whether the plan's pictures can be traced in beams: no light, no emission, and a background that
    // absorbs nothing.
    static bool canTrace(const RenderPlan& plan);

    // The cut that the plan's quality asks for; or, with `resident`, what can be drawn with the pages that
    // are there. Without `light` nothing is scattered, whatever the plan says. REQUIRES: canTrace(plan), and
    // the box is at most 32 x 32 pixels. All three must outlive the tile.
    BeamTile(const RenderPlan& plan, LightField* light, const PixelBox& box,
             const ResidentTree* resident = nullptr);

    // kWaiting: pages are missing, and wanted. kFailed: one of them cannot be had, and the tile is of no use.
    // A tile of resident pages is done at once.
    enum class Progress { kWaiting, kDone, kFailed };
    Progress advance(const RayContext& context);

    // Pixels whose rays run parallel to an axis plane: no packet takes them.
    const std::vector<PixelPlace>& others() const { return pixels_.others; }
    struct Why {
        float level = 0, waiting = 0;  // as PixelWhy has them
        bool stuck = false;
    };
    // Calls draw(place, pixel, why) for each pixel that sees the medium, but the others. REQUIRES: advance()
    // gave kDone.
    template <class Draw>
    void forEachPixel(Draw&& draw) const {
        for (std::size_t p = 0; p < rays_.size(); ++p)
            for (int lane = 0; lane < BeamRays::kRays; ++lane)
                if (hasLane(pixels_.lanes[p].used, lane)) {
                    const Pixel pixel = pixelOf(p, lane);
                    draw(pixels_.lanes[p].place[lane], pixel, whyOf(p, lane, pixel));
                }
    }
    std::size_t packets() const { return rays_.size(); }

private:
    // After each node: where each ray of a packet was, and its depth. A chain per packet, newest first.
    struct Mark {
        double end[BeamRays::kRays], depth[BeamRays::kRays];
        std::uint32_t node = 0;
        std::int32_t previous = -1;
        std::uint8_t cut = 0;
    };
    // A node as the walk met it: what all packets need of it.
    struct Visit {
        WalkedNode field;  // whose field is integrated: the node itself, or what stands in for it
        const float* samples = nullptr;  // nullptr: one value, or missing
        double constant = 0;
        bool missing = false, draft = false, in_kernel = false;
        double rounding = 0, lost = 0;  // of an integral, per length, and per ray
        NodeErrors errors;
        const LightLattice* light = nullptr;
    };
    // kIntegrate: optical depth along the cut. kScatter: the same and the light that reaches it.
    enum class Phase { kIntegrate, kScatter, kRefine, kLocate, kDone };

    bool integrate(const RayContext& context);
    void integrateNode(const WalkedNode& node, bool draft, PacketList list, const RayContext& context);
    Phase startScatter();
    Visit visitField(const WalkedNode& node, bool draft, PacketList list, const RayContext& context);
    Visit visit(const WalkedNode& node, bool draft, PacketList list, const RayContext& context);
    Visit visitResident(const WalkedNode& node, const RayContext& context);
    const float* residentSamples(const WalkedNode& node, const RayContext& context, bool& draft) const;
    void describeBrick(Visit& visit) const;
    void integratePacket(const WalkedNode& node, const Visit& visit, const BrickCells& cells,
                         std::uint16_t place, const RayContext& context);
    void block(std::uint16_t place, const PacketSpans& spans, double least, const RayContext& context);
    void release();
    // `all`: rays that are settled too.
    void startCut(bool all);
    // Rays that are good enough are settled; true when all are.
    bool settle();
    bool allSettled() const;
    bool refine(const RayContext& context);
    bool locate(const RayContext& context);
    bool locateIn(std::size_t place, const RayContext& context);
    bool findInMark(std::size_t place, const Mark& mark, const PacketSpans& spans, const double* targets,
                    double* before, const RayContext& context);

    const float* samplesOf(const WalkedNode& node, bool draft, double worth, const RayContext& context);
    PacketMask descends(const WalkedNode& node);
    AlphaComposite alphaOf(std::size_t place, int lane) const;
    Pixel pixelOf(std::size_t place, int lane) const;
    Why whyOf(std::size_t place, int lane, const Pixel& pixel) const;
    void lightPixel(std::size_t place, int lane, Pixel& pixel) const;
    // Adds a node's integral to sums.
    void sumNode(const Visit& visit, const BrickCells& cells, const RayPacket& packet,
                 const PacketSpans& spans, double* sums) const;
    // The same, and what it scatters with a transmittance of 1 in front.
    void scatterNode(const Visit& visit, const BrickCells& cells, const RayPacket& packet,
                     const PacketSpans& spans, PacketScatter& out) const;
    bool scatters() const { return phase_ == Phase::kScatter; }
    // Largest radiance of a unit of scattered weight.
    double mostScattered() const;
    double transmittanceBefore(std::size_t place, int lane, double distance) const;

    const RenderPlan& plan_;
    const PagedChannel& channel_;
    LightField* light_;
    double scale_;
    bool resident_;
    std::optional<DrawnNodes> drawn_;  // where resident_
    FrontToBack order_;
    PixelPackets pixels_;
    std::vector<BeamRays> rays_;
    std::vector<Mark> marks_;
    std::vector<WalkedNode> nodes_;  // that marks are of
    TileCut cut_;
    std::uint8_t cut_number_ = 0;
    Phase phase_ = Phase::kIntegrate;
    bool any_blocked_ = false, failed_ = false;
    bool lit_ = false;  // a cut has been scattered from by every ray
};

}  // namespace brickyard

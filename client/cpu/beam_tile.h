// A tile of pixels traced together: packets of rays through the octree, a brick at a time, for pictures of
// absorption.
//
// Reference: the leaves. Else the tile has one cut for all of its rays, refined from the roots until each
// ray's estimate is small enough; rays that are good enough keep what they have. Each decision rests on
// stored data, never on what was resident, so a finished pixel is the same, bit for bit, however its pages
// came. A ray that misses a brick keeps its place and goes on later, so a cache of a few pages is enough.
// docs/design.md, section "A tile". Not thread-safe: one thread works on a tile.
#pragma once

#include <memory>
#include <unordered_set>
#include <vector>

#include "client/cpu/channel_ray.h"
#include "client/cpu/packet_walk.h"
#include "client/cpu/ray_composite.h"
#include "client/cpu/render_plan.h"

namespace brickyard {

// Pixels [x0, x1) x [y0, y1).
struct PixelBox {
    std::uint32_t x0 = 0, y0 = 0, x1 = 0, y1 = 0;
};
struct PixelPlace {
    std::uint32_t x = 0, y = 0;
};

class BeamTile {
public:
    // Whether the plan's pictures can be traced in beams: no light, no emission, no strict bound, and a
    // background that absorbs nothing.
    static bool canTrace(const RenderPlan& plan);

    // REQUIRES: canTrace(plan), and the box holds at most 8 * kMostPackets pixels. `plan` must outlive the
    // tile.
    BeamTile(const RenderPlan& plan, const PixelBox& box);

    // kWaiting: pages are missing, and wanted. kFailed: one of them cannot be had, and the tile is of no use.
    enum class Progress { kWaiting, kDone, kFailed };
    Progress advance(const RayContext& context);

    // Pixels whose rays run parallel to an axis plane: no packet takes them.
    const std::vector<PixelPlace>& others() const { return others_; }
    // Calls draw(place, composite, enough) for each pixel but the others; `enough`: its error is what was
    // asked for. REQUIRES: advance() gave kDone.
    template <class Draw>
    void forEachPixel(Draw&& draw) const {
        for (std::size_t p = 0; p < packets_.size(); ++p)
            for (int lane = 0; lane < RayPacket::kRays; ++lane)
                if (rays_[p].used >> lane & 1)
                    draw(rays_[p].place[lane], composite(rays_[p], lane), !(rays_[p].stuck >> lane & 1));
    }

private:
    // How far a packet's rays have got, and what was found there. Integrals are of the field, before `scale`.
    struct alignas(64) Rays {
        double depth[8] = {}, low[8] = {}, high[8] = {}, variance[8] = {};
        double at_least[8] = {};             // of the depth, in front of a blocked ray's scout
        double resume[8] = {};               // where a blocked ray goes on
        double first[8] = {}, last[8] = {};  // all of the ray inside the medium
        double unit[8] = {};                 // world length of an index unit along the ray
        double transmittance[8] = {};        // of the last cut; 1 at first
        double target[8] = {}, distance[8] = {};
        PixelPlace place[8];
        std::uint8_t used = 0;     // lanes with a pixel
        std::uint8_t blocked = 0;  // lanes that miss a page of this pass
        std::uint8_t settled = 0;  // lanes that later cuts leave alone
        std::uint8_t stuck = 0;    // settled, though not good enough: nothing finer could help
        // After each node: where each ray was, and its depth. For the distance to half the opacity.
        struct Mark {
            double end[8], depth[8];
        };
        std::vector<Mark> marks;
    };
    struct Item;
    enum class Phase { kIntegrate, kRefine, kLocate, kDone };

    bool integrate(const RayContext& context);
    void integrateNode(const WalkedNode& node, PacketList list, const RayContext& context);
    bool refine(const RayContext& context);
    bool settle();
    void startCut();
    bool locate(const RayContext& context);
    void beginLocating();

    const float* samplesOf(const WalkedNode& node, std::size_t rays, double worth, const RayContext& context);
    bool usesDraft(const WalkedNode& node) const;
    bool descends(const WalkedNode& node) const;
    void block(RayPacket& packet, Rays& rays, const PacketSpans& spans, double least,
               const RayContext& context);
    void release();
    RayComposite composite(const Rays& rays, int lane) const;
    void sumNode(const WalkedNode& node, const float* samples, const RayPacket& packet,
                 const PacketSpans& spans, double* sums) const;
    void findInNode(const WalkedNode& node, const float* samples, const RayPacket& packet,
                    const PacketSpans& spans, const double* targets, double* sums, double* found) const;
    BrickCells cellsOf(const WalkedNode& node, const float* samples) const;
    bool fitsKernel(const NodeRecord& record, int level) const;
    Item describe(const WalkedNode& node, PacketList list) const;

    const RenderPlan& plan_;
    const PagedChannel& channel_;
    double scale_;
    FrontToBack order_;
    std::vector<RayPacket> packets_;
    std::vector<Rays> rays_;
    std::vector<PixelPlace> others_;
    Phase phase_ = Phase::kIntegrate;
    bool any_blocked_ = false, failed_ = false;
    // The cut: nodes that give way to their children, and leaves whose whole brick takes their draft's place.
    std::unordered_set<std::uint64_t> split_, whole_;
};

}  // namespace brickyard

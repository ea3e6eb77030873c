// Parallel rays towards a light, in packets: the optical depth from each of up to 1024 points to where the
// medium ends. Keeps its place when a page is missing. One thread at a time.
#pragma once

#include <optional>
#include <vector>

#include "client/cpu/channel_ray.h"
#include "client/cpu/drawn_nodes.h"
#include "client/cpu/packet_kernel.h"
#include "client/cpu/packet_walk.h"
#include "client/cpu/render_plan.h"

namespace brickyard {

class ShadowBeam {
public:
    static constexpr std::size_t kMostPoints = RayPacket::kRays * kMostTilePackets;

    // Points in index space of plan.density. `deviation`: of an optical depth that is allowed; 0: the finest
    // level. With `resident`,
    // what can be told from the pages that are there. REQUIRES: plan.scene.light; at most kMostPoints points.
    ShadowBeam(const RenderPlan& plan, double deviation, const std::vector<glm::dvec3>& points,
               const ResidentTree* resident);

    // True when all depths are known; until then pages are wanted, worth `worth`.
    bool advance(double worth, const RayContext& context);
    // REQUIRES: advance() was true.
    double depth(std::size_t point) const;
    double variance(std::size_t point) const;  // of the optical depth

private:
    struct alignas(64) Rays {
        double depth[RayPacket::kRays] = {}, variance[RayPacket::kRays] = {};
        double resume[RayPacket::kRays] = {}, last[RayPacket::kRays] = {};
        std::uint16_t blocked = 0;
    };
    void fill(const std::vector<glm::dvec3>& points);
    bool descends(const WalkedNode& node, const RayContext& context);
    bool usesDraft(const WalkedNode& node) const;
    // The field that stands for a node, and what is known of it.
    struct Field {
        WalkedNode node;
        const float* samples = nullptr;
        double constant = 0;
        double variance_per_length = 0;
        bool missing = false;
    };
    Field fieldOf(const WalkedNode& node, double worth, const RayContext& context);
    Field residentField(const WalkedNode& node, const RayContext& context);
    void meet(const WalkedNode& node, PacketList list, double worth, const RayContext& context);
    void block(std::uint16_t place, const PacketSpans& spans, bool scouts);

    const RenderPlan& plan_;
    const PagedChannel& channel_;
    double scale_;
    double variance_per_length_;  // allowed, of the field's integral squared, per world length
    FrontToBack order_;
    std::optional<DrawnNodes> drawn_;
    double unit_length_ = 1;  // world length of an index unit along the light
    std::vector<RayPacket> packets_;
    std::vector<Rays> rays_;
    bool any_blocked_ = false;
};

}  // namespace brickyard

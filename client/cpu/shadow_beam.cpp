#include "client/cpu/shadow_beam.h"

#include <algorithm>
#include <cmath>

#include "client/cpu/cell_walk.h"
#include "client/cpu/node_cells.h"

namespace brickyard {

namespace {

constexpr int kLanes = RayPacket::kRays;
constexpr double kNever = std::numeric_limits<double>::infinity();
// exp(-kDark) is below what a float can add to 1.
constexpr double kDark = 20;
// An axis along which the light moves by less is given this slope instead: the ray then strays by a millionth
// of a voxel over any dataset, and no plane lies at infinity.
constexpr double kLeastSlope = 1e-16;

thread_local CornerQuads t_quads;

bool inSpan(const PacketSpans& spans, int lane) { return spans.begin[lane] < spans.end[lane]; }

}  // namespace

ShadowBeam::ShadowBeam(const RenderPlan& plan, double deviation, const std::vector<glm::dvec3>& points)
    : channel_(*plan.density), scale_(plan.scene.density_scale) {
    glm::dvec3 direction = channel_.transform().inverseVector(plan.scene.light->to_light);
    const double longest = std::max({std::abs(direction.x), std::abs(direction.y), std::abs(direction.z)});
    for (int a = 0; a < 3; ++a)
        if (std::abs(direction[a]) < kLeastSlope * longest)
            direction[a] = std::copysign(kLeastSlope * longest, direction[a]);
    order_.kind = FrontToBack::Kind::kParallel;
    order_.vector = direction;
    unit_length_ = 1 / glm::length(direction);
    const double most = glm::length(channel_.clipHigh() - channel_.clipLow()) * unit_length_;
    variance_per_length_ = deviation * deviation / (scale_ * scale_ * most);
    fill(points);
}

void ShadowBeam::fill(const std::vector<glm::dvec3>& points) {
    packets_.resize((points.size() + kLanes - 1) / kLanes);
    rays_.resize(packets_.size());
    for (std::size_t i = 0; i < packets_.size() * kLanes; ++i) {
        const std::size_t p = i / kLanes;
        const int lane = int(i % kLanes);
        IndexRay ray;
        ray.origin = points[std::min(i, points.size() - 1)];
        ray.direction = order_.vector;
        ray.inverse = 1.0 / ray.direction;
        RaySpan span = ray.clip(channel_.clipLow(), channel_.clipHigh(), {0, kNever});
        if (i >= points.size() || span.empty()) span = {kNever, kNever};
        packets_[p].set(lane, ray, span);
        rays_[p].last[lane] = span.end;
    }
}

// By the node alone, not by the ray: what all of a crossing may add to the variance, against its share.
bool ShadowBeam::descends(const WalkedNode& node, const RayContext& context) const {
    const WantedPage below{true, {channel_.index(), node.block->children(node.ref.node).block, 0}};
    if (context.failed->contains(below)) return false;
    const double rms = double(node.record().rms);
    return variance_per_length_ == 0 ||
           rms * rms * unit_length_ * cellEdge(node.key.level) > variance_per_length_;
}

bool ShadowBeam::usesDraft(const WalkedNode& node) const {
    const double rms = double(node.record().draft_rms);
    return node.record().hasDraft() && variance_per_length_ > 0 &&
           rms * rms * unit_length_ * cellEdge(node.key.level) <= variance_per_length_;
}

void ShadowBeam::block(std::uint16_t place, const PacketSpans& spans, bool scouts) {
    any_blocked_ = true;
    for (int lane = 0; lane < kLanes; ++lane) {
        if (!inSpan(spans, lane)) continue;
        if (!(rays_[place].blocked >> lane & 1)) {
            rays_[place].blocked = std::uint16_t(rays_[place].blocked | 1u << lane);
            rays_[place].resume[lane] = packets_[place].begin[lane];
        }
        packets_[place].begin[lane] = scouts ? spans.end[lane] : kNever;
    }
}

void ShadowBeam::meet(const WalkedNode& node, PacketList list, double worth, const RayContext& context) {
    const float* samples = nullptr;
    double constant = 0, per_length = 0;
    bool missing = false;
    auto want = [&](const WantedPage& page, std::uint64_t bytes) {
        missing = !context.failed->contains(page);
        if (missing && !context.full()) context.wants->add(page, std::uint32_t(bytes), worth, context.tile);
    };
    if (node.status == WalkStatus::kMissingBlock) {
        want({true, {channel_.index(), node.missing_block, 0}}, channel_.blockBytes(node.missing_block));
    } else if (!node.record().hasBrick()) {
        constant = std::max(0.0, double(toFloat(channel_.type(), node.block->constant(node.ref.node)[0])));
    } else {
        const NodeRecord& record = node.record();
        const bool draft = usesDraft(node);
        const PageAddress page{channel_.index(), node.ref.block, node.ref.node, draft};
        samples = context.cache->find(page);
        if (!samples) {
            want({false, page}, draft ? record.draft_bytes : record.payload_bytes);
            // A page that cannot be had: the middle of its range.
            constant =
                0.5 * (std::max(0.0, double(record.value_min)) + std::max(0.0, double(record.value_max)));
        }
        const double rms = double(draft ? record.draft_rms : record.rms);
        per_length = rms * rms * unit_length_ * cellEdge(node.key.level);
    }
    const bool in_kernel = samples && fitsKernel(channel_, node.record(), node.key.level, scale_);
    BrickCells cells;
    if (samples) cells = cellsOf(channel_, node, samples);
    if (in_kernel && list.count * kLanes >= kRaysForQuads) cells.quads = t_quads.of(cells);
    const glm::dvec3 low = nodeLow(node.key, channel_.shape());
    const glm::dvec3 high = low + nodeEdge(node.key, channel_.shape());
    for (std::uint16_t place : list) {
        RayPacket& packet = packets_[place];
        Rays& rays = rays_[place];
        PacketSpans spans;
        clipPacket(packet, &low[0], &high[0], spans);
        if (missing) {
            block(place, spans, !context.full());
            continue;
        }
        if (rays.blocked) {
            // Scouts add nothing: what lies in front of them is not there yet.
            PacketSpans scouts = spans;
            for (int lane = 0; lane < kLanes; ++lane)
                (rays.blocked >> lane & 1 ? spans : scouts).end[lane] = -kNever;
            block(place, scouts, !context.full());
        }
        if (in_kernel) integrateBrick(packet, cells, spans, rays.depth);
        for (int lane = 0; lane < kLanes; ++lane) {
            if (!inSpan(spans, lane)) continue;
            const double length = spans.end[lane] - spans.begin[lane];
            if (!samples) rays.depth[lane] += constant * length;
            if (samples && !in_kernel)
                walkCells(samples, channel_.shape(), node.key, node.record(), rayOf(packet, lane),
                          {spans.begin[lane], spans.end[lane]},
                          [&](const Cell& cell, const glm::dvec3& a, const glm::dvec3& b, double begin,
                              double end) { rays.depth[lane] += meanPositive(cell, a, b) * (end - begin); });
            rays.variance[lane] += per_length * length;
            packet.begin[lane] = rays.depth[lane] * scale_ > kDark ? kNever : spans.end[lane];
        }
    }
}

bool ShadowBeam::advance(double worth, const RayContext& context) {
    if (any_blocked_)
        for (std::size_t p = 0; p < packets_.size(); ++p) {
            for (int lane = 0; lane < kLanes; ++lane)
                if (rays_[p].blocked >> lane & 1) {
                    packets_[p].begin[lane] = rays_[p].resume[lane];
                    packets_[p].end[lane] = rays_[p].last[lane];
                }
            rays_[p].blocked = 0;
        }
    any_blocked_ = false;
    walkPackets(
        channel_, packets_, order_,
        [&](const WalkedNode& node) { return descends(node, context) ? kAllPackets : 0; },
        [&](const WalkedNode& node, PacketList list) { meet(node, list, worth, context); });
    return !any_blocked_;
}

double ShadowBeam::depth(std::size_t point) const {
    return rays_[point / kLanes].depth[point % kLanes] * scale_;
}

double ShadowBeam::variance(std::size_t point) const {
    return rays_[point / kLanes].variance[point % kLanes] * scale_ * scale_;
}

}  // namespace brickyard

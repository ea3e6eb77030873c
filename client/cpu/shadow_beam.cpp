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

ShadowBeam::ShadowBeam(const RenderPlan& plan, double deviation, const std::vector<glm::dvec3>& points,
                       const ResidentTree* resident)
    : plan_(plan), channel_(*plan.density), scale_(plan.scene.density_scale) {
    if (resident) drawn_.emplace(*resident);
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
bool ShadowBeam::descends(const WalkedNode& node, const RayContext& context) {
    if (drawn_) {
        drawn_->at(node);
        return drawn_->finerBelow(node);
    }
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

ShadowBeam::Field ShadowBeam::residentField(const WalkedNode& node, const RayContext& context) {
    Field out;
    out.node = node;
    const WalkedNode* drawn = drawn_->at(node);
    if (!drawn && !node.block) return out;
    const NodeRecord& record = drawn ? drawn->record() : node.record();
    if (drawn) out.node = *drawn;
    double rms = double(record.rms);
    if (drawn && record.hasBrick()) {
        PageAddress page{channel_.index(), drawn->ref.block, drawn->ref.node, false};
        out.samples = context.cache->find(page);
        page.draft = true;
        if (!out.samples) out.samples = context.cache->find(page), rms = double(record.draft_rms);
    } else if (drawn) {
        out.constant =
            std::max(0.0, double(toFloat(channel_.type(), drawn->block->constant(drawn->ref.node)[0])));
    } else {
        out.constant =
            0.5 * (std::max(0.0, double(record.value_min)) + std::max(0.0, double(record.value_max)));
        rms = out.constant;
    }
    out.variance_per_length = rms * rms * unit_length_ * cellEdge(out.node.key.level);
    return out;
}

ShadowBeam::Field ShadowBeam::fieldOf(const WalkedNode& node, double worth, const RayContext& context) {
    if (drawn_) return residentField(node, context);
    Field out;
    out.node = node;
    auto want = [&](const WantedPage& page, std::uint64_t bytes) {
        out.missing = !context.failed->contains(page);
        if (out.missing && !context.full())
            context.wants->add(page, std::uint32_t(bytes), worth, context.tile);
    };
    if (node.status == WalkStatus::kMissingBlock) {
        want({true, {channel_.index(), node.missing_block, 0}}, channel_.blockBytes(node.missing_block));
        return out;
    }
    const NodeRecord& record = node.record();
    if (!record.hasBrick()) {
        out.constant =
            std::max(0.0, double(toFloat(channel_.type(), node.block->constant(node.ref.node)[0])));
        return out;
    }
    const bool draft = usesDraft(node);
    const PageAddress page{channel_.index(), node.ref.block, node.ref.node, draft};
    out.samples = context.cache->find(page);
    if (!out.samples) {
        want({false, page}, draft ? record.draft_bytes : record.payload_bytes);
        // A page that cannot be had: the middle of its range.
        out.constant =
            0.5 * (std::max(0.0, double(record.value_min)) + std::max(0.0, double(record.value_max)));
    }
    const double rms = double(draft ? record.draft_rms : record.rms);
    out.variance_per_length = rms * rms * unit_length_ * cellEdge(node.key.level);
    return out;
}

void ShadowBeam::meet(const WalkedNode& node, PacketList list, double worth, const RayContext& context) {
    const Field field = fieldOf(node, worth, context);
    const bool in_kernel =
        field.samples && fitsKernel(channel_, field.node.record(), field.node.key.level, plan_);
    BrickCells cells;
    if (field.samples) cells = cellsOf(channel_, field.node, field.samples);
    if (in_kernel && list.count * kLanes >= kRaysForQuads) cells.quads = t_quads.of(cells);
    const glm::dvec3 low = nodeLow(node.key, channel_.shape());
    const glm::dvec3 high = low + nodeEdge(node.key, channel_.shape());
    for (std::uint16_t place : list) {
        RayPacket& packet = packets_[place];
        Rays& rays = rays_[place];
        PacketSpans spans;
        clipPacket(packet, &low[0], &high[0], spans);
        if (field.missing) {
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
            if (!field.samples) rays.depth[lane] += field.constant * length;
            if (field.samples && !in_kernel)
                walkCells(field.samples, channel_.shape(), field.node.key, field.node.record(),
                          rayOf(packet, lane), {spans.begin[lane], spans.end[lane]},
                          [&](const Cell& cell, const glm::dvec3& a, const glm::dvec3& b, double begin,
                              double end) { rays.depth[lane] += meanPositive(cell, a, b) * (end - begin); });
            rays.variance[lane] += field.variance_per_length * length;
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

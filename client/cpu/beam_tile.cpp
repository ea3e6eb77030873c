#include "client/cpu/beam_tile.h"

#include <algorithm>
#include <cmath>
#include <queue>

#include "client/cpu/cell_walk.h"
#include "client/cpu/node_error.h"
#include "client/cpu/packet_kernel.h"

namespace brickyard {

namespace {

constexpr int kLanes = RayPacket::kRays;
constexpr double kNever = std::numeric_limits<double>::infinity();
// Beyond this optical depth nothing shows: exp(-46) = 1e-20.
constexpr double kOpaqueDepth = 46;
// Relative rounding of a double sum over the cells of a node.
constexpr double kSumRounding = 1e-12;
// The float kernel takes bricks whose densest voxel has no more optical depth than this: its error in alpha
// is then below 2e-7 a voxel. Denser bricks are summed in double.
constexpr double kMostVoxelDepth = 1;

std::uint64_t keyOf(const NodeRef& ref) { return std::uint64_t(ref.block) << 32 | ref.node; }

bool holds(std::uint8_t mask, int lane) { return mask >> lane & 1; }
void add(std::uint8_t& mask, int lane) { mask = std::uint8_t(mask | 1u << lane); }

IndexRay rayOf(const RayPacket& packet, int lane) {
    IndexRay ray;
    for (int a = 0; a < 3; ++a) {
        ray.origin[a] = packet.origin[a][lane];
        ray.direction[a] = packet.direction[a][lane];
        ray.inverse[a] = packet.inverse[a][lane];
    }
    return ray;
}

}  // namespace

bool BeamTile::canTrace(const RenderPlan& plan) {
    return !plan.scene.light && !plan.emission && !plan.quality.strict && !plan.density->empty() &&
           !(plan.density->background() > 0);
}

BeamTile::BeamTile(const RenderPlan& plan, const PixelBox& box)
    : plan_(plan), channel_(*plan.density), scale_(plan.scene.density_scale) {
    order_.kind = FrontToBack::Kind::kFromPoint;
    order_.vector = channel_.transform().inversePoint(plan.camera->eye());
    // 4 x 2 pixels to a packet: they meet the same bricks more often than 8 x 1.
    constexpr std::uint32_t kWide = 4, kHigh = 2;
    for (std::uint32_t y = box.y0; y < box.y1; y += kHigh)
        for (std::uint32_t x = box.x0; x < box.x1; x += kWide) {
            RayPacket packet;
            Rays rays;
            bool any = false;
            for (int lane = 0; lane < kLanes; ++lane) {
                const PixelPlace place{x + std::uint32_t(lane) % kWide, y + std::uint32_t(lane) / kWide};
                if (place.x >= box.x1 || place.y >= box.y1) continue;
                const IndexRay ray(plan.camera->ray(place.x, place.y), channel_.transform());
                if (ray.parallel[0] || ray.parallel[1] || ray.parallel[2]) {
                    others_.push_back(place);
                    continue;
                }
                const RaySpan span = ray.clip(channel_.clipLow(), channel_.clipHigh(), {0, kNever});
                packet.set(lane, ray, span);
                rays.place[lane] = place;
                rays.unit[lane] = ray.unitLength();
                rays.first[lane] = span.begin;
                rays.last[lane] = span.end;
                rays.transmittance[lane] = 1;
                add(rays.used, lane);
                if (span.empty()) add(rays.settled, lane);
                any = true;
            }
            if (!any) continue;
            packets_.push_back(packet);
            rays_.push_back(std::move(rays));
        }
}

BeamTile::Progress BeamTile::advance(const RayContext& context) {
    while (phase_ != Phase::kDone) {
        bool finished = false;
        switch (phase_) {
            case Phase::kIntegrate:
                finished = integrate(context);
                if (finished) phase_ = plan_.quality.reference || settle() ? Phase::kLocate : Phase::kRefine;
                if (finished && phase_ == Phase::kLocate) beginLocating();
                break;
            case Phase::kRefine:
                finished = refine(context);
                if (!finished) break;
                if (settle()) {
                    phase_ = Phase::kLocate;
                    beginLocating();
                } else {
                    startCut();
                    phase_ = Phase::kIntegrate;
                }
                break;
            case Phase::kLocate:
                finished = locate(context);
                if (finished) phase_ = Phase::kDone;
                break;
            case Phase::kDone: break;
        }
        if (failed_) return Progress::kFailed;
        if (!finished) return Progress::kWaiting;
    }
    return Progress::kDone;
}

bool BeamTile::descends(const WalkedNode& node) const {
    return plan_.quality.reference || split_.contains(keyOf(node.ref));
}

bool BeamTile::usesDraft(const WalkedNode& node) const {
    return !plan_.quality.reference && node.record().hasDraft() && !whole_.contains(keyOf(node.ref));
}

// What was blocked in the last pass is taken up where it stopped.
void BeamTile::release() {
    any_blocked_ = false;
    for (std::size_t p = 0; p < packets_.size(); ++p) {
        Rays& rays = rays_[p];
        for (int lane = 0; lane < kLanes && rays.blocked; ++lane) {
            if (!holds(rays.blocked, lane)) continue;
            packets_[p].begin[lane] = rays.resume[lane];
            packets_[p].end[lane] = rays.last[lane];
        }
        rays.blocked = 0;
    }
}

// A new cut is integrated from the eye; rays that are settled keep theirs.
void BeamTile::startCut() {
    for (std::size_t p = 0; p < packets_.size(); ++p) {
        Rays& rays = rays_[p];
        bool all_settled = true;
        for (int lane = 0; lane < kLanes; ++lane) {
            if (!holds(rays.used, lane) || holds(rays.settled, lane)) {
                packets_[p].begin[lane] = kNever;
                continue;
            }
            packets_[p].begin[lane] = rays.first[lane];
            packets_[p].end[lane] = rays.last[lane];
            rays.depth[lane] = rays.low[lane] = rays.high[lane] = rays.variance[lane] = 0;
            for (Rays::Mark& mark : rays.marks) mark.end[lane] = -kNever;
            all_settled = false;
        }
        if (!all_settled && rays.settled == 0) rays.marks.clear();
    }
}

// The page of a node that has a brick, or nullptr: then it is wanted, or the tile has failed.
const float* BeamTile::samplesOf(const WalkedNode& node, std::size_t rays, double worth,
                                 const RayContext& context) {
    const bool draft = usesDraft(node);
    const PageAddress page{channel_.index(), node.ref.block, node.ref.node, draft};
    if (const float* samples = context.cache->find(page)) return samples;
    if (context.failed->contains({false, page})) {
        failed_ = true;
    } else if (!context.full()) {
        const NodeRecord& record = node.record();
        context.wants->add({false, page}, draft ? record.draft_bytes : record.payload_bytes,
                           worth / double(std::max<std::size_t>(rays, 1)) * double(rays), context.tile);
    }
    return nullptr;
}

// Rays of these spans miss a page: they stay where they are, and a scout goes on to see what else is missing.
// Where the cache is full of wants already, none goes.
void BeamTile::block(RayPacket& packet, Rays& rays, const PacketSpans& spans, double least,
                     const RayContext& context) {
    any_blocked_ = true;
    const bool scouts = !context.full();
    for (int lane = 0; lane < kLanes; ++lane) {
        if (!(spans.begin[lane] < spans.end[lane])) continue;
        if (!holds(rays.blocked, lane)) {
            add(rays.blocked, lane);
            rays.resume[lane] = packet.begin[lane];
            rays.at_least[lane] = rays.depth[lane];
        }
        rays.at_least[lane] += std::max(0.0, least) * (spans.end[lane] - spans.begin[lane]);
        packet.begin[lane] = scouts && rays.at_least[lane] * scale_ < kOpaqueDepth ? spans.end[lane] : kNever;
    }
}

BrickCells BeamTile::cellsOf(const WalkedNode& node, const float* samples) const {
    BrickCells cells;
    cells.samples = samples;
    cells.edge_samples = channel_.shape().edgeSamples();
    cells.cell_edge = cellEdge(node.key.level);
    const glm::dvec3 low = nodeLow(node.key, channel_.shape());
    for (std::size_t a = 0; a < 3; ++a) {
        cells.low[a] = low[int(a)];
        cells.box_begin[a] = node.record().box_begin[a];
        cells.box_end[a] = node.record().box_end[a];
    }
    return cells;
}

bool BeamTile::fitsKernel(const NodeRecord& record, int level) const {
    const double most = std::max(std::abs(double(record.value_max)), std::abs(double(record.value_min)));
    return most * scale_ * cellEdge(level) * channel_.transform().voxelSize() <= kMostVoxelDepth;
}

void BeamTile::sumNode(const WalkedNode& node, const float* samples, const RayPacket& packet,
                       const PacketSpans& spans, double* sums) const {
    const NodeRecord& record = node.record();
    if (!samples) {
        const double value =
            std::max(0.0, double(toFloat(channel_.type(), node.block->constant(node.ref.node)[0])));
        for (int lane = 0; lane < kLanes; ++lane)
            if (spans.begin[lane] < spans.end[lane])
                sums[lane] += value * (spans.end[lane] - spans.begin[lane]);
    } else if (fitsKernel(record, node.key.level)) {
        integrateBrick(packet, cellsOf(node, samples), spans, sums);
    } else {
        for (int lane = 0; lane < kLanes; ++lane) {
            if (!(spans.begin[lane] < spans.end[lane])) continue;
            walkCells(samples, channel_.shape(), node.key, record, rayOf(packet, lane),
                      {spans.begin[lane], spans.end[lane]},
                      [&](const Cell& cell, const glm::dvec3& from, const glm::dvec3& to, double begin,
                          double end) { sums[lane] += meanPositive(cell, from, to) * (end - begin); });
        }
    }
}

void BeamTile::integrateNode(const WalkedNode& node, PacketList list, const RayContext& context) {
    const bool missing_block = node.status == WalkStatus::kMissingBlock;
    const bool has_brick = !missing_block && node.record().hasBrick();
    const float* samples = nullptr;
    bool missing = missing_block;
    if (missing_block) {
        const WantedPage page{true, {channel_.index(), node.missing_block, 0}};
        if (context.failed->contains(page))
            failed_ = true;
        else if (!context.full())
            context.wants->add(page, std::uint32_t(channel_.blockBytes(node.missing_block)),
                               double(list.count), context.tile);
    } else if (has_brick) {
        // Worth: what the rays that meet it still let through.
        double worth = 0;
        for (std::uint16_t p : list)
            for (double transmittance : rays_[p].transmittance) worth += transmittance * transmittance;
        samples = samplesOf(node, list.count, worth, context);
        missing = !samples;
    }
    if (failed_) return;

    const glm::dvec3 low = nodeLow(node.key, channel_.shape());
    const double edge = nodeEdge(node.key, channel_.shape());
    const glm::dvec3 high = low + edge;
    NodeErrors errors;
    bool exact = true;
    if (!missing) {
        const NodeRecord& record = node.record();
        const bool draft = has_brick && usesDraft(node);
        exact = !draft && record.bound == 0;
        if (draft)
            errors = errorsOfDraft(record);
        else if (!exact)
            errors = errorsOfNode(record, node.block->errorGrid(node.ref.node));
    }
    for (std::uint16_t p : list) {
        RayPacket& packet = packets_[p];
        Rays& rays = rays_[p];
        PacketSpans spans;
        clipPacket(packet, &low[0], &high[0], spans);
        if (missing) {
            block(packet, rays, spans, missing_block ? 0.0 : double(node.record().value_min), context);
            continue;
        }
        const NodeRecord& record = node.record();
        if (rays.blocked) {
            PacketSpans scouts = spans;
            for (int lane = 0; lane < kLanes; ++lane)
                (holds(rays.blocked, lane) ? spans : scouts).end[lane] = -kNever;
            block(packet, rays, scouts, double(record.value_min), context);
        }
        alignas(64) double sums[kLanes] = {}, half_width[kLanes] = {}, square[kLanes] = {};
        sumNode(node, samples, packet, spans, sums);
        if (!exact && !errors.uniform)
            integrateGrid(packet, &low[0], edge, spans, errors.bound, errors.square, half_width, square);
        Rays::Mark mark;
        for (int lane = 0; lane < kLanes; ++lane) {
            mark.end[lane] = -kNever;
            if (!(spans.begin[lane] < spans.end[lane])) continue;
            const double length = spans.end[lane] - spans.begin[lane];
            if (!exact && errors.uniform) {
                half_width[lane] = errors.bound[0] * length;
                square[lane] = errors.square[0] * length;
            }
            const double sum = sums[lane];
            const double rounding =
                sum * kSumRounding + (samples ? kKernelRounding * double(record.value_max) * length : 0.0);
            // The range of the node's values bounds the integral too.
            const double background = double(channel_.background());
            const double low_sum = std::max(sum - half_width[lane] - rounding,
                                            std::min(double(record.value_min), background) * length);
            const double high_sum =
                std::min(sum + half_width[lane] + rounding,
                         std::max(double(record.value_max), background) * length * (1 + kSumRounding));
            rays.depth[lane] += sum;
            rays.low[lane] += std::clamp(low_sum, 0.0, sum);
            rays.high[lane] += std::max(high_sum, sum);
            rays.variance[lane] += square[lane] * rays.unit[lane] * cellEdge(node.key.level);
            packet.begin[lane] = rays.depth[lane] * scale_ > kOpaqueDepth ? kNever : spans.end[lane];
            mark.end[lane] = spans.end[lane];
            mark.depth[lane] = rays.depth[lane];
        }
        rays.marks.push_back(mark);
    }
}

bool BeamTile::integrate(const RayContext& context) {
    release();
    walkPackets(
        channel_, packets_, order_, [&](const WalkedNode& node) { return !failed_ && descends(node); },
        [&](const WalkedNode& node, PacketList list) {
            if (!failed_) integrateNode(node, list, context);
        });
    return !any_blocked_ && !failed_;
}

RayComposite BeamTile::composite(const Rays& rays, int lane) const {
    RayComposite out;
    out.optical_depth = rays.depth[lane] * scale_;
    out.optical_low = rays.low[lane] * scale_;
    out.optical_high = rays.high[lane] * scale_;
    compositeAlpha(out, rays.variance[lane] * scale_ * scale_, !(rays.first[lane] < rays.last[lane]));
    out.depth = rays.distance[lane];
    return out;
}

// Rays that are good enough are settled. True when all are.
bool BeamTile::settle() {
    bool all = true;
    for (Rays& rays : rays_)
        for (int lane = 0; lane < kLanes; ++lane) {
            if (!holds(rays.used, lane) || holds(rays.settled, lane)) continue;
            const RayComposite now = composite(rays, lane);
            rays.transmittance[lane] = now.transmittance;
            if (now.estimate_alpha <= plan_.quality.max_error / 3)
                add(rays.settled, lane);
            else
                all = false;
        }
    return all;
}

// A node of the cut while it is refined, with the variance that each ray gets from it.
struct BeamTile::Item {
    WalkedNode node;
    bool draft = false;
    double rank =
        0;  // what a split does for all rays: the node's squared error over its volume; 0: none can help
    std::vector<std::uint16_t> packets;
    std::vector<std::array<float, kLanes>> variance;
};

BeamTile::Item BeamTile::describe(const WalkedNode& node, PacketList list) const {
    Item item;
    item.node = node;
    const NodeRecord& record = node.record();
    item.draft = record.hasBrick() && usesDraft(node);
    const glm::dvec3 low = nodeLow(node.key, channel_.shape());
    const double edge = nodeEdge(node.key, channel_.shape());
    const glm::dvec3 high = low + edge;
    const double cell = cellEdge(node.key.level);
    if (!item.draft && record.bound == 0) return item;
    const NodeErrors errors =
        item.draft ? errorsOfDraft(record) : errorsOfNode(record, node.block->errorGrid(node.ref.node));
    double nearest = kNever;
    item.packets.assign(list.begin(), list.end());
    item.variance.resize(list.count);
    for (std::size_t k = 0; k < list.count; ++k) {
        const RayPacket& packet = packets_[list.places[k]];
        const Rays& rays = rays_[list.places[k]];
        PacketSpans spans;
        clipPacket(packet, &low[0], &high[0], spans);
        alignas(64) double ignored[kLanes] = {}, square[kLanes] = {};
        if (!errors.uniform)
            integrateGrid(packet, &low[0], edge, spans, errors.bound, errors.square, ignored, square);
        for (int lane = 0; lane < kLanes; ++lane) {
            const double length = spans.end[lane] - spans.begin[lane];
            if (!(length > 0)) continue;
            if (errors.uniform) square[lane] = errors.square[0] * length;
            const double effect = rays.transmittance[lane] * scale_;
            item.variance[k][std::size_t(lane)] =
                float(square[lane] * rays.unit[lane] * cell * effect * effect);
            const double pixel = plan_.camera->pixelEdge() * 0.5 * (spans.begin[lane] + spans.end[lane]);
            nearest = std::min(nearest, pixel / rays.unit[lane]);
        }
    }
    if (!item.draft && !canDescend(node)) return item;
    if (plan_.quality.pixels_per_voxel > 0 && cell <= plan_.quality.pixels_per_voxel * nearest) return item;
    const double deviation = double(item.draft ? record.draft_rms : record.rms);
    item.rank = deviation * deviation * cell * cell * cell;
    return item;
}

// Splits, by topology alone, what the rays that are not settled ask for; worst node first. False while a tree
// block is missing: then all is as before.
bool BeamTile::refine(const RayContext& context) {
    startCut();
    std::vector<Item> items;
    auto byRank = [&](std::size_t a, std::size_t b) {
        return items[a].rank != items[b].rank ? items[a].rank < items[b].rank : a > b;
    };
    std::priority_queue<std::size_t, std::vector<std::size_t>, decltype(byRank)> queue(byRank);
    // By ray: variance of alpha, and whether a node that it meets was split.
    std::vector<std::array<double, kLanes>> sums(packets_.size());
    std::vector<std::uint8_t> touched(packets_.size());
    auto account = [&](const Item& item, double sign) {
        for (std::size_t k = 0; k < item.packets.size(); ++k)
            for (std::size_t lane = 0; lane < kLanes; ++lane)
                sums[item.packets[k]][lane] += sign * double(item.variance[k][lane]);
    };
    bool missing = false;
    auto wantBlock = [&](std::uint32_t block, std::size_t rays) {
        const WantedPage page{true, {channel_.index(), block, 0}};
        if (context.failed->contains(page)) return;
        missing = true;
        context.wants->add(page, std::uint32_t(channel_.blockBytes(block)), double(rays), context.tile);
    };
    auto take = [&](const WalkedNode& node, PacketList list) {
        if (node.status == WalkStatus::kMissingBlock) return wantBlock(node.missing_block, list.count);
        items.push_back(describe(node, list));
        account(items.back(), 1);
        if (items.back().rank > 0) queue.push(items.size() - 1);
    };
    walkPackets(channel_, packets_, order_, [&](const WalkedNode& node) { return descends(node); }, take);

    const double target = plan_.quality.max_error / 3 * plan_.quality.max_error / 3;
    std::vector<std::uint64_t> split, whole;
    auto stay = [](const WalkedNode&) { return false; };
    while (!queue.empty()) {
        const std::size_t at = queue.top();
        queue.pop();
        bool needed = false;
        for (std::size_t k = 0; k < items[at].packets.size() && !needed; ++k) {
            const std::uint16_t p = items[at].packets[k];
            for (int lane = 0; lane < kLanes && !needed; ++lane)
                needed = items[at].variance[k][std::size_t(lane)] > 0 &&
                         (sums[p][std::size_t(lane)] > target || !holds(touched[p], lane));
        }
        if (!needed) continue;
        Item item = std::move(items[at]);
        const PacketList list{item.packets.data(), item.packets.size()};
        if (!item.draft) {
            const ChildrenRef children = item.node.block->children(item.node.ref.node);
            if (!channel_.block(children.block)) {
                wantBlock(children.block, list.count);
                continue;
            }
        }
        for (std::size_t k = 0; k < item.packets.size(); ++k)
            for (int lane = 0; lane < kLanes; ++lane)
                if (item.variance[k][std::size_t(lane)] > 0) add(touched[item.packets[k]], lane);
        account(item, -1);
        if (item.draft) {
            whole.push_back(keyOf(item.node.ref));
            whole_.insert(whole.back());
            take(item.node, list);
        } else {
            split.push_back(keyOf(item.node.ref));
            split_.insert(split.back());
            PacketWalk<decltype(stay), decltype(take)>(channel_, packets_, order_, stay, take)
                .children(item.node, list);
        }
    }
    if (missing) {
        for (std::uint64_t key : split) split_.erase(key);
        for (std::uint64_t key : whole) whole_.erase(key);
        return false;
    }
    // A ray that no split could touch has the finest there is.
    for (std::size_t p = 0; p < packets_.size(); ++p)
        for (int lane = 0; lane < kLanes; ++lane)
            if (holds(rays_[p].used, lane) && !holds(rays_[p].settled, lane) && !holds(touched[p], lane)) {
                add(rays_[p].settled, lane);
                add(rays_[p].stuck, lane);
            }
    return true;
}

// The marks tell between which two nodes' ends a ray reaches half its opacity; that stretch is walked again.
void BeamTile::beginLocating() {
    for (std::size_t p = 0; p < packets_.size(); ++p) {
        Rays& rays = rays_[p];
        for (int lane = 0; lane < kLanes; ++lane) {
            packets_[p].begin[lane] = kNever;
            if (!(rays.depth[lane] > 0)) continue;
            const double alpha = -std::expm1(-rays.depth[lane] * scale_);
            const double target = -std::log1p(-0.5 * alpha) / scale_;
            if (!(target > 0)) continue;
            double begin = rays.first[lane], before = 0;
            for (const Rays::Mark& mark : rays.marks) {
                if (!(mark.end[lane] > -kNever)) continue;
                if (mark.depth[lane] >= target) {
                    packets_[p].begin[lane] = begin;
                    packets_[p].end[lane] = rays.last[lane] = mark.end[lane];
                    rays.distance[lane] = mark.end[lane];
                    break;
                }
                begin = mark.end[lane];
                before = mark.depth[lane];
            }
            rays.target[lane] = target;
            rays.depth[lane] = rays.depth[lane];
            rays.resume[lane] = begin;
            rays.at_least[lane] = before;
        }
        rays.marks = {};
    }
}

void BeamTile::findInNode(const WalkedNode& node, const float* samples, const RayPacket& packet,
                          const PacketSpans& spans, const double* targets, double* sums,
                          double* found) const {
    if (samples && fitsKernel(node.record(), node.key.level))
        return findInBrick(packet, cellsOf(node, samples), spans, targets, sums, found);
    for (int lane = 0; lane < kLanes; ++lane) {
        if (!(spans.begin[lane] < spans.end[lane])) continue;
        bool done = false;
        auto step = [&](double begin, double end, double amount) {
            if (!done && amount > 0 && sums[lane] + amount >= targets[lane]) {
                found[lane] =
                    begin + (end - begin) * std::clamp((targets[lane] - sums[lane]) / amount, 0.0, 1.0);
                done = true;
            }
            sums[lane] += amount;
        };
        if (!samples) {
            const double value = toFloat(channel_.type(), node.block->constant(node.ref.node)[0]);
            step(spans.begin[lane], spans.end[lane],
                 std::max(0.0, value) * (spans.end[lane] - spans.begin[lane]));
        } else {
            walkCells(samples, channel_.shape(), node.key, node.record(), rayOf(packet, lane),
                      {spans.begin[lane], spans.end[lane]},
                      [&](const Cell& cell, const glm::dvec3& from, const glm::dvec3& to, double begin,
                          double end) { step(begin, end, meanPositive(cell, from, to) * (end - begin)); });
        }
    }
}

bool BeamTile::locate(const RayContext& context) {
    any_blocked_ = false;
    walkPackets(
        channel_, packets_, order_, [&](const WalkedNode& node) { return descends(node); },
        [&](const WalkedNode& node, PacketList list) {
            const float* samples = nullptr;
            if (node.record().hasBrick()) {
                samples = samplesOf(node, list.count, double(list.count), context);
                if (!samples) {
                    any_blocked_ = true;
                    return;  // its rays stay
                }
            }
            const glm::dvec3 low = nodeLow(node.key, channel_.shape());
            const glm::dvec3 high = low + nodeEdge(node.key, channel_.shape());
            for (std::uint16_t p : list) {
                PacketSpans spans;
                clipPacket(packets_[p], &low[0], &high[0], spans);
                alignas(64) double sums[kLanes];
                std::copy(rays_[p].at_least, rays_[p].at_least + kLanes, sums);
                findInNode(node, samples, packets_[p], spans, rays_[p].target, sums, rays_[p].distance);
                for (int lane = 0; lane < kLanes; ++lane)
                    if (spans.begin[lane] < spans.end[lane]) packets_[p].begin[lane] = kNever;
            }
        });
    return !any_blocked_ && !failed_;
}

}  // namespace brickyard

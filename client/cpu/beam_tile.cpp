#include "client/cpu/beam_tile.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "client/brick_page.h"
#include "client/cpu/cell_walk.h"
#include "client/cpu/cut_refinement.h"
#include "client/cpu/node_error.h"

namespace brickyard {

namespace {

constexpr int kLanes = RayPacket::kRays;
constexpr double kNever = std::numeric_limits<double>::infinity();
// Beyond this optical depth nothing shows: exp(-46) = 1e-20.
constexpr double kOpaqueDepth = 46;
// Relative rounding of a double sum over the cells of a node.
constexpr double kSumRounding = 1e-12;
// The float kernel takes bricks whose densest voxel has no more optical depth than this: its rounding then
// stays below what a pixel of floats shows. Denser bricks are summed in double, and so are values near a
// float's own limits.
constexpr double kMostVoxelDepth = 16;
constexpr double kLeastKernelValue = 1e-30, kMostKernelValue = 1e34;
// A cut that has been made anew this often is as good as it gets; each round settles most of its rays.
constexpr std::uint8_t kMostCuts = 12;

// Buffers that every tile of a thread uses again.
thread_local CornerQuads t_quads;

IndexRay rayOf(const RayPacket& packet, int lane) {
    IndexRay ray;
    for (int a = 0; a < 3; ++a) {
        ray.origin[a] = packet.origin[a][lane];
        ray.direction[a] = packet.direction[a][lane];
        ray.inverse[a] = packet.inverse[a][lane];
    }
    return ray;
}

bool inSpan(const PacketSpans& spans, int lane) { return spans.begin[lane] < spans.end[lane]; }

}  // namespace

bool BeamTile::canTrace(const RenderPlan& plan) {
    return !plan.scene.light && !plan.emission && !plan.density->empty() && !(plan.density->background() > 0);
}

BeamTile::BeamTile(const RenderPlan& plan, const PixelBox& box, Cut cut)
    : plan_(plan),
      channel_(*plan.density),
      scale_(plan.scene.density_scale),
      resident_(cut == Cut::kResident),
      pixels_(packetsOf(*plan.camera, *plan.density, box)) {
    order_.kind = FrontToBack::Kind::kFromPoint;
    order_.vector = channel_.transform().inversePoint(plan.camera->eye());
    if (plan.quality.reference) cut_ = TileCut::finest();
    assert(pixels_.packets.size() <= kMostTilePackets);
    rays_.resize(pixels_.packets.size());
    for (std::size_t p = 0; p < rays_.size(); ++p) {
        BeamRays& rays = rays_[p];
        rays.settled = rays.located = std::uint16_t(~pixels_.lanes[p].used);
        std::copy_n(pixels_.packets[p].begin, kLanes, rays.first);
        std::copy_n(pixels_.packets[p].end, kLanes, rays.last);
        std::fill_n(rays.transmittance, kLanes, 1.0);
    }
    marks_.reserve(16 * rays_.size());
}

BeamTile::Progress BeamTile::advance(const RayContext& context) {
    if (rays_.empty()) phase_ = Phase::kDone;
    while (phase_ != Phase::kDone) {
        bool finished = false;
        switch (phase_) {
            case Phase::kIntegrate:
                finished = integrate(context);
                if (finished)
                    phase_ =
                        resident_ || plan_.quality.reference || settle() ? Phase::kLocate : Phase::kRefine;
                break;
            case Phase::kRefine:
                finished = refine(context);
                if (!finished) break;
                phase_ = allSettled() ? Phase::kLocate : Phase::kIntegrate;
                if (phase_ == Phase::kIntegrate) startCut();
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

bool BeamTile::childrenResident(const WalkedNode& node, const RayContext& context) const {
    const ChildrenRef first = node.block->children(node.ref.node);
    const TreeBlock* block = channel_.block(first.block);
    if (!block) return false;
    const std::uint32_t count = std::uint32_t(__builtin_popcount(node.block->validMask(node.ref.node)));
    for (std::uint32_t child = first.first; child < first.first + count; ++child)
        if (block->record(child).hasBrick() &&
            !context.cache->contains({channel_.index(), first.block, child, false}) &&
            !context.cache->contains({channel_.index(), first.block, child, true}))
            return false;
    return true;
}

PacketMask BeamTile::descends(const WalkedNode& node, const RayContext& context) const {
    if (resident_) return childrenResident(node, context) ? kAllPackets : 0;
    return cut_.descends(node);
}

// What was blocked in the last pass is taken up where it stopped.
void BeamTile::release() {
    if (!any_blocked_) return;
    any_blocked_ = false;
    for (std::size_t p = 0; p < rays_.size(); ++p) {
        BeamRays& rays = rays_[p];
        for (int lane = 0; lane < kLanes && rays.blocked; ++lane) {
            if (!hasLane(rays.blocked, lane)) continue;
            pixels_.packets[p].begin[lane] = rays.resume[lane];
            pixels_.packets[p].end[lane] = rays.last[lane];
        }
        rays.blocked = 0;
    }
}

// A new cut is integrated from the eye; rays that are settled keep theirs.
void BeamTile::startCut() {
    ++cut_number_;
    for (std::size_t p = 0; p < rays_.size(); ++p) {
        BeamRays& rays = rays_[p];
        RayPacket& packet = pixels_.packets[p];
        for (int lane = 0; lane < kLanes; ++lane) {
            if (hasLane(rays.settled, lane)) {
                packet.begin[lane] = kNever;
                continue;
            }
            packet.begin[lane] = rays.first[lane];
            packet.end[lane] = rays.last[lane];
            rays.depth[lane] = rays.low[lane] = rays.high[lane] = rays.variance[lane] = 0;
            rays.cut[lane] = cut_number_;
        }
    }
}

// The page of a node that has a brick, or nullptr: then it is wanted, or the tile has failed.
const float* BeamTile::samplesOf(const WalkedNode& node, bool draft, double worth,
                                 const RayContext& context) {
    const PageAddress page{channel_.index(), node.ref.block, node.ref.node, draft};
    if (const float* samples = context.cache->find(page)) return samples;
    if (context.failed->contains({false, page})) {
        failed_ = true;
    } else if (!context.full()) {
        const NodeRecord& record = node.record();
        context.wants->add({false, page}, draft ? record.draft_bytes : record.payload_bytes, worth,
                           context.tile);
    }
    return nullptr;
}

// Rays of these spans miss a page: they stay where they are, and a scout goes on to see what else is missing.
// Where the cache is full of wants already, none goes.
void BeamTile::block(std::uint16_t place, const PacketSpans& spans, double least, const RayContext& context) {
    any_blocked_ = true;
    const bool scouts = !context.full();
    BeamRays& rays = rays_[place];
    RayPacket& packet = pixels_.packets[place];
    for (int lane = 0; lane < kLanes; ++lane) {
        if (!inSpan(spans, lane)) continue;
        if (!hasLane(rays.blocked, lane)) {
            addLane(rays.blocked, lane);
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
    cells.negative = node.record().value_min < 0 || channel_.background() < 0;
    return cells;
}

bool BeamTile::fitsKernel(const NodeRecord& record, int level) const {
    const double most = std::max(std::abs(double(record.value_max)), std::abs(double(record.value_min)));
    return most * scale_ * cellEdge(level) * channel_.transform().voxelSize() <= kMostVoxelDepth &&
           most >= kLeastKernelValue && most <= kMostKernelValue;
}

void BeamTile::sumNode(const WalkedNode& node, const Visit& visit, const BrickCells& cells,
                       const RayPacket& packet, const PacketSpans& spans, double* sums) const {
    if (!visit.samples) {
        for (int lane = 0; lane < kLanes; ++lane)
            if (inSpan(spans, lane)) sums[lane] += visit.constant * (spans.end[lane] - spans.begin[lane]);
    } else if (visit.in_kernel) {
        integrateBrick(packet, cells, spans, sums);
    } else {
        for (int lane = 0; lane < kLanes; ++lane) {
            if (!inSpan(spans, lane)) continue;
            walkCells(visit.samples, channel_.shape(), node.key, node.record(), rayOf(packet, lane),
                      {spans.begin[lane], spans.end[lane]},
                      [&](const Cell& cell, const glm::dvec3& from, const glm::dvec3& to, double begin,
                          double end) { sums[lane] += meanPositive(cell, from, to) * (end - begin); });
        }
    }
}

// What can be drawn of a node with the pages that are there; without any, the middle of its range.
void BeamTile::visitResident(const WalkedNode& node, const RayContext& context, Visit& out) const {
    const NodeRecord& record = node.record();
    const PageAddress page{channel_.index(), node.ref.block, node.ref.node, false};
    PageAddress draft = page;
    draft.draft = true;
    out.samples = context.cache->find(page);
    if (!out.samples) out.samples = context.cache->find(draft), out.draft = out.samples != nullptr;
    if (out.samples) return;
    const double low = std::max(0.0, double(record.value_min));
    const double high = std::max(low, double(record.value_max));
    out.constant = 0.5 * (low + high);
    out.errors.bound_scale = 0.5 * (high - low);
    out.errors.square_scale = (high - low) * (high - low) / 12;
}

BeamTile::Visit BeamTile::visit(const WalkedNode& node, bool draft, PacketList list,
                                const RayContext& context) {
    Visit out;
    if (node.status == WalkStatus::kMissingBlock) {
        if (resident_) {
            out.errors.bound_scale = out.errors.square_scale = std::numeric_limits<float>::max();
            return out;
        }
        out.missing = true;
        const WantedPage page{true, {channel_.index(), node.missing_block, 0}};
        if (context.failed->contains(page))
            failed_ = true;
        else if (!context.full())
            context.wants->add(page, std::uint32_t(channel_.blockBytes(node.missing_block)),
                               double(list.count), context.tile);
        return out;
    }
    const NodeRecord& record = node.record();
    if (!record.hasBrick()) {
        out.constant =
            std::max(0.0, double(toFloat(channel_.type(), node.block->constant(node.ref.node)[0])));
        out.errors = errorsOfNode(record, node.block->errorGrid(node.ref.node));
        return out;
    }
    if (resident_) {
        visitResident(node, context, out);
        if (!out.samples) return out;
    } else {
        out.draft = draft;
        // Worth: what the rays that meet it still let through.
        double worth = 0;
        for (std::uint16_t p : list)
            for (double transmittance : rays_[p].transmittance) worth += transmittance * transmittance;
        out.samples = samplesOf(node, out.draft, worth, context);
        out.missing = !out.samples;
        if (out.missing) return out;
    }
    out.errors =
        out.draft ? errorsOfDraft(record) : errorsOfNode(record, node.block->errorGrid(node.ref.node));
    out.in_kernel = fitsKernel(record, node.key.level);
    if (out.in_kernel) {
        const BrickShape shape = channel_.shape();
        const double most = std::max(double(record.value_max), -double(record.value_min));
        const double steepness = double(steepnessOfPage(out.samples, shape));
        out.rounding = kPositionRounding * shape.edge_cells * steepness + kSampleRounding * most;
        out.lost = (most + steepness) * kLostLength * cellEdge(node.key.level);
    }
    return out;
}

void BeamTile::integrateNode(const WalkedNode& node, bool draft, PacketList list, const RayContext& context) {
    const Visit met = visit(node, draft, list, context);
    if (failed_) return;
    BrickCells cells;
    if (met.samples) {
        cells = cellsOf(node, met.samples);
        if (met.in_kernel && list.count * kLanes >= kRaysForQuads) cells.quads = t_quads.of(cells);
    }
    if (!met.missing) nodes_.push_back(node);
    for (std::uint16_t place : list) integratePacket(node, met, cells, place, context);
}

void BeamTile::integratePacket(const WalkedNode& node, const Visit& met, const BrickCells& cells,
                               std::uint16_t place, const RayContext& context) {
    RayPacket& packet = pixels_.packets[place];
    BeamRays& rays = rays_[place];
    const glm::dvec3 low = nodeLow(node.key, channel_.shape());
    const double edge = nodeEdge(node.key, channel_.shape());
    const glm::dvec3 high = low + edge;
    PacketSpans spans;
    clipPacket(packet, &low[0], &high[0], spans);
    const double value_min = met.missing && node.status == WalkStatus::kMissingBlock ? 0.0
                             : node.status == WalkStatus::kMissingBlock              ? 0.0
                                                                        : double(node.record().value_min);
    if (met.missing) return block(place, spans, value_min, context);
    if (rays.blocked) {
        // Scouts integrate nothing: what lies in front of them is not there yet.
        PacketSpans scouts = spans;
        for (int lane = 0; lane < kLanes; ++lane)
            (hasLane(rays.blocked, lane) ? spans : scouts).end[lane] = -kNever;
        block(place, scouts, value_min, context);
    }
    alignas(64) double sums[kLanes] = {}, half_width[kLanes] = {}, square[kLanes] = {};
    sumNode(node, met, cells, packet, spans, sums);
    if (!met.errors.exact() && !met.errors.uniform)
        integrateGrid(packet, &low[0], edge, spans, met.errors.bound, met.errors.square, half_width, square);

    Mark& mark = marks_.emplace_back();
    mark.node = std::uint32_t(nodes_.size() - 1);
    mark.previous = rays.last_mark;
    mark.cut = cut_number_;
    rays.last_mark = std::int32_t(marks_.size() - 1);
    const double cell = cellEdge(node.key.level);
    // Floats that stand for errors were summed in float: a hair more makes up for it.
    constexpr double kErrorSlack = 1 + 1e-5;
    for (int lane = 0; lane < kLanes; ++lane) {
        mark.end[lane] = -kNever;
        if (!inSpan(spans, lane)) continue;
        const double length = spans.end[lane] - spans.begin[lane];
        const double sum = sums[lane], unit = pixels_.lanes[place].unit[lane];
        double wide = sum * kSumRounding + met.rounding * length + met.lost * unit;
        if (!met.errors.exact()) {
            wide += (met.errors.uniform ? length : half_width[lane]) * met.errors.bound_scale * kErrorSlack;
            rays.variance[lane] +=
                (met.errors.uniform ? length : square[lane]) * met.errors.square_scale * unit * cell;
        }
        double least = std::max(0.0, sum - wide), most = sum + wide;
        if (node.status != WalkStatus::kMissingBlock) {
            // The range of the node's values bounds the integral too; outside its samples lies the
            // background.
            const NodeRecord& record = node.record();
            least =
                std::max(least, std::min(double(record.value_min), double(channel_.background())) * length);
            most = std::min(most, std::max(double(record.value_max), 0.0) * length * (1 + kSumRounding));
        }
        rays.depth[lane] += sum;
        rays.low[lane] += std::min(least, sum);
        rays.high[lane] += std::max(most, sum);
        packet.begin[lane] = rays.depth[lane] * scale_ > kOpaqueDepth ? kNever : spans.end[lane];
        mark.end[lane] = spans.end[lane];
        mark.depth[lane] = rays.depth[lane];
    }
}

bool BeamTile::integrate(const RayContext& context) {
    release();
    walkPackets(
        channel_, pixels_.packets, order_,
        [&](const WalkedNode& node) { return failed_ ? 0 : descends(node, context); },
        [&](const WalkedNode& node, PacketList list) {
            if (failed_) return;
            const PacketMask drafts = node.status == WalkStatus::kMissingBlock ? 0 : cut_.usesDraft(node);
            std::uint16_t draft[kMostTilePackets], whole[kMostTilePackets];
            std::size_t draft_count = 0, whole_count = 0;
            for (std::uint16_t place : list)
                (drafts & maskOf(place) ? draft[draft_count++] : whole[whole_count++]) = place;
            if (draft_count > 0) integrateNode(node, true, {draft, draft_count}, context);
            if (whole_count > 0 && !failed_) integrateNode(node, false, {whole, whole_count}, context);
        });
    return !any_blocked_ && !failed_;
}

AlphaComposite BeamTile::alphaOf(std::size_t place, int lane) const {
    const BeamRays& rays = rays_[place];
    return compositeAlpha(rays.depth[lane] * scale_, rays.low[lane] * scale_, rays.high[lane] * scale_,
                          rays.variance[lane] * scale_ * scale_);
}

Pixel BeamTile::pixelOf(std::size_t place, int lane) const {
    const AlphaComposite alpha = alphaOf(place, lane);
    Pixel pixel;
    pixel.alpha = float(alpha.alpha);
    pixel.bound_alpha = float(alpha.bound);
    pixel.estimate_alpha = float(alpha.estimate);
    pixel.depth = float(rays_[place].distance[lane]);
    return pixel;
}

bool BeamTile::settle() {
    const QualitySettings& quality = plan_.quality;
    bool all = true;
    for (std::size_t p = 0; p < rays_.size(); ++p) {
        BeamRays& rays = rays_[p];
        for (int lane = 0; lane < kLanes; ++lane) {
            if (hasLane(rays.settled, lane)) continue;
            const AlphaComposite now = alphaOf(p, lane);
            rays.transmittance[lane] = now.transmittance;
            if (quality.strict ? now.bound <= quality.max_error : now.estimate <= quality.max_error / 3)
                addLane(rays.settled, lane);
            else
                all = false;
        }
    }
    return all;
}

bool BeamTile::allSettled() const {
    return std::all_of(rays_.begin(), rays_.end(),
                       [](const BeamRays& rays) { return rays.settled == 0xffff; });
}

std::uint64_t BeamTile::stuckRays() const {
    std::uint64_t count = 0;
    for (const BeamRays& rays : rays_) count += std::uint64_t(__builtin_popcount(rays.stuck));
    return count;
}

// Splits, by topology alone, what the rays that are not settled ask for. False while a tree block is missing:
// then all is as before.
bool BeamTile::refine(const RayContext& context) {
    std::vector<CutRays> rays(rays_.size());
    for (std::size_t p = 0; p < rays_.size(); ++p) {
        CutRays& asks = rays[p];
        asks.packet = pixels_.packets[p];
        for (int lane = 0; lane < kLanes; ++lane) {
            asks.packet.begin[lane] = hasLane(rays_[p].settled, lane) ? kNever : rays_[p].first[lane];
            asks.packet.end[lane] = rays_[p].last[lane];
            asks.unit[lane] = pixels_.lanes[p].unit[lane];
            // What a change of the field does to the pixel: at most, or as far as is known.
            asks.effect[lane] = scale_ * (plan_.quality.strict ? std::exp(-rays_[p].low[lane] * scale_)
                                                               : rays_[p].transmittance[lane]);
        }
    }
    if (cut_number_ >= kMostCuts || !refineCut(plan_, order_, rays, context, cut_)) {
        if (cut_number_ < kMostCuts) return false;
    }
    // A ray that no split could touch has the finest there is.
    for (std::size_t p = 0; p < rays_.size(); ++p)
        for (int lane = 0; lane < kLanes; ++lane)
            if (!hasLane(rays_[p].settled, lane) && !hasLane(rays[p].touched, lane)) {
                addLane(rays_[p].settled, lane);
                addLane(rays_[p].stuck, lane);
            }
    return true;
}

}  // namespace brickyard

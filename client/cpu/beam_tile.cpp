#include "client/cpu/beam_tile.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "client/cpu/cell_walk.h"
#include "client/cpu/cut_refinement.h"
#include "client/cpu/node_cells.h"
#include "client/cpu/node_error.h"

namespace brickyard {

namespace {

constexpr int kLanes = RayPacket::kRays;
constexpr double kNever = std::numeric_limits<double>::infinity();
// Beyond this optical depth nothing shows: exp(-46) = 1e-20.
constexpr double kOpaqueDepth = 46;
// Relative rounding of a double sum over the cells of a node.
constexpr double kSumRounding = 1e-12;
// A cut that has been made anew this often is as good as it gets; each round settles most of its rays.
constexpr std::uint8_t kMostCuts = 12;

// Buffers that every tile of a thread uses again.
thread_local CornerQuads t_quads;

bool inSpan(const PacketSpans& spans, int lane) { return spans.begin[lane] < spans.end[lane]; }

}  // namespace

bool BeamTile::canTrace(const RenderPlan& plan) {
    return !plan.emission && !eyeIsFar(plan) && !plan.density->empty() && !(plan.density->background() > 0);
}

BeamTile::BeamTile(const RenderPlan& plan, LightField* light, const PixelBox& box,
                   const ResidentTree* resident)
    : plan_(plan),
      channel_(*plan.density),
      light_(light),
      scale_(plan.scene.density_scale),
      resident_(resident != nullptr),
      pixels_(packetsOf(*plan.camera, *plan.density, box)) {
    if (resident) drawn_.emplace(*resident);
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
        std::fill_n(rays.front, kLanes, 1.0);
    }
    marks_.reserve(16 * rays_.size());
    // Where the cut is known from the start, one walk does both.
    if (light_ && (resident_ || plan.quality.reference)) {
        phase_ = Phase::kScatter;
        lit_ = true;
    }
}

BeamTile::Progress BeamTile::advance(const RayContext& context) {
    if (rays_.empty()) phase_ = Phase::kDone;
    while (phase_ != Phase::kDone) {
        bool finished = false;
        switch (phase_) {
            case Phase::kIntegrate:
            case Phase::kScatter:
                finished = integrate(context);
                if (finished)
                    phase_ = resident_ || plan_.quality.reference ? Phase::kLocate
                             : !settle()                          ? Phase::kRefine
                             : light_ && !lit_                    ? startScatter()
                                                                  : Phase::kLocate;
                break;
            case Phase::kRefine:
                finished = refine(context);
                if (!finished) break;
                if (light_ && !lit_) {
                    phase_ = startScatter();
                } else if (allSettled()) {
                    phase_ = Phase::kLocate;
                } else {
                    startCut(/*all=*/false);
                    phase_ = light_ ? Phase::kScatter : Phase::kIntegrate;
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

PacketMask BeamTile::descends(const WalkedNode& node) {
    if (!resident_) return cut_.descends(node);
    drawn_->at(node);
    return drawn_->finerBelow(node) ? kAllPackets : 0;
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

// Light is scattered on the cut that the opacity settled for; rays that were content with less take part.
BeamTile::Phase BeamTile::startScatter() {
    lit_ = true;
    startCut(/*all=*/true);
    return Phase::kScatter;
}

// A new cut is integrated from the eye; rays that are settled keep theirs.
void BeamTile::startCut(bool all) {
    ++cut_number_;
    for (std::size_t p = 0; p < rays_.size(); ++p) {
        BeamRays& rays = rays_[p];
        RayPacket& packet = pixels_.packets[p];
        for (int lane = 0; lane < kLanes; ++lane) {
            if (all ? !hasLane(pixels_.lanes[p].used, lane) : hasLane(rays.settled, lane)) {
                packet.begin[lane] = kNever;
                continue;
            }
            packet.begin[lane] = rays.first[lane];
            packet.end[lane] = rays.last[lane];
            rays.depth[lane] = rays.low[lane] = rays.high[lane] = rays.variance[lane] = 0;
            rays.lit_variance[lane] = rays.weight[lane] = 0;
            rays.shadow_deviation[lane] = rays.shadow_variance[lane] = 0;
            rays.moment1[lane] = rays.moment2[lane] = 0;
            rays.front[lane] = 1;
            rays.level[lane] = 0;
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
            rays.at_least[lane] = rays.low[lane];
        }
        rays.at_least[lane] += std::max(0.0, least) * (spans.end[lane] - spans.begin[lane]);
        packet.begin[lane] = scouts && rays.at_least[lane] * scale_ < kOpaqueDepth ? spans.end[lane] : kNever;
    }
}

void BeamTile::sumNode(const Visit& met, const BrickCells& cells, const RayPacket& packet,
                       const PacketSpans& spans, double* sums) const {
    if (!met.samples) {
        for (int lane = 0; lane < kLanes; ++lane)
            if (inSpan(spans, lane)) sums[lane] += met.constant * (spans.end[lane] - spans.begin[lane]);
    } else if (met.in_kernel) {
        integrateBrick(packet, cells, spans, sums);
    } else {
        for (int lane = 0; lane < kLanes; ++lane) {
            if (!inSpan(spans, lane)) continue;
            walkCells(met.samples, channel_.shape(), met.field.key, met.field.record(), rayOf(packet, lane),
                      {spans.begin[lane], spans.end[lane]},
                      [&](const Cell& cell, const glm::dvec3& from, const glm::dvec3& to, double begin,
                          double end) { sums[lane] += meanPositive(cell, from, to) * (end - begin); });
        }
    }
}

const float* BeamTile::residentSamples(const WalkedNode& node, const RayContext& context, bool& draft) const {
    PageAddress page{channel_.index(), node.ref.block, node.ref.node, false};
    const float* samples = context.cache->find(page);
    draft = !samples;
    page.draft = true;
    return samples ? samples : context.cache->find(page);
}

// What can be drawn of a node with the pages that are there; without any, the middle of its range.
BeamTile::Visit BeamTile::visitResident(const WalkedNode& node, const RayContext& context) {
    Visit out;
    out.field = node;
    const WalkedNode* drawn = drawn_->at(node);
    if (!drawn && !node.block) {
        // Not even its range is known.
        out.errors.bound_scale = out.errors.square_scale = std::numeric_limits<float>::max();
        return out;
    }
    if (!drawn) {
        const double low = std::max(0.0, double(node.record().value_min));
        const double high = std::max(low, double(node.record().value_max));
        out.constant = 0.5 * (low + high);
        out.errors.bound_scale = 0.5 * (high - low);
        out.errors.square_scale = (high - low) * (high - low) / 12;
        return out;
    }
    out.field = *drawn;
    if (drawn->record().hasBrick()) out.samples = residentSamples(*drawn, context, out.draft);
    describeBrick(out);
    return out;
}

// Value, errors and rounding of the field that is integrated.
void BeamTile::describeBrick(Visit& out) const {
    const WalkedNode& field = out.field;
    const NodeRecord& record = field.record();
    out.errors =
        out.draft ? errorsOfDraft(record) : errorsOfNode(record, field.block->errorGrid(field.ref.node));
    out.errors.square_scale *= speckFactor(channel_, field.key);
    if (!record.hasBrick())
        out.constant =
            std::max(0.0, double(toFloat(channel_.type(), field.block->constant(field.ref.node)[0])));
    out.in_kernel = out.samples && fitsKernel(channel_, record, field.key.level, plan_);
    if (!out.in_kernel) {
        // In double only what cancels between samples of both signs counts.
        if (record.value_min < 0)
            out.rounding = kSumRounding * std::max(double(record.value_max), -double(record.value_min));
        return;
    }
    const BrickShape shape = channel_.shape();
    const double most = std::max(double(record.value_max), -double(record.value_min));
    const double steepness = double(steepnessOfPage(out.samples, shape));
    out.rounding = kPositionRounding * shape.edge_cells * steepness + kSampleRounding * most;
    out.lost = (most + steepness) * kLostLength * cellEdge(field.key.level);
}

BeamTile::Visit BeamTile::visitField(const WalkedNode& node, bool draft, PacketList list,
                                     const RayContext& context) {
    if (resident_) return visitResident(node, context);
    Visit out;
    out.field = node;
    if (node.status == WalkStatus::kMissingBlock) {
        out.missing = true;
        const WantedPage page{true, {channel_.index(), node.missing_block, 0}};
        if (context.failed->contains(page))
            failed_ = true;
        else if (!context.full())
            context.wants->add(page, std::uint32_t(channel_.blockBytes(node.missing_block)),
                               double(list.count), context.tile);
        return out;
    }
    if (node.record().hasBrick()) {
        out.draft = draft;
        // Worth: what the rays that meet it still let through.
        double worth = 0;
        for (std::uint16_t p : list)
            for (double transmittance : rays_[p].transmittance) worth += transmittance * transmittance;
        out.samples = samplesOf(node, out.draft, worth, context);
        out.missing = !out.samples;
        if (out.missing) return out;
    }
    describeBrick(out);
    return out;
}

BeamTile::Visit BeamTile::visit(const WalkedNode& node, bool draft, PacketList list,
                                const RayContext& context) {
    Visit out = visitField(node, draft, list, context);
    if (!scatters() || failed_ || !out.field.block || out.field.status != WalkStatus::kNode) return out;
    if (!out.field.record().hasBrick() && out.constant == 0) return out;
    // Asked for even where the brick is missing: all that a ray needs is wanted at once.
    out.light = light_->of(out.field, double(list.count), context);
    out.missing |= !out.light;
    return out;
}

void BeamTile::integrateNode(const WalkedNode& node, bool draft, PacketList list, const RayContext& context) {
    const Visit met = visit(node, draft, list, context);
    if (failed_) return;
    BrickCells cells;
    if (met.samples) {
        cells = cellsOf(channel_, met.field, met.samples);
        if (met.in_kernel && list.count * kLanes >= kRaysForQuads) cells.quads = t_quads.of(cells);
    }
    if (!met.missing) nodes_.push_back(met.field);
    for (std::uint16_t place : list) integratePacket(node, met, cells, place, context);
}

void BeamTile::integratePacket(const WalkedNode& node, const Visit& met, const BrickCells& cells,
                               std::uint16_t place, const RayContext& context) {
    RayPacket& packet = pixels_.packets[place];
    BeamRays& rays = rays_[place];
    const glm::dvec3 low = nodeLow(node.key, channel_.shape());
    const glm::dvec3 high = low + nodeEdge(node.key, channel_.shape());
    const glm::dvec3 field_low = nodeLow(met.field.key, channel_.shape());
    PacketSpans spans;
    clipPacket(packet, &low[0], &high[0], spans);
    const bool known = node.block && node.status == WalkStatus::kNode;
    const double value_min = known ? double(node.record().value_min) : 0.0;
    if (met.missing) return block(place, spans, value_min, context);
    if (rays.blocked) {
        // Scouts integrate nothing: what lies in front of them is not there yet.
        PacketSpans scouts = spans;
        for (int lane = 0; lane < kLanes; ++lane)
            (hasLane(rays.blocked, lane) ? spans : scouts).end[lane] = -kNever;
        block(place, scouts, value_min, context);
    }
    alignas(64) double half_width[kLanes] = {}, square[kLanes] = {};
    PacketScatter scattered;
    double* sums = scattered.depth;
    if (scatters())
        scatterNode(met, cells, packet, spans, scattered);
    else
        sumNode(met, cells, packet, spans, sums);
    if (!met.errors.exact() && !met.errors.uniform)
        integrateGrid(packet, &field_low[0], nodeEdge(met.field.key, channel_.shape()), spans,
                      met.errors.bound, met.errors.square, half_width, square);

    Mark& mark = marks_.emplace_back();
    mark.node = std::uint32_t(nodes_.size() - 1);
    mark.previous = rays.last_mark;
    mark.cut = cut_number_;
    rays.last_mark = std::int32_t(marks_.size() - 1);
    const double cell = cellEdge(met.field.key.level);
    const bool waits = resident_ && !met.errors.exact();
    // Floats that stand for errors were summed in float: a hair more makes up for it.
    constexpr double kErrorSlack = 1 + 1e-5;
    for (int lane = 0; lane < kLanes; ++lane) {
        mark.end[lane] = -kNever;
        if (!inSpan(spans, lane)) continue;
        const double length = spans.end[lane] - spans.begin[lane];
        const double sum = sums[lane], unit = pixels_.lanes[place].unit[lane];
        double variance = 0;
        double wide = sum * kSumRounding + met.rounding * length + met.lost * unit;
        if (!met.errors.exact()) {
            wide += (met.errors.uniform ? length : half_width[lane]) * met.errors.bound_scale * kErrorSlack;
            variance = (met.errors.uniform ? length : square[lane]) * met.errors.square_scale * unit * cell;
            rays.variance[lane] += variance;
        }
        double least = std::max(0.0, sum - wide), most = sum + wide;
        if (known) {
            // The range of the node's values bounds the integral too; outside its samples lies the
            // background.
            const NodeRecord& record = node.record();
            least =
                std::max(least, std::min(double(record.value_min), double(channel_.background())) * length);
            most = std::min(most, std::max(double(record.value_max), 0.0) * length * (1 + kSumRounding));
        }
        if (light_) {
            const double front = rays.front[lane];
            const double passed = scatters() ? scattered.passed[lane] : std::exp(-sum * scale_);
            rays.lit_variance[lane] += front * front * variance;
            rays.front[lane] = front * passed;
            if (scatters()) {
                rays.weight[lane] += front * scattered.weight[lane];
                if (met.light) {
                    const double reached = front * (1 - passed);
                    rays.shadow_deviation[lane] += reached * double(met.light->deviation);
                    rays.shadow_variance[lane] += std::pow(reached * double(met.light->spacing_deviation), 2);
                }
                const double moment = rays.front[lane] * scattered.last[lane] + rays.weight[lane];
                rays.moment1[lane] += moment * variance;
                rays.moment2[lane] += moment * moment * variance;
            }
        }
        rays.level[lane] += sum * met.field.key.level;
        rays.waiting[lane] = std::uint16_t(rays.waiting[lane] + waits);
        rays.depth[lane] += sum;
        rays.low[lane] += std::min(least, sum);
        rays.high[lane] += std::max(most, sum);
        // Only what is certain hides what is behind: a coarse node may lose depth when it is refined.
        packet.begin[lane] = rays.low[lane] * scale_ > kOpaqueDepth ? kNever : spans.end[lane];
        mark.end[lane] = spans.end[lane];
        mark.depth[lane] = rays.depth[lane];
    }
}

bool BeamTile::integrate(const RayContext& context) {
    release();
    walkPackets(
        channel_, pixels_.packets, order_,
        [&](const WalkedNode& node) { return failed_ ? 0 : descends(node); },
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
    if (light_) lightPixel(place, lane, pixel);
    return pixel;
}

BeamTile::Why BeamTile::whyOf(std::size_t place, int lane, const Pixel& pixel) const {
    const BeamRays& rays = rays_[place];
    // Shadows are as fine as their lattices go, which the cut knows nothing of.
    const bool dim = !resident_ && !plan_.quality.reference && !plan_.quality.strict &&
                     double(pixel.estimate_radiance) > plan_.quality.max_error / 3;
    return {rays.depth[lane] > 0 ? float(rays.level[lane] / rays.depth[lane]) : 0, float(rays.waiting[lane]),
            hasLane(rays.stuck, lane) || dim};
}

bool BeamTile::settle() {
    const QualitySettings& quality = plan_.quality;
    const double most_scattered = light_ ? mostScattered() : 0;
    bool all = true;
    for (std::size_t p = 0; p < rays_.size(); ++p) {
        BeamRays& rays = rays_[p];
        for (int lane = 0; lane < kLanes; ++lane) {
            if (hasLane(rays.settled, lane)) continue;
            const AlphaComposite now = alphaOf(p, lane);
            rays.transmittance[lane] = now.transmittance;
            const double target = quality.max_error / 3;
            const bool content =
                quality.strict ? now.bound <= quality.max_error
                               : now.estimate <= target &&
                                     most_scattered * std::sqrt(rays.lit_variance[lane]) * scale_ <= target;
            if (content)
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
    LitEffect lit_effect;
    if (light_ && !plan_.quality.strict)
        lit_effect = [this, most = mostScattered() * scale_](std::size_t place, int lane, double distance) {
            return most * transmittanceBefore(place, lane, distance);
        };
    if (cut_number_ < kMostCuts && !refineCut(plan_, order_, rays, lit_effect, context, cut_)) return false;
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

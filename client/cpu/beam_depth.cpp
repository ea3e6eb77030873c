// Where the rays of a tile reach half their opacity: the marks tell between which two nodes' ends, and only
// that stretch is walked again.

#include <algorithm>
#include <cmath>

#include "client/cpu/beam_tile.h"
#include "client/cpu/cell_walk.h"
#include "client/cpu/node_cells.h"

namespace brickyard {

namespace {

constexpr int kLanes = RayPacket::kRays;
constexpr double kNever = std::numeric_limits<double>::infinity();

}  // namespace

bool BeamTile::findInMark(std::size_t place, const Mark& mark, const PacketSpans& spans,
                          const double* targets, double* before, const RayContext& context) {
    const WalkedNode& node = nodes_[mark.node];
    RayPacket packet = pixels_.packets[place];
    double* found = rays_[place].distance;
    const float* samples = nullptr;
    if (node.status == WalkStatus::kNode && node.record().hasBrick()) {
        if (resident_) {
            bool draft = false;
            samples = residentSamples(node, context, draft);
        } else {
            samples = samplesOf(node, cut_.usesDraft(node) & maskOf(std::uint16_t(place)), 1, context);
            if (!samples) return false;
        }
    }
    if (samples && fitsKernel(channel_, node.record(), node.key.level, plan_)) {
        findInBrick(packet, cellsOf(channel_, node, samples), spans, targets, before, found);
        return true;
    }
    for (int lane = 0; lane < kLanes; ++lane) {
        if (!(spans.begin[lane] < spans.end[lane])) continue;
        if (!samples) {
            // One value: linear.
            const double amount = mark.depth[lane] - before[lane];
            const double part =
                amount > 0 ? std::clamp((targets[lane] - before[lane]) / amount, 0.0, 1.0) : 1;
            found[lane] = spans.begin[lane] + part * (spans.end[lane] - spans.begin[lane]);
            continue;
        }
        const IndexRay ray = rayOf(packet, lane);
        double sum = before[lane];
        walkCells(
            samples, channel_.shape(), node.key, node.record(), ray, {spans.begin[lane], spans.end[lane]},
            [&](const Cell& cell, const glm::dvec3& from, const glm::dvec3& to, double begin, double end) {
                const double amount = meanPositive(cell, from, to) * (end - begin);
                if (sum < targets[lane] && amount > 0 && sum + amount >= targets[lane])
                    found[lane] =
                        begin + (end - begin) * std::clamp((targets[lane] - sum) / amount, 0.0, 1.0);
                sum += amount;
            });
    }
    return true;
}

// False while a page is missing.
bool BeamTile::locateIn(std::size_t place, const RayContext& context) {
    BeamRays& rays = rays_[place];
    alignas(64) double targets[kLanes], before[kLanes];
    PacketSpans spans;
    std::int32_t in_mark[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) {
        in_mark[lane] = -1;
        targets[lane] = before[lane] = 0;
        spans.begin[lane] = rays.first[lane];
        spans.end[lane] = -kNever;
        if (hasLane(rays.located, lane) || !(rays.depth[lane] * scale_ > 0)) continue;
        const double alpha = -std::expm1(-rays.depth[lane] * scale_);
        targets[lane] = std::min(-std::log1p(-0.5 * alpha) / scale_, rays.depth[lane]);
        for (std::int32_t m = rays.last_mark; m >= 0; m = marks_[std::size_t(m)].previous) {
            const Mark& mark = marks_[std::size_t(m)];
            if (mark.cut != rays.cut[lane] || !(mark.end[lane] > -kNever)) continue;
            if (mark.depth[lane] < targets[lane]) {
                spans.begin[lane] = mark.end[lane];
                before[lane] = mark.depth[lane];
                break;
            }
            in_mark[lane] = m;
        }
        if (in_mark[lane] < 0) continue;
        spans.end[lane] = rays.distance[lane] = marks_[std::size_t(in_mark[lane])].end[lane];
    }
    for (int lane = 0; lane < kLanes; ++lane) {
        if (in_mark[lane] < 0) continue;
        const Mark& mark = marks_[std::size_t(in_mark[lane])];
        PacketSpans here = spans;
        const std::int32_t current = in_mark[lane];
        std::uint16_t found = 0;
        for (int other = 0; other < kLanes; ++other) {
            if (in_mark[other] != current) {
                here.end[other] = -kNever;
                continue;
            }
            in_mark[other] = -1;
            addLane(found, other);
        }
        // What is found is kept: in a small cache two bricks of a packet may never be there at once.
        if (!findInMark(place, mark, here, targets, before, context)) return false;
        rays.located = std::uint16_t(rays.located | found);
    }
    rays.located = 0xffff;
    return true;
}

bool BeamTile::locate(const RayContext& context) {
    bool complete = true;
    for (std::size_t p = 0; p < rays_.size(); ++p) {
        if (rays_[p].located == 0xffff || locateIn(p, context)) continue;
        complete = false;
        if (failed_ || context.full()) return false;
    }
    return complete;
}

}  // namespace brickyard

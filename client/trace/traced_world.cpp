#include "client/trace/traced_world.h"

#include <algorithm>
#include <cmath>

#include "client/trace/filter_weights.h"
#include "client/trace/value_range.h"

namespace brickyard {

namespace {

struct Box {
    glm::dvec3 low, high;
};

Box grown(const Box& box, const glm::dvec3& by) { return {box.low - by, box.high + by}; }

// A box of one index space as one of another that holds it.
Box mapped(const Box& box, const Affine& from, const Affine& to) {
    if (from == to) return box;
    Box out{glm::dvec3(std::numeric_limits<double>::infinity()),
            glm::dvec3(-std::numeric_limits<double>::infinity())};
    for (int corner = 0; corner < 8; ++corner) {
        const glm::dvec3 at(corner & 1 ? box.high.x : box.low.x, corner & 2 ? box.high.y : box.low.y,
                            corner & 4 ? box.high.z : box.low.z);
        const glm::dvec3 there = to.inversePoint(from.point(at));
        out.low = glm::min(out.low, there);
        out.high = glm::max(out.high, there);
    }
    return out;
}

// World units a frame that anything moves at most. `complete` becomes false where blocks are missing.
double fastest(const MediumChannels& channels, const TracedMedium& medium,
               std::span<const RayContext> contexts, bool& complete) {
    if (!channels.velocity) return 0;
    const PagedChannel& velocity = *channels.velocity.channel;
    constexpr double kEverywhere = std::numeric_limits<double>::infinity();
    // As stored: rounding may have gone beyond the range of the source.
    ValueRange component;
    if (!rangeOver(velocity, glm::dvec3(-kEverywhere), glm::dvec3(kEverywhere), kMaxLevel, 0,
                   contexts[channels.velocity.frame], component))
        complete = false;
    for (const ValueBits bits : velocity.backgroundBits()) component.add(toFloat(velocity.type(), bits));
    const double most = std::max(std::abs(component.low), std::abs(component.high));
    return std::sqrt(3.0) * most * std::abs(medium.settings->velocity_scale);
}

// Index units on each axis that a world distance may be.
glm::dvec3 indexReach(const Affine& transform, double distance) {
    glm::dvec3 rows(0);
    for (int axis = 0; axis < 3; ++axis) {
        glm::dvec3 unit(0);
        unit[axis] = 1;
        const glm::dvec3 column = transform.inverseVector(unit);
        rows += column * column;
    }
    return glm::sqrt(rows) * distance;
}

// World units that what a frame holds may have been displaced, at any moment of the shutter.
double displacement(const TracedMedium& medium, bool next, double speed) {
    if (medium.next.density && !medium.advects) return 0;
    const double base = next ? medium.between - 1 : medium.between;
    return speed * std::max(std::abs(base + medium.time_open), std::abs(base + medium.time_close));
}

class CellBounds {
public:
    // `moved`: as displacement(), of either frame.
    CellBounds(const TracedMedium& medium, int level, double moved_now, double moved_next,
               std::span<const RayContext> contexts)
        : medium_(medium),
          level_(level),
          reach_now_(indexReach(medium.transform(), moved_now)),
          reach_next_(indexReach(medium.transform(), moved_next)),
          contexts_(contexts) {}

    // `box`: in the index space of the medium. False where blocks are missing.
    bool of(const Box& box, MajorantCell& out) const {
        bool complete = add(medium_.now, grown(box, reach_now_), out);
        if (medium_.next.density) complete = add(medium_.next, grown(box, reach_next_), out) && complete;
        return complete;
    }

private:
    bool range(const TracedChannel& channel, const Box& box, double square_budget, ValueRange& out) const {
        const FieldFilter filter = medium_.settings->filter;
        // A kernel reaches a sample of the level beyond the cell, and central differences one more.
        const double samples =
            std::max(filterReach(filter) * 2 * cellEdgeOf(level_), medium_.shadow_spread) + 1e-6;
        const Box there = mapped(box, medium_.transform(), channel.channel->transform());
        const Box asked = grown(there, glm::dvec3(samples));
        const bool complete = rangeOver(*channel.channel, asked.low, asked.high, level_, square_budget,
                                        contexts_[channel.frame], out);
        const double more = filterOvershoot(filter) * (out.high - out.low);
        out.low -= more;
        out.high += more;
        return complete;
    }
    static double cellEdgeOf(int level) { return double(std::uint64_t(1) << level); }

    bool add(const MediumChannels& channels, const Box& box, MajorantCell& out) const {
        const MediumSettings& settings = *medium_.settings;
        ValueRange density;
        bool complete = range(channels.density, box, medium_.density_accuracy.square_budget, density);
        if (medium_.next.density) density.add(0);  // a share of it
        const double most = settings.transfer
                                ? settings.density_scale * settings.transfer->most(density.low, density.high)
                                : extinctionOf(settings, density.high);
        // Between two frames what is drawn is a mean of both: the greater one bounds it, but for a transfer
        // function, whose opacity between the two values may be anything in between.
        out.extinction = std::max(out.extinction, float(most) * 1.000001f);
        if (settings.transfer && medium_.next.density) {
            ValueRange all = density;
            all.add(medium_.now.density.channel->valueMin());
            all.add(medium_.now.density.channel->valueMax());
            out.extinction = std::max(
                out.extinction, float(settings.density_scale * settings.transfer->most(all.low, all.high)));
        }
        if (!settings.emission || channels.emission.channel->empty()) return complete;
        ValueRange glow;
        complete = range(channels.emission, box, 0, glow) && complete;
        double emission = 0;
        if (settings.emission->black_body)
            emission = 1;
        else if (settings.emission->ramp)
            emission = settings.emission->ramp->most(glow.low, glow.high);
        else
            emission = std::max(0.0, glow.high);
        if (channels.weight && emission > 0) {
            if (channels.weight.channel->empty()) return complete;
            ValueRange weight;
            complete = range(channels.weight, box, 0, weight) && complete;
            emission *= std::max(0.0, weight.high);
        }
        out.emission = std::max(out.emission, float(emission));
        return complete;
    }

    const TracedMedium& medium_;
    int level_;
    glm::dvec3 reach_now_, reach_next_;  // index units of the medium
    std::span<const RayContext> contexts_;
};

}  // namespace

double TracedWorld::lodAt(const TracedMedium& medium, const glm::dvec3& point) const {
    if (!(medium.pixels_per_voxel > 0)) return 0;
    const double distance = glm::length(point - camera->eye());
    const double voxel = distance * camera->pixelEdge() * medium.pixels_per_voxel;
    // The coarser of the two levels that are blended is the one whose voxels are no larger.
    return std::clamp(std::log2(voxel / medium.transform().voxelSize()) - 1, 0.0, double(kMaxLevel));
}

RaySpan TracedWorld::clipped(const WorldRay& ray, RaySpan span) const {
    const IndexRay world(ray, Affine());
    if (settings.clip.box) span = world.clip((*settings.clip.box)[0], (*settings.clip.box)[1], span);
    for (const WorldClip::Plane& plane : settings.clip.planes) {
        const double height = glm::dot(plane.normal, ray.origin - plane.point),
                     rate = glm::dot(plane.normal, ray.direction);
        if (rate == 0) {
            if (height < 0) return {0, 0};
        } else if (rate > 0) {
            span.begin = std::max(span.begin, -height / rate);
        } else {
            span.end = std::min(span.end, -height / rate);
        }
    }
    return span;
}

bool makeMajorants(TracedMedium& medium, int coarsest, std::span<const RayContext> contexts) {
    const PagedChannel& density = *medium.now.density.channel;
    Box box{density.clipLow(), density.clipHigh()};
    bool complete = true;
    const double moved_now = displacement(medium, false, fastest(medium.now, medium, contexts, complete));
    const double moved_next = displacement(medium, true, fastest(medium.next, medium, contexts, complete));
    // How far the medium reaches is not known yet.
    if (!complete) return false;
    box = grown(box, indexReach(density.transform(), moved_now));
    if (medium.next.density && !medium.next.density.channel->empty()) {
        const PagedChannel& next = *medium.next.density.channel;
        Box other = grown({next.clipLow(), next.clipHigh()}, indexReach(next.transform(), moved_next));
        other = mapped(other, next.transform(), density.transform());
        box = {glm::min(box.low, other.low), glm::max(box.high, other.high)};
    }
    medium.box_low = box.low;
    medium.box_high = box.high;
    const glm::dvec3 size = box.high - box.low;
    // A cell is a node of the finest level of which there are not too many.
    int level = std::max(0, coarsest);
    const double brick = double(density.shape().edge_cells);
    const double longest = std::max({size.x, size.y, size.z});
    while (level < kMaxLevel && brick * std::exp2(level) * MajorantGrid::kMostCells < longest) ++level;
    medium.majorants = MajorantGrid(box.low, box.high, brick * std::exp2(level));
    const CellBounds bounds(medium, level, moved_now, moved_next, contexts);
    for (std::size_t i = 0; i < medium.majorants.cellCount(); ++i) {
        const glm::dvec3 low = medium.majorants.cellLow(i);
        complete = bounds.of({low, low + medium.majorants.cellEdge()}, medium.majorants.cell(i)) && complete;
    }
    return complete;
}

}  // namespace brickyard

#include "client/trace/surface_tracer.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "client/cpu/cell_walk.h"
#include "client/trace/cubic_roots.h"

namespace brickyard {

namespace {

// What waits behind a missing page is worth half of what is in front of it: the ray may end there.
constexpr double kWorthBehind = 0.5;

// Control points of the field less `iso` from `from` to `to`: its blossom, the mean over the ways to take
// some coordinates from the end and the others from the begin. `sign` turns it over.
Cubic alongCell(const Cell& cell, double iso, double sign, const glm::dvec3& from, const glm::dvec3& to) {
    const double x[2] = {from.x, to.x}, y[2] = {from.y, to.y}, z[2] = {from.z, to.z};
    auto mix = [](double a, double b, double s) { return a + (b - a) * s; };
    double corner[8];
    for (int i = 0; i < 8; ++i) corner[i] = sign * (cell.corner[i] - iso);
    // By axes: [which end in x] x [y, z corners], then [ends in x, y] x [z corners].
    double along_x[2][4], along_y[2][2][2];
    for (int i = 0; i < 2; ++i)
        for (int c = 0; c < 4; ++c) along_x[i][c] = mix(corner[2 * c], corner[2 * c + 1], x[i]);
    for (int i = 0; i < 2; ++i)
        for (int j = 0; j < 2; ++j)
            for (int c = 0; c < 2; ++c)
                along_y[i][j][c] = mix(along_x[i][2 * c], along_x[i][2 * c + 1], y[j]);
    auto at = [&](int i, int j, int k) { return mix(along_y[i][j][0], along_y[i][j][1], z[k]); };
    return {{at(0, 0, 0), (at(1, 0, 0) + at(0, 1, 0) + at(0, 0, 1)) / 3,
             (at(1, 1, 0) + at(1, 0, 1) + at(0, 1, 1)) / 3, at(1, 1, 1)}};
}

}  // namespace

// One ray under way: the side it is on, and what it has crossed.
class SurfaceTracer::Trace {
public:
    using NodeField = NodeFields::NodeField;
    using State = NodeFields::State;

    Trace(const SurfaceTracer& tracer, const IndexRay& ray, const RayContext& context, double worth,
          MissingPages missing, std::size_t most, std::vector<SurfaceHit>& hits)
        : tracer_(tracer),
          channel_(tracer.channel_),
          ray_(ray),
          context_(context),
          worth_(worth),
          fields_(channel_, context, worth, missing),
          stands_in_(missing == MissingPages::kStandIn),
          most_(most),
          hits_(hits),
          background_inside_(tracer.isInside(double(channel_.background()))) {}

    void beginOn(bool inside) { inside_ = inside; }
    bool failed() const { return failed_; }

    Found run(RaySpan span) {
        if (span.empty()) return Found::kNothing;
        if (channel_.empty()) {
            stretch(span.begin, background_inside_, nullptr);
            return found();
        }
        // Averages of a coarse level reach a voxel of it further than the medium.
        const glm::dvec3 margin(tracer_.level_ > 0 ? cellEdge(tracer_.level_) : 0.0);
        const RaySpan medium = ray_.clip(channel_.clipLow() - margin, channel_.clipHigh() + margin, span);
        if (medium.empty()) {
            stretch(span.begin, background_inside_, nullptr);
            return found();
        }
        if (medium.begin > span.begin) stretch(span.begin, background_inside_, nullptr);
        if (!done())
            walkOctree(
                channel_, ray_, medium, [&](const WalkedNode& node) { return descend(node); },
                [&](const WalkedNode& node) {
                    visit(node);
                    return !done();
                });
        if (!done() && medium.end < span.end) stretch(medium.end, background_inside_, nullptr);
        return found();
    }

private:
    bool done() const { return certain_ >= most_ || (missing_ && context_.full()); }
    Found found() const {
        if (missing_) return Found::kMissing;
        return hits_.empty() ? Found::kNothing : Found::kHit;
    }

    // All of the node and of what is below it is on one side.
    std::optional<bool> sideOf(const PlacedNode& node) const {
        const NodeRecord& record = node.record();
        double low = double(record.value_min), high = double(record.value_max);
        // What is not stored, and what is outside the tight box, is background.
        const bool leaf = node.block->isLeaf(node.ref.node);
        bool whole = leaf || node.block->validMask(node.ref.node) == 0xff;
        if (record.hasBrick())
            for (std::size_t a = 0; a < 3; ++a)
                whole = whole && record.box_begin[a] == 0 && record.box_end[a] == channel_.shape().edge_cells;
        if (!whole) {
            low = std::min(low, double(channel_.background()));
            high = std::max(high, double(channel_.background()));
        }
        const bool inside = tracer_.isInside(low);
        if (inside == tracer_.isInside(high)) return inside;
        return std::nullopt;
    }

    bool descend(const WalkedNode& node) const {
        const PlacedNode placed{node.ref, node.key, node.block};
        return node.key.level > tracer_.level_ && !sideOf(placed) && !fields_.childrenBarred(placed);
    }

    void visit(const WalkedNode& node) {
        if (node.status == WalkStatus::kBackground)
            return stretch(node.span.begin, background_inside_, nullptr);
        if (node.status == WalkStatus::kMissingBlock) {
            // Children of a block that cannot be had are not asked for, so this is the roots' own.
            const WantedPage page{true, {channel_.index(), node.missing_block, 0}};
            if (context_.failed->contains(page) || stands_in_) return unknown();
            fields_.wantBlock(node.missing_block);
            return gap();
        }
        const PlacedNode placed{node.ref, node.key, node.block};
        if (const auto side = sideOf(placed)) return stretch(node.span.begin, *side, nullptr);
        if (node.key.level > tracer_.level_ && canDescend(node)) failed_ = true;
        const NodeField field = fields_.read(placed);
        failed_ = failed_ || field.failed;
        switch (field.state) {
            case State::kMissing: return gap();
            case State::kUnknown: return unknown();
            case State::kValue: return stretch(node.span.begin, tracer_.isInside(field.value), nullptr);
            case State::kBrick: return cells(field, node.span);
        }
    }

    void cells(const NodeField& field, RaySpan span) {
        const PlacedNode& node = field.node;
        const double edge = cellEdge(node.key.level);
        const glm::dvec3 low = nodeLow(node.key, channel_.shape());
        const double sign = tracer_.inside_below_ ? -1 : 1;
        double t = span.begin;
        walkCells(
            field.samples, channel_.shape(), node.key, node.record(), ray_, span,
            [&](const Cell& cell, const glm::dvec3& from, const glm::dvec3& to, double begin, double end) {
                if (done()) return;
                // Outside the node's tight box lies background.
                if (begin > t) stretch(t, background_inside_, &node);
                t = end;
                const auto [least, most] =
                    std::minmax_element(std::begin(cell.corner), std::end(cell.corner));
                const bool inside = tracer_.isInside(*least);
                if (inside == tracer_.isInside(*most)) return stretch(begin, inside, &node);
                const Cubic cubic = alongCell(cell, tracer_.iso_, sign, from, to);
                stretch(begin, cubic.control[0] > 0, &node);
                const CubicRoots changes = signChanges(cubic);
                if (changes.count == 0) return;
                // The cell's place: the middle of the way through it is not at its border.
                const double middle_t = 0.5 * (begin + end);
                glm::ivec3 corner;
                for (int a = 0; a < 3; ++a)
                    corner[a] =
                        int(std::lround((ray_.origin[a] - low[a] + middle_t * ray_.direction[a]) / edge -
                                        0.5 * (from[a] + to[a])));
                for (int i = 0; i < changes.count && !done(); ++i) {
                    const double s = changes.at[std::size_t(i)];
                    SurfaceHit hit;
                    hit.t = std::clamp(begin + s * (end - begin), begin, end);
                    hit.inside = glm::clamp(from + s * (to - from), 0.0, 1.0);
                    hit.cell = glm::clamp(corner, 0, channel_.shape().edge_cells - 1);
                    hit.index = low + edge * (glm::dvec3(hit.cell) + hit.inside);
                    setNode(node, hit);
                    cross(hit);
                }
            });
        if (!done() && t < span.end) stretch(t, background_inside_, &node);
        last_node_ = node;
    }

    // From `t` on the ray is on this side; the stretch before ended there. A change of side between them is a
    // crossing, of the border. `node`: whose brick begins here; nullptr: none does.
    void stretch(double t, bool inside, const PlacedNode* node) {
        if (waits_) {
            waits_ = false;
            // Whatever comes will show a crossing in the gap.
            if (inside_ && *inside_ != inside) ++certain_;
        } else if (inside_ && *inside_ != inside) {
            SurfaceHit hit;
            hit.t = t;
            hit.index = ray_.origin + t * ray_.direction;
            // In the brick that begins, or in the one that ended.
            if (!node && last_node_.block) node = &last_node_;
            if (node) placeIn(*node, hit);
            cross(hit);
        }
        inside_ = inside;
        if (!node) last_node_.block = nullptr;
    }

    void placeIn(const PlacedNode& node, SurfaceHit& hit) const {
        const glm::dvec3 position =
            (hit.index - nodeLow(node.key, channel_.shape())) / cellEdge(node.key.level);
        for (int a = 0; a < 3; ++a) {
            hit.cell[a] =
                int(std::clamp(std::floor(position[a]), 0.0, double(channel_.shape().edge_cells - 1)));
            hit.inside[a] = std::clamp(position[a] - hit.cell[a], 0.0, 1.0);
        }
        setNode(node, hit);
    }
    void setNode(const PlacedNode& node, SurfaceHit& hit) const {
        hit.has_node = true;
        hit.node = node.ref;
        hit.key = node.key;
    }
    void cross(SurfaceHit& hit) {
        inside_ = !inside_.value_or(false);
        ++certain_;
        if (missing_) return;  // not one of the first, perhaps
        hit.entering = *inside_;
        hit.failed = failed_;
        hits_.push_back(hit);
    }
    void gap() {
        missing_ = waits_ = true;
        last_node_.block = nullptr;
        worth_ *= kWorthBehind;
        fields_.setWorth(worth_);
    }
    void unknown() {
        failed_ = true;
        last_node_.block = nullptr;
    }

    const SurfaceTracer& tracer_;
    const PagedChannel& channel_;
    const IndexRay& ray_;
    const RayContext& context_;
    double worth_;
    NodeFields fields_;
    bool stands_in_;
    std::size_t most_;
    std::vector<SurfaceHit>& hits_;
    bool background_inside_;

    std::optional<bool> inside_;  // unknown until the first stretch
    bool missing_ = false;        // a page in front is missing
    bool waits_ = false;          // the stretch before is the missing one
    bool failed_ = false;
    std::size_t certain_ = 0;  // crossings that there are, whatever the missing pages hold
    PlacedNode last_node_;     // whose brick ended where the next stretch begins; or block == nullptr
};

SurfaceTracer::SurfaceTracer(const PagedChannel& channel, double iso, bool inside_below, int level)
    : channel_(channel), iso_(iso), inside_below_(inside_below), level_(level) {}

SurfaceTracer::Found SurfaceTracer::first(const IndexRay& ray, RaySpan span, const RayContext& context,
                                          SurfaceHit& hit, double worth) const {
    thread_local std::vector<SurfaceHit> hits;
    hits.clear();
    Trace trace(*this, ray, context, worth, MissingPages::kWant, 1, hits);
    const Found found = trace.run(span);
    hit = hits.empty() ? SurfaceHit() : hits[0];
    hit.failed = trace.failed();
    return found;
}

SurfaceTracer::Found SurfaceTracer::crossings(const IndexRay& ray, RaySpan span, const RayContext& context,
                                              std::size_t most, std::vector<SurfaceHit>& hits, double worth,
                                              bool* failed) const {
    hits.clear();
    Trace trace(*this, ray, context, worth, MissingPages::kWant, most, hits);
    const Found found = trace.run(span);
    if (failed && trace.failed()) *failed = true;
    return found;
}

SurfaceTracer::Found SurfaceTracer::firstResident(const IndexRay& ray, RaySpan span,
                                                  const RayContext& context, SurfaceHit& hit) const {
    thread_local std::vector<SurfaceHit> hits;
    hits.clear();
    Trace trace(*this, ray, context, 0, MissingPages::kStandIn, 1, hits);
    const Found found = trace.run(span);
    hit = hits.empty() ? SurfaceHit() : hits[0];
    hit.failed = trace.failed();
    return found;
}

SurfaceTracer::Found SurfaceTracer::occluded(const IndexRay& ray, RaySpan span, const RayContext& context,
                                             double worth, bool* failed) const {
    return occludedOn(/*inside=*/false, ray, span, context, worth, failed);
}

SurfaceTracer::Found SurfaceTracer::occludedOn(bool inside, const IndexRay& ray, RaySpan span,
                                               const RayContext& context, double worth, bool* failed) const {
    thread_local std::vector<SurfaceHit> hits;
    hits.clear();
    Trace trace(*this, ray, context, worth, MissingPages::kWant, 1, hits);
    trace.beginOn(inside);
    const Found found = trace.run(span);
    if (failed && trace.failed()) *failed = true;
    return found;
}

SurfaceTracer::Found SurfaceTracer::occludedFrom(const SurfaceHit& hit, const glm::dvec3& direction,
                                                 double reach, const RayContext& context, double worth,
                                                 bool* failed) const {
    const IndexRay ray = rayFrom(hit, direction);
    return occludedOn(/*inside=*/!hit.entering, ray, {hair(ray), reach}, context, worth, failed);
}

IndexRay SurfaceTracer::rayFrom(const SurfaceHit& hit, const glm::dvec3& direction) const {
    IndexRay ray;
    ray.origin = hit.index;
    ray.direction = channel_.transform().inverseVector(direction);
    // As IndexRay's own constructor.
    const double longest =
        std::max({std::abs(ray.direction.x), std::abs(ray.direction.y), std::abs(ray.direction.z)});
    for (int a = 0; a < 3; ++a) {
        ray.parallel[a] = !(std::abs(ray.direction[a]) > longest * 1e-280);
        ray.inverse[a] = ray.parallel[a] ? 0 : 1 / ray.direction[a];
    }
    return ray;
}

}  // namespace brickyard

// One channel along one ray: a cut through the octree as a list of segments, and what is known of each.
//
// A ray is refined in rounds: every segment of the cut is integrated, then the rounds' owner splits the
// segments whose error matters. Each decision depends on stored data alone, never on what happened to be in
// the cache, so a finished ray is the same, bit for bit, however its pages came. What was integrated is kept:
// a page is needed once. docs/design.md, section "A ray". Not thread-safe: one thread works on a ray.
#pragma once

#include <cstdint>
#include <unordered_set>
#include <vector>

#include "client/cpu/octree_walk.h"
#include "client/cpu/want_list.h"
#include "client/page_cache.h"
#include "client/paged_channel.h"

namespace brickyard {

// A stretch of a segment, one cell or less: where it ends and what was integrated from the segment's begin to
// there.
struct CellStep {
    double end = 0;  // world distance
    double integral = 0;
    float shadow = -1;    // transmittance to the light; below 0 until ShadowTracer has filled it in
    float shadow_sd = 0;  // its standard deviation
};

enum class SegmentState : std::uint8_t {
    kWaiting,  // its brick has not been integrated
    kBlocked,  // a tree block must come before it can even be told what to integrate
    kDone,
};

struct RaySegment {
    RaySpan span;
    WalkedNode node;  // status kBackground for a stretch without a node
    SegmentState state = SegmentState::kWaiting;
    bool draft = false;   // from the draft of the node's brick; its split is the whole brick
    bool failed = false;  // its page cannot be had; drawn from above, and the picture is not final
    // All of the integral of max(0, value) * scale over the span:
    double integral = 0;
    double low = 0, high = 0;  // the true one lies within, always
    // Known from topology alone, before the segment is integrated:
    double half_width = 0;  // the integral of any part of the span is off by no more than this
    double variance = 0;    // of its expected error
    // Set by whoever refines the ray:
    double effect = 0;  // d(pixel) / d(integral); children take it over
    double worth = 1;   // expected picture error that its page removes
    std::vector<CellStep> cells;
    // A shadow ray under way: of which step, and how far it has got.
    std::uint32_t shadow_step = 0;
    double shadow_t = 0, shadow_depth = 0, shadow_variance = 0;
};

// What both channels of a ray share.
struct RayContext {
    const PageCache* cache = nullptr;
    // Pages and blocks that cannot be had.
    const std::unordered_set<WantedPage, WantedPageHash>* failed = nullptr;
    WantList* wants = nullptr;
    std::uint32_t tile = 0;
    // Pages that the cache could take in after this pass. A ray that is blocked once this many are wanted
    // stops looking for more: in a small cache the first rays are to be finished, not all of them begun.
    std::size_t room = SIZE_MAX;
    bool full() const { return wants->size() >= room; }
};

class ChannelRay {
public:
    ChannelRay() = default;
    // `scale` multiplies the field: extinction per world unit, or radiance.
    ChannelRay(const PagedChannel& channel, const WorldRay& ray, double scale, bool keep_cells);

    // The first cut: the roots, or the finest nodes. Nothing where the ray misses the medium.
    void begin(bool finest);
    std::vector<RaySegment>& segments() { return segments_; }
    const std::vector<RaySegment>& segments() const { return segments_; }
    const IndexRay& ray() const { return ray_; }
    const PagedChannel& channel() const { return *channel_; }
    double scale() const { return scale_; }

    // Integrates what has arrived; wants the rest. Front to back; stops behind `opaque_depth` (in units of
    // the integral), where everything behind is dropped. True when nothing waits.
    bool integrate(const RayContext& context, double opaque_depth);

    // Whether a finer node could take the segment's place.
    bool canSplit(const RaySegment& segment) const {
        return !segment.failed && segment.node.status == WalkStatus::kNode &&
               (segment.draft || canDescend(segment.node));
    }
    // World edge of a voxel of the segment's level, along the ray.
    double voxelLength(const RaySegment& segment) const {
        return unit_length_ * cellEdge(segment.node.key.level);
    }
    // What splitting a segment would put in its place, with the errors that topology tells, and the bytes of
    // their bricks.
    struct Split {
        std::vector<RaySegment> children;
        double variance = 0;
        double half_width = 0;
        std::uint32_t bytes = 0;
        bool failed = false;  // their block cannot be had: the segment stays as it is
    };
    // False where the children's block has not arrived: it is wanted. REQUIRES: canSplit.
    bool planSplit(const RaySegment& segment, const RayContext& context, Split& out) const;
    // Carries out the plan of segment `at`; its children share `worth`.
    void split(std::size_t at, Split plan, double worth);

    // For a picture that must be shown now: segments that wait are integrated from the nearest resident brick
    // above, with the errors that has. Leaves the ray itself as it is.
    std::vector<RaySegment> provisional(const RayContext& context) const;

private:
    void append(const WalkedNode& node, double worth, std::vector<RaySegment>& out) const;
    void want(const WantedPage& page, std::uint32_t bytes, double worth, const RayContext& context) const;
    void standIn(const RaySegment& segment, const RayContext& context, std::vector<RaySegment>& out) const;
    bool resolveBlocked(std::size_t at, const RayContext& context);
    void replace(std::size_t at, std::vector<RaySegment> with);
    void errorsOf(const NodeRecord& record, const ErrorGrid* grid, const NodeKey& key, RaySpan span,
                  double& half_width, double& variance) const;
    void integrateBrick(const float* samples, const WalkedNode& node, RaySegment& segment) const;
    void integrateConstant(double value, RaySegment& segment) const;
    PageAddress pageOf(const NodeRef& ref, bool draft) const {
        return {channel_->index(), ref.block, ref.node, draft};
    }
    void describeErrors(RaySegment& segment) const;

    const PagedChannel* channel_ = nullptr;
    IndexRay ray_;
    double scale_ = 1;
    double unit_length_ = 1;  // world length of an index unit along the ray
    bool keep_cells_ = false;
    bool finest_ = false;
    std::vector<RaySegment> segments_;
};

}  // namespace brickyard

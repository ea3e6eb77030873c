#include "client/cpu/channel_ray.h"

#include <algorithm>

#include "client/cpu/cell_walk.h"
#include "client/cpu/node_error.h"

namespace brickyard {

namespace {

// Relative rounding of one segment's integral: float samples are exact, so only the double arithmetic counts.
constexpr double kRounding = 1e-12;

}  // namespace

ChannelRay::ChannelRay(const PagedChannel& channel, const WorldRay& ray, double scale, bool keep_cells)
    : channel_(&channel),
      ray_(ray, channel.transform()),
      scale_(scale),
      unit_length_(ray_.unitLength()),
      keep_cells_(keep_cells) {}

void ChannelRay::append(const WalkedNode& node, double worth, std::vector<RaySegment>& out) const {
    // A background that is not positive adds nothing.
    if (node.status == WalkStatus::kBackground && !(channel_->background() > 0)) return;
    RaySegment segment;
    segment.span = node.span;
    segment.node = node;
    segment.worth = worth;
    if (node.status == WalkStatus::kNode) {
        segment.draft = !finest_ && node.record().hasDraft();
        describeErrors(segment);
    }
    if (node.status == WalkStatus::kMissingBlock) segment.state = SegmentState::kBlocked;
    out.push_back(std::move(segment));
}

void ChannelRay::describeErrors(RaySegment& segment) const {
    const WalkedNode& node = segment.node;
    if (segment.draft) {
        const double length = scale_ * (segment.span.end - segment.span.begin);
        segment.half_width = double(node.record().draft_bound) * length;
        segment.variance =
            effectiveSquare(double(node.record().draft_rms), double(node.record().draft_bound)) * scale_ *
            length * unit_length_ * cellEdge(node.key.level);
        return;
    }
    errorsOf(node.record(), node.block->errorGrid(node.ref.node), node.key, segment.span, segment.half_width,
             segment.variance);
    segment.variance *= speckFactor(*channel_, node.key);
}

void ChannelRay::begin(bool finest) {
    segments_.clear();
    finest_ = finest;
    if (channel_->empty()) return;
    const RaySpan span =
        ray_.clip(channel_->clipLow(), channel_->clipHigh(), {0, std::numeric_limits<double>::infinity()});
    if (span.empty()) return;
    walkOctree(
        *channel_, ray_, span, [&](const WalkedNode&) { return finest; },
        [&](const WalkedNode& node) {
            append(node, 1, segments_);
            return true;
        });
}

void ChannelRay::want(const WantedPage& page, std::uint32_t bytes, double worth,
                      const RayContext& context) const {
    context.wants->add(page, bytes, worth, context.tile);
}

// Strict half-width and variance of the integral over `span`, from the node's error grid where it has one.
// Variance: square of the effective deviation x length x one voxel of the level (DESIGN.md, section 11).
void ChannelRay::errorsOf(const NodeRecord& record, const ErrorGrid* grid, const NodeKey& key, RaySpan span,
                          double& half_width, double& variance) const {
    half_width = variance = 0;
    if (record.bound == 0) return;
    const double voxel = unit_length_ * cellEdge(key.level);
    const double length = span.end - span.begin;
    if (!grid) {
        half_width = double(record.bound) * scale_ * length;
        variance = kLeafCorrelation * effectiveSquare(double(record.rms), double(record.bound)) * scale_ *
                   scale_ * length * voxel;
        return;
    }
    const double unit_square = double(record.bound) * double(record.bound) * scale_ * scale_ * voxel;

    const double edge = nodeEdge(key, channel_->shape()) / kErrorGridEdge;
    const glm::dvec3 low = nodeLow(key, channel_->shape());
    int box[3];
    double t_next[3];
    auto planeBehind = [&](int a) {
        if (ray_.parallel[a]) return std::numeric_limits<double>::infinity();
        const int plane = box[a] + (ray_.direction[a] > 0 ? 1 : 0);
        if (plane <= 0 || plane >= kErrorGridEdge) return std::numeric_limits<double>::infinity();
        return ray_.planeAt(a, low[a] + edge * plane);
    };
    for (int a = 0; a < 3; ++a) {
        const double position = (ray_.origin[a] + span.begin * ray_.direction[a] - low[a]) / edge;
        box[a] = int(std::clamp(std::floor(position), 0.0, double(kErrorGridEdge - 1)));
        t_next[a] = planeBehind(a);
    }
    double t = span.begin;
    while (t < span.end) {
        const int a =
            t_next[0] < t_next[1] ? (t_next[0] < t_next[2] ? 0 : 2) : (t_next[1] < t_next[2] ? 1 : 2);
        const double t_exit = std::min(t_next[a], span.end);
        const std::size_t at = std::size_t(box[0] + kErrorGridEdge * (box[1] + kErrorGridEdge * box[2]));
        if (t_exit > t) {
            half_width += double(errorFromCode(grid->bound[at], record.bound)) * scale_ * (t_exit - t);
            variance += unit_square * effectiveSquareOfCodes(grid->rms[at], grid->bound[at]) * (t_exit - t);
            t = t_exit;
        }
        if (t_next[a] >= span.end) break;
        box[a] += ray_.direction[a] > 0 ? 1 : -1;
        t_next[a] = planeBehind(a);
    }
}

void ChannelRay::integrateConstant(double value, RaySegment& segment) const {
    segment.integral = std::max(0.0, value) * scale_ * (segment.span.end - segment.span.begin);
    segment.low = segment.integral * (1 - kRounding);
    segment.high = segment.integral * (1 + kRounding);
    segment.half_width = segment.variance = 0;
    segment.cells.clear();
    if (keep_cells_ && segment.integral > 0) segment.cells.push_back({segment.span.end, segment.integral});
}

void ChannelRay::integrateBrick(const float* samples, const WalkedNode& node, RaySegment& segment) const {
    const NodeRecord& record = node.record();
    const double background = std::max(0.0, double(channel_->background())) * scale_;
    double sum = 0, t = segment.span.begin;
    // Gathered aside, so that the segment holds as much as it needs and a thread allocates once.
    thread_local std::vector<CellStep> cells;
    cells.clear();
    auto step = [&](double end, double amount) {
        sum += amount;
        t = end;
        if (keep_cells_) cells.push_back({end, sum});
    };
    // Outside the node's tight box, and between what was visited, lies background.
    auto gap = [&](double end) {
        if (end <= t) return;
        if (background > 0 || (keep_cells_ && !cells.empty() && end < segment.span.end))
            step(end, background * (end - t));
    };
    walkCells(samples, channel_->shape(), node.key, record, ray_, segment.span,
              [&](const Cell& cell, const glm::dvec3& from, const glm::dvec3& to, double begin, double end) {
                  const double mean = meanPositive(cell, from, to);
                  if (mean == 0) {
                      if (background > 0) gap(begin), step(end, 0);
                      return;
                  }
                  if (begin > t) {
                      if (keep_cells_ && cells.empty() && background == 0)
                          step(begin, 0);
                      else
                          gap(begin);
                  }
                  step(end, mean * scale_ * (end - begin));
              });
    gap(segment.span.end);

    segment.cells.assign(cells.begin(), cells.end());
    segment.integral = sum;
    double half_width = segment.half_width;
    // Between samples of both signs digits cancel.
    if (record.value_min < 0)
        half_width += kRounding * std::max(double(record.value_max), -double(record.value_min)) * scale_ *
                      (segment.span.end - segment.span.begin);
    // The range of the node's values bounds the integral too.
    const double length = (segment.span.end - segment.span.begin) * scale_;
    segment.low = std::max(sum * (1 - kRounding) - half_width,
                           std::min(double(record.value_min), double(channel_->background())) * length);
    segment.high = std::min(
        sum * (1 + kRounding) + half_width,
        std::max(double(record.value_max), double(channel_->background())) * length * (1 + kRounding));
    segment.low = std::clamp(segment.low, 0.0, sum);
    segment.high = std::max(segment.high, sum);
}

void ChannelRay::replace(std::size_t at, std::vector<RaySegment> with) {
    const auto place = segments_.begin() + std::ptrdiff_t(at);
    if (with.empty()) {
        segments_.erase(place);
        return;
    }
    *place = std::move(with.front());
    segments_.insert(place + 1, std::make_move_iterator(with.begin() + 1),
                     std::make_move_iterator(with.end()));
}

// A stretch whose block was missing: what the walk finds now takes its place. False while the block has not
// come.
bool ChannelRay::resolveBlocked(std::size_t at, const RayContext& context) {
    const RaySegment segment = segments_[at];
    const WantedPage page{true, {channel_->index(), segment.node.missing_block, 0}};
    std::vector<RaySegment> found;
    if (context.failed->contains(page)) {
        standIn(segment, context, found);
        for (RaySegment& part : found) part.failed = true;
    } else if (!channel_->block(segment.node.missing_block)) {
        want(page, std::uint32_t(channel_->blockBytes(segment.node.missing_block)), segment.worth, context);
        return false;
    } else {
        walkOctree(
            *channel_, ray_, segment.span, [&](const WalkedNode&) { return finest_; },
            [&](const WalkedNode& node) {
                append(node, segment.worth, found);
                return true;
            });
    }
    replace(at, std::move(found));
    return true;
}

bool ChannelRay::integrate(const RayContext& context, double opaque_depth) {
    bool complete = true;
    double depth = 0;  // in front of the segment: exact while complete, else what is known at least
    for (std::size_t i = 0; i < segments_.size();) {
        if (segments_[i].state == SegmentState::kBlocked) {
            if (resolveBlocked(i, context)) continue;
            complete = false;
            ++i;
            continue;
        }
        RaySegment& segment = segments_[i];
        if (segment.state == SegmentState::kWaiting) {
            const WalkedNode& node = segment.node;
            if (node.status == WalkStatus::kBackground) {
                integrateConstant(double(channel_->background()), segment);
                segment.state = SegmentState::kDone;
            } else if (!node.record().hasBrick()) {
                const ValueBits bits = node.block->constant(node.ref.node)[0];
                integrateConstant(double(toFloat(channel_->type(), bits)), segment);
                segment.state = SegmentState::kDone;
            } else if (const float* samples = context.cache->find(pageOf(node.ref, segment.draft))) {
                integrateBrick(samples, node, segment);
                segment.state = SegmentState::kDone;
            } else if (context.failed->contains({false, pageOf(node.ref, segment.draft)})) {
                std::vector<RaySegment> parts;
                standIn(segment, context, parts);
                for (RaySegment& part : parts) part.failed = true;
                replace(i, std::move(parts));
                continue;
            } else {
                const NodeRecord& record = node.record();
                want({false, pageOf(node.ref, segment.draft)},
                     segment.draft ? record.draft_bytes : record.payload_bytes, segment.worth, context);
                complete = false;
                depth += std::max(0.0, double(record.value_min)) * scale_ *
                         (segment.span.end - segment.span.begin);
            }
        }
        // Only what is certain hides what is behind: a coarse segment may lose depth when it is refined.
        if (segment.state == SegmentState::kDone) depth += segment.low;
        if (depth > opaque_depth) {
            // Nothing behind can be seen; while segments in front wait, that is not certain to stay.
            if (complete) segments_.resize(i + 1);
            break;
        }
        ++i;
    }
    return complete;
}

bool ChannelRay::planSplit(const RaySegment& segment, const RayContext& context, Split& out) const {
    bool known = true;
    out = {};
    if (segment.draft) {
        // The same stretch from the whole brick.
        RaySegment& whole = out.children.emplace_back();
        whole.span = segment.span;
        whole.node = segment.node;
        describeErrors(whole);
        out.half_width = whole.half_width;
        out.variance = whole.variance;
        out.bytes = segment.node.record().payload_bytes;
        return true;
    }
    out.children.reserve(4);
    walkChildren(*channel_, ray_, segment.node, [&](const WalkedNode& child) {
        if (child.status == WalkStatus::kMissingBlock) {
            const WantedPage page{true, {channel_->index(), child.missing_block, 0}};
            out.failed = context.failed->contains(page);
            known = out.failed;
            if (!known)
                want(page, std::uint32_t(channel_->blockBytes(child.missing_block)), segment.worth, context);
            return false;
        }
        append(child, 0, out.children);
        if (child.status == WalkStatus::kBackground) return true;
        out.half_width += out.children.back().half_width;
        out.variance += out.children.back().variance;
        out.bytes += out.children.back().draft ? child.record().draft_bytes : child.record().payload_bytes;
        return true;
    });
    return known;
}

void ChannelRay::split(std::size_t at, Split plan, double worth) {
    for (RaySegment& child : plan.children) {
        child.effect = segments_[at].effect;
        child.worth = worth / double(plan.children.size());
    }
    replace(at, std::move(plan.children));
}

// Down from the roots while all of a node's bricks are resident; the last brick on the way stands in.
void ChannelRay::standIn(const RaySegment& segment, const RayContext& context,
                         std::vector<RaySegment>& out) const {
    const int level = segment.node.status == WalkStatus::kNode ? segment.node.key.level : 0;
    auto resident = [&](const NodeRef& ref) {
        const TreeBlock* block = channel_->block(ref.block);
        return block && (!block->record(ref.node).hasBrick() || context.cache->contains(pageOf(ref, false)) ||
                         context.cache->contains(pageOf(ref, true)));
    };
    auto descend = [&](const WalkedNode& node) {
        if (node.key.level <= level) return false;
        const ChildrenRef first = node.block->children(node.ref.node);
        const int count = __builtin_popcount(node.block->validMask(node.ref.node));
        for (int c = 0; c < count; ++c)
            if (!resident({first.block, first.first + std::uint32_t(c)})) return false;
        return true;
    };
    auto draw = [&](const WalkedNode& node) {
        RaySegment part;
        part.span = node.span;
        part.node = node;
        part.state = SegmentState::kDone;
        const double length = scale_ * (node.span.end - node.span.begin);
        if (node.status == WalkStatus::kBackground) {
            integrateConstant(double(channel_->background()), part);
        } else if (node.status == WalkStatus::kMissingBlock) {
            // Not even its range is known.
            part.high = part.half_width = part.variance = std::numeric_limits<float>::max();
        } else if (!node.record().hasBrick()) {
            integrateConstant(double(toFloat(channel_->type(), node.block->constant(node.ref.node)[0])),
                              part);
        } else if (const float* whole = context.cache->find(pageOf(node.ref, false))) {
            describeErrors(part);
            integrateBrick(whole, node, part);
        } else if (const float* draft = context.cache->find(pageOf(node.ref, true))) {
            part.draft = true;
            describeErrors(part);
            integrateBrick(draft, node, part);
        } else {
            // The middle of its range, with all of the range as its error.
            const double low = std::max(0.0, double(node.record().value_min));
            const double high = std::max(low, double(node.record().value_max));
            integrateConstant(0.5 * (low + high), part);
            part.low = low * length;
            part.high = high * length;
            part.half_width = part.high;
            part.variance = (part.high - part.low) * (part.high - part.low) / 12;
        }
        out.push_back(std::move(part));
        return true;
    };
    walkOctree(*channel_, ray_, segment.span, descend, draw);
}

std::vector<RaySegment> ChannelRay::provisional(const RayContext& context) const {
    std::vector<RaySegment> drawn;
    for (const RaySegment& segment : segments_) {
        if (segment.state == SegmentState::kDone)
            drawn.push_back(segment);
        else
            standIn(segment, context, drawn);
    }
    return drawn;
}

}  // namespace brickyard

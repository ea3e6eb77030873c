#include "client/cpu/shadow_tracer.h"

#include <cmath>
#include <vector>

#include "client/cpu/cell_walk.h"

namespace brickyard {

namespace {

// exp(-kOpaque) is below what a float can add to 1.
constexpr double kOpaque = 20;
// Steps between two that are always traced: a shadow edge thinner than this many cells of the level may be
// smoothed.
constexpr std::size_t kMostInterpolated = 8;

// Where half of what a step of optical depth `depth` scatters has been scattered, as a part of its length.
double middleOfWeight(double depth) {
    if (depth < 1e-6) return 0.5;
    return -std::log(0.5 * (1 + std::exp(-depth))) / depth;
}

}  // namespace

// The steps of one segment: where each scatters most, and how much.
struct ShadowTracer::Steps {
    const ChannelRay& ray;
    RaySegment& segment;
    std::vector<double> distance;
    std::vector<double> weight;
};

ShadowTracer::ShadowTracer(const RenderPlan& plan, const Tolerances& tolerances)
    : plan_(plan),
      direction_(plan.density->transform().inverseVector(plan.scene.light->to_light)),
      unit_length_(1 / glm::length(direction_)),
      tolerances_(tolerances) {}

bool ShadowTracer::light(const ChannelRay& ray, RaySegment& segment, double transmittance,
                         const RayContext& context) const {
    if (segment.cells.empty() || segment.cells.back().shadow >= 0) return true;
    Steps steps{ray, segment, {}, {}};
    double begin = segment.span.begin, before = 0;
    for (const CellStep& step : segment.cells) {
        const double depth = step.integral - before;
        steps.weight.push_back(transmittance * std::exp(-before) * -std::expm1(-depth));
        steps.distance.push_back(begin + middleOfWeight(depth) * (step.end - begin));
        begin = step.end;
        before = step.integral;
    }
    // Every few steps are traced; what lies between follows where it may. The last is lit last: it says that
    // all are.
    const std::size_t last = segment.cells.size() - 1;
    for (std::size_t first = 0; first < last; first += kMostInterpolated) {
        const std::size_t next = std::min(first + kMostInterpolated, last);
        if (next == last) {
            if (!lightStep(steps, first, context)) return false;
            for (std::size_t step = first + 1; step < last; ++step)
                if (!lightStep(steps, step, context)) return false;
            break;
        }
        if (!lightStep(steps, first, context) || !lightStep(steps, next, context) ||
            !lightBetween(steps, first, next, context))
            return false;
    }
    return lightStep(steps, last, context);
}

bool ShadowTracer::lightStep(const Steps& steps, std::size_t at, const RayContext& context) const {
    RaySegment& segment = steps.segment;
    CellStep& step = segment.cells[at];
    if (step.shadow >= 0) return true;
    if (steps.weight[at] < tolerances_.least_weight) {
        // Half-lit, give or take all of it: what it could add is below what matters.
        step.shadow = step.shadow_sd = steps.weight[at] > 0 ? 0.5f : 0.0f;
        return true;
    }
    // A ray under way for another step (its page came, but it is not this one's turn) would be lost; steps
    // are lit in a fixed order, so the first that is not lit is the one under way.
    if (segment.shadow_step != at) segment.shadow_t = segment.shadow_depth = segment.shadow_variance = 0;
    segment.shadow_step = std::uint32_t(at);
    const IndexRay& ray = steps.ray.ray();
    if (!trace(ray.origin + steps.distance[at] * ray.direction, segment, context, steps.weight[at]))
        return false;
    const double lit = std::exp(-segment.shadow_depth);
    step.shadow = float(lit);
    step.shadow_sd = float(std::min(1.0, lit * std::sqrt(segment.shadow_variance)));
    segment.shadow_t = segment.shadow_depth = segment.shadow_variance = 0;
    return true;
}

// REQUIRES: first and last are lit.
bool ShadowTracer::lightBetween(const Steps& steps, std::size_t first, std::size_t last,
                                const RayContext& context) const {
    if (last - first < 2) return true;
    std::vector<CellStep>& cells = steps.segment.cells;
    double weight = 0;
    for (std::size_t i = first + 1; i < last; ++i) weight += steps.weight[i];
    const double difference = std::abs(double(cells[first].shadow) - double(cells[last].shadow));
    if (weight * difference < tolerances_.interpolation) {
        for (std::size_t i = first + 1; i < last; ++i) {
            const double t =
                (steps.distance[i] - steps.distance[first]) / (steps.distance[last] - steps.distance[first]);
            cells[i].shadow = float(double(cells[first].shadow) * (1 - t) + double(cells[last].shadow) * t);
            cells[i].shadow_sd =
                std::max(cells[first].shadow_sd, cells[last].shadow_sd) + float(0.25 * difference);
        }
        return true;
    }
    const std::size_t middle = (first + last) / 2;
    return lightStep(steps, middle, context) && lightBetween(steps, first, middle, context) &&
           lightBetween(steps, middle, last, context);
}

// Adds up optical depth in the order of the ray, node by node, so that a ray taken up again ends with the
// same bits.
bool ShadowTracer::trace(const glm::dvec3& from, RaySegment& segment, const RayContext& context,
                         double worth) const {
    const PagedChannel& density = *plan_.density;
    const double scale = plan_.scene.density_scale;
    IndexRay ray;
    ray.origin = from;
    ray.direction = direction_;
    const double longest = std::max({std::abs(direction_.x), std::abs(direction_.y), std::abs(direction_.z)});
    for (int a = 0; a < 3; ++a) {
        ray.parallel[a] = !(std::abs(direction_[a]) > longest * 1e-280);
        ray.inverse[a] = ray.parallel[a] ? 0 : 1 / direction_[a];
    }
    const RaySpan span =
        ray.clip(density.clipLow(), density.clipHigh(), {0, std::numeric_limits<double>::infinity()});
    if (span.empty()) return true;
    const double whole = span.end - span.begin;

    bool blocked = false;
    auto want = [&](const WantedPage& page, std::uint32_t bytes) {
        context.wants->add(page, bytes, worth, context.tile);
        blocked = true;
    };
    auto varianceOf = [&](const NodeRecord& record, const NodeKey& key, double length) {
        const double rms = double(record.rms) * scale;
        return rms * rms * length * unit_length_ * cellEdge(key.level);
    };
    walkOctree(
        density, ray, span,
        [&](const WalkedNode& node) {
            if (node.span.end <= segment.shadow_t) return false;
            const WantedPage below{true, {density.index(), node.block->children(node.ref.node).block, 0}};
            if (context.failed->contains(below)) return false;
            // A share of the tolerated variance in proportion to length.
            const double length = node.span.end - node.span.begin;
            return varianceOf(node.record(), node.key, length) >
                   tolerances_.depth * tolerances_.depth * length / whole;
        },
        [&](const WalkedNode& node) {
            if (node.span.end <= segment.shadow_t) return true;
            double depth = 0;
            const double length = node.span.end - node.span.begin;
            double variance =
                node.status == WalkStatus::kNode ? varianceOf(node.record(), node.key, length) : 0;
            const double background = std::max(0.0, double(density.background()));
            if (node.status == WalkStatus::kBackground) {
                depth = background * length;
            } else if (node.status == WalkStatus::kMissingBlock) {
                const WantedPage page{true, {density.index(), node.missing_block, 0}};
                if (!context.failed->contains(page))
                    want(page, std::uint32_t(density.blockBytes(node.missing_block)));
            } else if (!node.record().hasBrick()) {
                const ValueBits bits = node.block->constant(node.ref.node)[0];
                depth = std::max(0.0, double(toFloat(density.type(), bits))) * length;
            } else {
                // The draft does where its error is within the tolerance; the choice rests on the tree alone.
                const double draft_rms = double(node.record().draft_rms) * scale;
                const bool draft = node.record().hasDraft() && draft_rms * draft_rms * unit_length_ * whole <=
                                                                   tolerances_.depth * tolerances_.depth;
                if (draft) variance = draft_rms * draft_rms * unit_length_ * length;
                const PageAddress page{density.index(), node.ref.block, node.ref.node, draft};
                const float* samples = context.cache->find(page);
                double inside = 0;
                if (samples) {
                    // Where an error is allowed, the middle of a cell stands for it: a second-order error
                    // with changing sign, far below the tolerance.
                    const bool exact = tolerances_.depth == 0;
                    walkCells(samples, density.shape(), node.key, node.record(), ray, node.span,
                              [&](const Cell& cell, const glm::dvec3& a, const glm::dvec3& b, double begin,
                                  double end) {
                                  const double mean = exact ? meanPositive(cell, a, b)
                                                            : std::max(0.0, cell.at(0.5 * (a + b)));
                                  depth += mean * (end - begin);
                                  inside += end - begin;
                              });
                    depth += background * std::max(0.0, length - inside);
                } else if (context.failed->contains({false, page})) {
                    depth =
                        0.5 *
                        (std::max(0.0, double(node.record().value_min)) + double(node.record().value_max)) *
                        length;
                } else {
                    want({false, page}, draft ? node.record().draft_bytes : node.record().payload_bytes);
                }
            }
            // Behind a gap nothing may be added yet; the walk goes on only to want what else is missing.
            if (blocked) return !context.full();
            segment.shadow_depth += depth * scale;
            segment.shadow_variance += variance;
            segment.shadow_t = node.span.end;
            return segment.shadow_depth < kOpaque;
        });
    return !blocked;
}

}  // namespace brickyard

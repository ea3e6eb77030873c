#include "client/cpu/ray_tracer.h"

#include <algorithm>
#include <cmath>

namespace brickyard {

namespace {

// Beyond this optical depth nothing shows: exp(-46) = 1e-20.
constexpr double kOpaqueDepth = 46;
// A sixth of the pixels' standard deviation is kept for the shadows, so that levels of the view can use the
// rest.
constexpr double kShadowShare = 0.4;
// Scattering below this weight is not worth a shadow ray.
constexpr double kReferenceLeastWeight = 1e-7;
constexpr double kLeastWeightOfError = 1e-3;
// Of the pixel's standard deviation, what interpolating a few neighbouring shadows may make.
constexpr double kInterpolationShare = 0.25;

// What the shadows may be off by, from what the pixel may be off by.
ShadowTracer::Tolerances shadowTolerances(const RenderPlan& plan) {
    if (plan.quality.reference) return {.least_weight = kReferenceLeastWeight};
    ShadowTracer::Tolerances tolerances;
    tolerances.least_weight = kLeastWeightOfError * plan.quality.max_error;
    if (plan.quality.strict) return tolerances;
    const glm::dvec3 scattered = plan.scattered();
    const double g = std::abs(plan.scene.anisotropy);
    const double most = std::max({scattered.x, scattered.y, scattered.z, 1e-30}) * henyeyGreenstein(g, 1);
    tolerances.depth = kShadowShare * plan.quality.max_error / 3 / std::max(most, 1e-30);
    tolerances.interpolation = kInterpolationShare * plan.quality.max_error / 3 / std::max(most, 1e-30);
    return tolerances;
}

}  // namespace

RayTracer::RayTracer(const RenderPlan& plan)
    : plan_(plan),
      eye_is_far_(!plan.density->empty() && eyeIsFar(plan)),
      estimate_target_(plan.quality.max_error / 3),
      opaque_depth_(kOpaqueDepth) {
    if (plan.scene.light) shadows_.emplace(plan_, shadowTolerances(plan));
}

bool RayTracer::hasFailed(const PixelRay& ray) {
    auto any = [](const ChannelRay& channel) {
        return std::any_of(channel.segments().begin(), channel.segments().end(),
                           [](const RaySegment& segment) { return segment.failed; });
    };
    return any(ray.density) || (ray.emission && any(*ray.emission));
}

bool RayTracer::lightAll(PixelRay& ray, const RayContext& context) const {
    bool complete = true;
    double before = 0;
    for (RaySegment& segment : ray.density.segments()) {
        if (segment.state != SegmentState::kDone) return false;
        complete &= shadows_->light(ray.density, segment, std::exp(-before), context);
        if (!complete && context.full()) return false;
        before += segment.integral;
    }
    return complete;
}

bool RayTracer::goodEnough(const RayComposite& composite, bool with_light) const {
    if (plan_.quality.strict) {
        // Without a light the radiance has a bound that refinement reaches; scattered light has not
        // (docs/error-bounds.md).
        return composite.bound_alpha <= plan_.quality.max_error &&
               (with_light || composite.bound_radiance <= plan_.quality.max_error);
    }
    return composite.estimate_alpha <= estimate_target_ && composite.estimate_radiance <= estimate_target_;
}

// Moves the origin to just in front of the medium. The product is kept in two doubles until the eye has
// been added: at 1e15 a rounding of it would be a voxel.
void RayTracer::beginAtMedium(PixelRay& ray) const {
    const PagedChannel& density = *plan_.density;
    const glm::dvec3 middle = density.transform().point(0.5 * (density.clipLow() + density.clipHigh()));
    const glm::dvec3 extent = density.clipHigh() - density.clipLow();
    double reach = 0;  // no point of the medium is farther from its middle
    for (int a = 0; a < 3; ++a) {
        glm::dvec3 axis(0);
        axis[a] = extent[a];
        reach += glm::length(density.transform().vector(axis));
    }
    ray.offset = std::max(0.0, glm::dot(middle - ray.world.origin, ray.world.direction) - reach);
    for (int a = 0; a < 3; ++a) {
        const double product = ray.offset * ray.world.direction[a];
        const double rest = std::fma(ray.offset, ray.world.direction[a], -product);
        // Knuth's two-sum: the exact error of the addition.
        const double origin = ray.world.origin[a], sum = origin + product, part = sum - origin;
        const double lost = (origin - (sum - part)) + (product - part);
        ray.world.origin[a] = sum + (lost + rest);
    }
}

void RayTracer::begin(std::uint32_t x, std::uint32_t y, PixelRay& ray) const {
    ray.begun = true;
    ray.world = plan_.camera->ray(x, y);
    if (eye_is_far_) beginAtMedium(ray);
    ray.density = ChannelRay(*plan_.density, ray.world, plan_.scene.density_scale, /*keep_cells=*/true);
    ray.density.begin(plan_.quality.reference);
    if (!plan_.emission) return;
    ray.emission.emplace(*plan_.emission, ray.world, plan_.scene.emission->scale, /*keep_cells=*/true);
    ray.emission->begin(plan_.quality.reference);
}

RayTracer::Progress RayTracer::advance(std::uint32_t x, std::uint32_t y, PixelRay& ray,
                                       const RayContext& context, RayComposite& out) const {
    if (!ray.begun) begin(x, y, ray);
    const std::vector<RaySegment>* emission = ray.emission ? &ray.emission->segments() : nullptr;
    auto composite = [&](bool with_light) {
        RayComposite pixel =
            compositeRay(plan_, ray.world.direction, ray.density.segments(), emission, with_light);
        if (pixel.depth > 0) pixel.depth += ray.offset;
        return pixel;
    };
    Progress progress = Progress::kMissing;
    for (;;) {
        // Both channels are asked before either answer counts: all that is missing is wanted at once.
        const bool have_density = ray.density.integrate(context, opaque_depth_);
        const bool have_emission =
            !ray.emission || ray.emission->integrate(context, std::numeric_limits<double>::infinity());
        if (!have_density || !have_emission) return progress;

        // Levels first, then light: shadows are traced on the cut that the opacity settled for.
        if (!plan_.quality.reference) {
            out = composite(false);
            if (!shadows_) progress = Progress::kDrawn;
            if (!goodEnough(out, shadows_.has_value())) {
                const Refined refined = refine(ray, out, context);
                if (refined == Refined::kSplit) continue;
                if (refined == Refined::kWaiting) return progress;
            }
            if (!shadows_) return Progress::kFinal;
        }
        if (shadows_ && !lightAll(ray, context)) return progress;
        out = composite(shadows_.has_value());
        if (plan_.quality.reference || goodEnough(out, true)) return Progress::kFinal;
        progress = Progress::kDrawn;
        const Refined refined = refine(ray, out, context);
        if (refined == Refined::kDone) return Progress::kFinal;
        if (refined == Refined::kWaiting) return progress;
    }
}

// Splits on what topology tells, without waiting for the bricks between: a ray goes from its coarse look to
// the cut that its error asks for in one step, and pays for no level on the way.
RayTracer::Refined RayTracer::refine(PixelRay& ray, const RayComposite& composite,
                                     const RayContext& context) const {
    const QualitySettings& quality = plan_.quality;
    const bool alpha_matters = quality.strict ? composite.bound_alpha > quality.max_error
                                              : composite.estimate_alpha > estimate_target_;
    const bool radiance_matters = quality.strict ? composite.bound_radiance > quality.max_error
                                                 : composite.estimate_radiance > estimate_target_;
    // Strict: what a half-width can do to the transmittance, at most. Else: first order.
    const double strict_effect = std::exp(-composite.optical_low);
    for (std::size_t i = 0; i < ray.density.segments().size(); ++i) {
        double effect = quality.strict ? strict_effect : alpha_matters ? composite.density_alpha[i] : 0;
        if (!quality.strict && radiance_matters) effect = std::max(effect, composite.density_radiance[i]);
        ray.density.segments()[i].effect = effect;
    }
    if (ray.emission)
        for (std::size_t i = 0; i < ray.emission->segments().size(); ++i)
            ray.emission->segments()[i].effect = radiance_matters ? composite.emission_radiance[i] : 0;

    auto errorOf = [&](const RaySegment& segment) {
        return quality.strict ? segment.effect * segment.half_width
                              : segment.effect * segment.effect * segment.variance;
    };
    // Ranked by what a split does for all rays: the node's squared error over its volume; 0 where nothing can
    // be gained. Rays that agree on the order share their bricks; a rank of each ray's own would have the
    // union of all rays' favourites loaded.
    auto rankOf = [&](const ChannelRay& channel, const RaySegment& segment) {
        if (!(errorOf(segment) > 0) || !channel.canSplit(segment)) return 0.0;
        if (quality.pixels_per_voxel > 0) {
            const double middle = ray.offset + 0.5 * (segment.span.begin + segment.span.end);
            // A draft is as fine as its level: it is no reason to go on where the level is fine enough.
            if (channel.voxelLength(segment) <= quality.pixels_per_voxel * plan_.camera->pixelEdge() * middle)
                return 0.0;
        }
        const NodeRecord& record = segment.node.record();
        const double deviation = quality.strict ? double(segment.draft ? record.draft_bound : record.bound)
                                                : double(segment.draft ? record.draft_rms : record.rms);
        const double edge = cellEdge(segment.node.key.level);
        return deviation * deviation * edge * edge * edge * edge;
    };

    std::vector<ChannelRay*> channels{&ray.density};
    if (ray.emission) channels.push_back(&*ray.emission);
    std::vector<std::vector<double>> ranks(channels.size());
    double sum = 0;
    for (std::size_t c = 0; c < channels.size(); ++c)
        for (const RaySegment& segment : channels[c]->segments()) {
            sum += errorOf(segment);
            ranks[c].push_back(rankOf(*channels[c], segment));
        }
    const double target = quality.strict ? quality.max_error : estimate_target_ * estimate_target_;
    bool any = false;
    while (!any || sum > target) {
        std::size_t best_channel = 0, best = 0;
        double best_rank = 0;
        for (std::size_t c = 0; c < channels.size(); ++c)
            for (std::size_t i = 0; i < ranks[c].size(); ++i)
                if (ranks[c][i] > best_rank) best_channel = c, best = i, best_rank = ranks[c][i];
        if (!(best_rank > 0)) break;
        ChannelRay& channel = *channels[best_channel];
        std::vector<double>& list = ranks[best_channel];
        const RaySegment& segment = channel.segments()[best];
        ChannelRay::Split plan;
        // Without its block nothing more can be decided; what was split so far can be integrated meanwhile.
        if (!channel.planSplit(segment, context, plan)) return any ? Refined::kSplit : Refined::kWaiting;
        if (plan.failed) {
            list[best] = 0;
            continue;
        }
        const double now = errorOf(segment);
        const double then = quality.strict ? segment.effect * plan.half_width
                                           : segment.effect * segment.effect * plan.variance;
        any = true;
        sum -= now - then;
        const std::size_t count = plan.children.size();
        channel.split(best, std::move(plan), std::max(now - then, 1e-3 * now));
        list.erase(list.begin() + std::ptrdiff_t(best));
        for (std::size_t k = 0; k < count; ++k)
            list.insert(list.begin() + std::ptrdiff_t(best + k),
                        rankOf(channel, channel.segments()[best + k]));
    }
    return any ? Refined::kSplit : Refined::kDone;
}

RayComposite RayTracer::provisional(const PixelRay& ray, const RayContext& context) const {
    const std::vector<RaySegment> density = ray.density.provisional(context);
    std::vector<RaySegment> emission;
    if (ray.emission) emission = ray.emission->provisional(context);
    // Steps that no shadow ray has reached count as half-lit, give or take all of it.
    std::vector<RaySegment> lit = density;
    if (plan_.scene.light)
        for (RaySegment& segment : lit)
            for (CellStep& step : segment.cells)
                if (step.shadow < 0) step.shadow = step.shadow_sd = 0.5f;
    RayComposite pixel = compositeRay(plan_, ray.world.direction, lit, ray.emission ? &emission : nullptr,
                                      plan_.scene.light.has_value());
    if (pixel.depth > 0) pixel.depth += ray.offset;
    return pixel;
}

}  // namespace brickyard

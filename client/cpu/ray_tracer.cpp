#include "client/cpu/ray_tracer.h"

#include <algorithm>
#include <cmath>

namespace brickyard {

namespace {

// Beyond this optical depth nothing shows: exp(-46) = 1e-20.
constexpr double kOpaqueDepth = 46;
// A sixth of the pixels' standard deviation is kept for the shadows, so that levels of the view can use the rest.
constexpr double kShadowShare = 0.4;
// Scattering below this weight is not worth a shadow ray.
constexpr double kReferenceLeastWeight = 1e-7;
constexpr double kLeastWeightOfError = 1e-3;

double shadowTolerance(const RenderPlan& plan) {
    if (plan.quality.reference || plan.quality.strict) return 0;
    const glm::dvec3 scattered = plan.scattered();
    const double g = std::abs(plan.scene.anisotropy);
    const double most = std::max({scattered.x, scattered.y, scattered.z, 1e-30}) * henyeyGreenstein(g, 1);
    return kShadowShare * plan.quality.max_error / 3 / std::max(most, 1e-30);
}

}  // namespace

RayTracer::RayTracer(const RenderPlan& plan)
    : plan_(plan), estimate_target_(plan.quality.max_error / 3),
      least_weight_(plan.quality.reference ? kReferenceLeastWeight : kLeastWeightOfError * plan.quality.max_error),
      opaque_depth_(kOpaqueDepth) {
    if (plan.scene.light) shadows_.emplace(plan_, shadowTolerance(plan));
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
        complete &= shadows_->light(ray.density, segment, std::exp(-before), least_weight_, context);
        before += segment.integral;
    }
    return complete;
}

bool RayTracer::goodEnough(const RayComposite& composite, bool with_light) const {
    if (plan_.quality.strict) {
        // Without a light the radiance has a bound that refinement reaches; scattered light has not (docs/error-bounds.md).
        return composite.bound_alpha <= plan_.quality.max_error &&
               (with_light || composite.bound_radiance <= plan_.quality.max_error);
    }
    return composite.estimate_alpha <= estimate_target_ && composite.estimate_radiance <= estimate_target_;
}

bool RayTracer::advance(std::uint32_t x, std::uint32_t y, PixelRay& ray, const RayContext& context, RayComposite& out) const {
    if (!ray.begun) {
        ray.begun = true;
        ray.world = plan_.camera->ray(x, y);
        ray.density = ChannelRay(*plan_.density, ray.world, plan_.scene.density_scale, /*keep_cells=*/true);
        ray.density.begin(plan_.quality.reference);
        if (plan_.emission) {
            ray.emission.emplace(*plan_.emission, ray.world, plan_.scene.emission->scale, /*keep_cells=*/true);
            ray.emission->begin(plan_.quality.reference);
        }
    }
    const std::vector<RaySegment>* emission = ray.emission ? &ray.emission->segments() : nullptr;
    for (;;) {
        // Both channels are asked before either answer counts: all that is missing is wanted at once.
        const bool have_density = ray.density.integrate(context, opaque_depth_);
        const bool have_emission = !ray.emission || ray.emission->integrate(context, std::numeric_limits<double>::infinity());
        if (!have_density || !have_emission) return false;

        // Levels first, then light: shadows are traced on the cut that the opacity settled for.
        if (!plan_.quality.reference) {
            const RayComposite unlit = compositeRay(plan_, ray.world.direction, ray.density.segments(), emission, false);
            if (!goodEnough(unlit, shadows_.has_value())) {
                const Refined refined = refine(ray, unlit, context);
                if (refined == Refined::kSplit) continue;
                if (refined == Refined::kWaiting) return false;
            }
        }
        if (shadows_ && !lightAll(ray, context)) return false;
        out = compositeRay(plan_, ray.world.direction, ray.density.segments(), emission, shadows_.has_value());
        if (plan_.quality.reference || !shadows_ || goodEnough(out, true)) return true;
        const Refined refined = refine(ray, out, context);
        if (refined == Refined::kDone) return true;
        if (refined == Refined::kWaiting) return false;
    }
}

RayTracer::Refined RayTracer::refine(PixelRay& ray, const RayComposite& composite, const RayContext& context) const {
    const QualitySettings& quality = plan_.quality;
    struct Candidate {
        bool emission = false;
        std::size_t segment = 0;
        double gain = 0;   // of what is summed up below
        double per_byte = 0;
    };
    std::vector<Candidate> candidates;
    bool waiting = false;
    double sum = 0;  // strict: half-widths of what matters; else variance of the pixel

    auto consider = [&](ChannelRay& channel, bool is_emission, std::size_t i, double effect) {
        const RaySegment& segment = channel.segments()[i];
        const double now = quality.strict ? effect * segment.half_width : effect * effect * segment.variance;
        sum += now;
        if (!(now > 0) || !channel.canSplit(segment)) return;
        if (quality.pixels_per_voxel > 0) {
            const double middle = 0.5 * (segment.span.begin + segment.span.end);
            if (channel.voxelLength(segment) <= quality.pixels_per_voxel * plan_.camera->pixelEdge() * middle) return;
        }
        ChannelRay::Expected expected;
        if (!channel.expectChildren(segment, context, expected)) {
            waiting = true;
            return;
        }
        if (expected.failed) return;
        const double then = quality.strict ? effect * expected.half_width : effect * effect * expected.variance;
        // A node whose children promise nothing is split all the same when nothing better is left: they end somewhere.
        const double gain = std::max(now - then, 1e-3 * now);
        candidates.push_back({is_emission, i, gain, gain / double(expected.bytes + 1)});
    };

    const bool alpha_matters = quality.strict ? composite.bound_alpha > quality.max_error
                                              : composite.estimate_alpha > estimate_target_;
    const bool radiance_matters = quality.strict ? composite.bound_radiance > quality.max_error
                                                 : composite.estimate_radiance > estimate_target_;
    const double strict_effect = std::exp(-composite.optical_low);
    for (std::size_t i = 0; i < ray.density.segments().size(); ++i) {
        double effect = 0;
        if (quality.strict) {
            effect = alpha_matters || radiance_matters ? strict_effect : 0;
        } else {
            if (alpha_matters) effect = composite.density_alpha[i];
            if (radiance_matters) effect = std::max(effect, composite.density_radiance[i]);
        }
        consider(ray.density, false, i, effect);
    }
    if (ray.emission && radiance_matters)
        for (std::size_t i = 0; i < ray.emission->segments().size(); ++i)
            consider(*ray.emission, true, i, composite.emission_radiance[i]);
    if (waiting) return Refined::kWaiting;
    if (candidates.empty()) return Refined::kDone;

    // The best per byte, until what would be left is within the target.
    std::sort(candidates.begin(), candidates.end(), [](const Candidate& a, const Candidate& b) {
        if (a.per_byte != b.per_byte) return a.per_byte > b.per_byte;
        return std::pair(a.emission, a.segment) < std::pair(b.emission, b.segment);
    });
    const double target = quality.strict ? quality.max_error : estimate_target_ * estimate_target_;
    std::vector<double> density_worth(ray.density.segments().size(), 0);
    std::vector<double> emission_worth(ray.emission ? ray.emission->segments().size() : 0, 0);
    bool any = false;
    for (const Candidate& candidate : candidates) {
        if (any && sum <= target) break;
        any = true;
        sum -= candidate.gain;
        (candidate.emission ? emission_worth : density_worth)[candidate.segment] = candidate.gain;
    }
    ray.density.split(density_worth);
    if (ray.emission) ray.emission->split(emission_worth);
    return Refined::kSplit;
}

RayComposite RayTracer::provisional(const PixelRay& ray, const RayContext& context) const {
    const std::vector<RaySegment> density = ray.density.provisional(context);
    std::vector<RaySegment> emission;
    if (ray.emission) emission = ray.emission->provisional(context);
    // Steps that no shadow ray has reached count as half-lit, give or take all of it.
    std::vector<RaySegment> lit = density;
    if (plan_.scene.light)
        for (RaySegment& segment : lit)
            for (std::size_t c = segment.lit; c < segment.cells.size(); ++c) segment.cells[c].shadow = segment.cells[c].shadow_sd = 0.5f;
    return compositeRay(plan_, ray.world.direction, lit, ray.emission ? &emission : nullptr, plan_.scene.light.has_value());
}

}  // namespace brickyard

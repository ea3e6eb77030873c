#include "client/cpu/ray_composite.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace brickyard {

namespace {

// What a float pixel and the double sums before it may be off by, relative to 1.
constexpr double kPixelRounding = 2e-7;

// Optical depth in front of a point, as integrated and as an interval, read off the density's steps in rising
// order.
class DepthProfile {
public:
    explicit DepthProfile(const std::vector<RaySegment>& segments) : segments_(segments) {}

    struct At {
        double depth = 0, low = 0, high = 0;
    };
    // REQUIRES: t does not fall from call to call.
    At at(double t) {
        while (segment_ < segments_.size() && segments_[segment_].span.end <= t) {
            before_.depth += segments_[segment_].integral;
            before_.low += segments_[segment_].low;
            before_.high += segments_[segment_].high;
            ++segment_;
            cell_ = 0;
        }
        if (segment_ == segments_.size() || segments_[segment_].span.begin >= t) return before_;
        const RaySegment& segment = segments_[segment_];
        while (cell_ < segment.cells.size() && segment.cells[cell_].end <= t) ++cell_;
        double inside = cell_ ? segment.cells[cell_ - 1].integral : 0;
        if (cell_ < segment.cells.size()) {
            const double begin = cell_ ? segment.cells[cell_ - 1].end : segment.span.begin;
            const CellStep& step = segment.cells[cell_];
            inside += (step.integral - inside) * (t - begin) / (step.end - begin);
        }
        At result;
        result.depth = before_.depth + inside;
        result.low = before_.low + std::max(0.0, inside - segment.half_width);
        result.high = before_.high + inside + segment.half_width;
        return result;
    }
    // The next place after t where the density's slope changes.
    double nextBreak(double t) const {
        if (segment_ == segments_.size()) return std::numeric_limits<double>::infinity();
        const RaySegment& segment = segments_[segment_];
        if (segment.span.begin > t) return segment.span.begin;
        for (std::size_t c = cell_; c < segment.cells.size(); ++c)
            if (segment.cells[c].end > t) return segment.cells[c].end;
        return segment.span.end;
    }

private:
    const std::vector<RaySegment>& segments_;
    std::size_t segment_ = 0, cell_ = 0;
    At before_;
};

// Mean of exp(-x s) over s in [0, 1].
double meanTransmittance(double x) { return x < 1e-5 ? 1 - 0.5 * x : -std::expm1(-x) / x; }

double largest(const glm::dvec3& v) { return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)}); }

// World distance where the ray has `target` of optical depth.
double distanceTo(const std::vector<RaySegment>& segments, double target) {
    double before = 0;
    for (const RaySegment& segment : segments) {
        if (before + segment.integral < target) {
            before += segment.integral;
            continue;
        }
        double begin = segment.span.begin, inside = 0;
        for (const CellStep& step : segment.cells) {
            if (before + step.integral >= target && step.integral > inside)
                return begin +
                       (step.end - begin) *
                           std::clamp((target - before - inside) / (step.integral - inside), 0.0, 1.0);
            begin = step.end;
            inside = step.integral;
        }
        return segment.span.end;
    }
    return segments.empty() ? 0 : segments.back().span.end;
}

struct Scattered {
    double weight = 0;           // integral of T * extinction * shadow
    double shadow_variance = 0;  // of `weight`, from the shadows' own errors
    std::vector<double> after;   // by segment: `weight` collected up to its end
    std::vector<double> last_shadow;
};

Scattered scatter(const std::vector<RaySegment>& density) {
    Scattered out;
    double before = 0, shadow_sd = 0, quadrature = 0;
    float last = -1;
    for (const RaySegment& segment : density) {
        double inside = 0;
        for (const CellStep& step : segment.cells) {
            const double weight = std::exp(-before - inside) * -std::expm1(-(step.integral - inside));
            out.weight += weight * double(step.shadow);
            // Neighbouring shadows go through the same smoke: their errors add up as they are, not in
            // quadrature.
            shadow_sd += weight * double(step.shadow_sd);
            if (last >= 0 && weight > 0) quadrature += std::pow(weight * double(step.shadow - last) / 4, 2);
            if (weight > 0) last = step.shadow;
            inside = step.integral;
        }
        before += segment.integral;
        out.after.push_back(out.weight);
        out.last_shadow.push_back(last < 0 ? 1 : double(last));
    }
    out.shadow_variance = shadow_sd * shadow_sd + quadrature;
    return out;
}

struct Emitted {
    double radiance = 0, low = 0, high = 0;
    double variance = 0;
    std::vector<double> after;          // by density segment: radiance collected up to its end
    std::vector<double> transmittance;  // by emission segment
};

Emitted emit(const std::vector<RaySegment>& density, const std::vector<RaySegment>& emission) {
    Emitted out;
    DepthProfile profile(density);
    double spread = 0;
    std::size_t d = 0;
    auto closeDensitySegments = [&](double t) {
        for (; d < density.size() && density[d].span.end <= t; ++d) out.after.push_back(out.radiance);
    };
    for (const RaySegment& segment : emission) {
        closeDensitySegments(segment.span.begin);
        const DepthProfile::At entry = profile.at(segment.span.begin);
        double begin = segment.span.begin, inside = 0;
        for (const CellStep& step : segment.cells) {
            const double amount = step.integral - inside;
            const DepthProfile::At from = profile.at(begin);
            double t = begin, depth = from.depth;
            // Emission is spread evenly over the step; where the density's slope changes, the step is cut.
            while (amount > 0 && t < step.end) {
                const double next = std::min(profile.nextBreak(t), step.end);
                const DepthProfile::At to = profile.at(next);
                out.radiance += amount * (next - t) / (step.end - begin) * std::exp(-depth) *
                                meanTransmittance(to.depth - depth);
                depth = to.depth;
                t = next;
                closeDensitySegments(t);
            }
            const DepthProfile::At to = profile.at(step.end);
            out.high += amount * std::exp(-from.low);
            out.low += amount * std::exp(-to.high);
            begin = step.end;
            inside = step.integral;
        }
        out.transmittance.push_back(std::exp(-entry.depth));
        out.variance += segment.variance * std::exp(-2 * entry.depth);
        spread += segment.half_width * std::exp(-entry.low);
    }
    for (; d < density.size(); ++d) out.after.push_back(out.radiance);
    out.high += spread;
    out.low = std::max(0.0, out.low - spread);
    return out;
}

}  // namespace

double henyeyGreenstein(double g, double cosine) {
    const double d = 1 + g * g - 2 * g * cosine;
    return (1 - g * g) / (4 * std::numbers::pi * d * std::sqrt(d));
}

Pixel RayComposite::pixel() const {
    Pixel p;
    for (int c = 0; c < 3; ++c)
        p.radiance[std::size_t(c)] = float(std::min(radiance[c], double(std::numeric_limits<float>::max())));
    p.alpha = float(alpha);
    p.depth = float(depth);
    p.bound_alpha = float(bound_alpha);
    p.bound_radiance = float(std::min(bound_radiance, double(std::numeric_limits<float>::max())));
    p.estimate_alpha = float(estimate_alpha);
    p.estimate_radiance = float(std::min(estimate_radiance, double(std::numeric_limits<float>::max())));
    return p;
}

AlphaComposite compositeAlpha(double depth, double low, double high, double variance) {
    AlphaComposite out;
    out.transmittance = std::exp(-depth);
    out.alpha = depth < 0.5 ? -std::expm1(-depth) : 1 - out.transmittance;
    // The true transmittance lies in [exp(-high), exp(-low)]. Where the interval is narrow, a bound of the
    // exponential does.
    const double above = depth - low, below = high - depth;
    constexpr double kNarrow = 1e-3;
    const double rise =
        above < kNarrow ? out.transmittance * above * (1 + above) : std::exp(-low) - out.transmittance;
    const double fall = below < kNarrow ? out.transmittance * below : out.transmittance - std::exp(-high);
    out.bound = std::min(1.0, std::max(rise, fall) + kPixelRounding);
    // A normal error of the optical depth makes a log-normal one of the transmittance: its standard
    // deviation.
    const double normal = std::min(variance, 50.0);
    if (normal > 0)
        out.estimate =
            std::min(out.transmittance * std::exp(0.5 * normal) * std::sqrt(std::expm1(normal)), out.bound);
    return out;
}

RayComposite compositeRay(const RenderPlan& plan, const glm::dvec3& view,
                          const std::vector<RaySegment>& density, const std::vector<RaySegment>* emission,
                          bool with_light) {
    RayComposite out;
    double variance = 0;
    for (const RaySegment& segment : density) {
        out.optical_depth += segment.integral;
        out.optical_low += segment.low;
        out.optical_high += segment.high;
        variance += segment.variance;
    }
    if (!density.empty()) {
        const AlphaComposite alpha =
            compositeAlpha(out.optical_depth, out.optical_low, out.optical_high, variance);
        out.alpha = alpha.alpha;
        out.transmittance = alpha.transmittance;
        out.bound_alpha = alpha.bound;
        out.estimate_alpha = alpha.estimate;
    }
    if (out.optical_depth > 0) out.depth = distanceTo(density, -std::log1p(-0.5 * out.alpha));
    out.density_alpha.assign(density.size(), out.transmittance);
    out.density_radiance.assign(density.size(), 0);
    if (!with_light && !emission) return out;

    Scattered scattered;
    Emitted emitted;
    glm::dvec3 per_scatter(0), per_emission(0);
    if (with_light) {
        scattered = scatter(density);
        per_scatter = plan.scattered() *
                      henyeyGreenstein(plan.scene.anisotropy, glm::dot(plan.scene.light->to_light, view));
    }
    if (emission) {
        emitted = emit(density, *emission);
        per_emission = plan.scene.emission->color;
        for (double t : emitted.transmittance) out.emission_radiance.push_back(largest(per_emission) * t);
    }
    out.radiance = per_scatter * scattered.weight + per_emission * emitted.radiance;

    // Strict: shadows are known to lie in [0, 1] only, so scattered light lies between none and all of the
    // true alpha.
    const double alpha_high = -std::expm1(-out.optical_high);
    const double scatter_bound = with_light ? std::max(scattered.weight, alpha_high - scattered.weight) : 0;
    const double emission_bound = std::max(emitted.high - emitted.radiance, emitted.radiance - emitted.low);
    for (int c = 0; c < 3; ++c)
        out.bound_radiance =
            std::max(out.bound_radiance, per_scatter[c] * scatter_bound + per_emission[c] * emission_bound +
                                             kPixelRounding * (out.radiance[c] + 1));

    // Expected: first order in each segment's error; more extinction here scatters more here and hides what
    // is behind.
    glm::dvec3 variances = per_scatter * per_scatter * scattered.shadow_variance +
                           per_emission * per_emission * emitted.variance;
    double before = 0;
    for (std::size_t i = 0; i < density.size(); ++i) {
        before += density[i].integral;
        glm::dvec3 effect(0);
        if (with_light)
            effect += per_scatter * (std::exp(-before) * scattered.last_shadow[i] -
                                     (scattered.weight - scattered.after[i]));
        // What glows inside the segment is hidden by it too.
        if (emission) effect -= per_emission * (emitted.radiance - (i > 0 ? emitted.after[i - 1] : 0));
        variances += effect * effect * density[i].variance;
        out.density_radiance[i] = largest(effect);
    }
    out.estimate_radiance = std::min(std::sqrt(largest(variances)), out.bound_radiance);
    return out;
}

}  // namespace brickyard

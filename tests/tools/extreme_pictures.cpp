#include "extreme_pictures.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "reference_field.h"
#include "stored_fields.h"

namespace brickyard {

namespace {

struct NamedQuality {
    const char* name;
    QualitySettings settings;
};

// The reference comes first: its alphas are held against the truth, those of the others against their bounds.
const NamedQuality kQualities[] = {
    {"reference", {.reference = true}},
    {"--max-error 0.05", {.max_error = 0.05}},
    {"--max-error 0.05 --strict", {.strict = true, .max_error = 0.05}},
    {"draft", {.max_error = 0.15, .pixels_per_voxel = 4}},
    {"preview", {.max_error = 0.05, .pixels_per_voxel = 2}},
    {"final", {.max_error = 0.01, .pixels_per_voxel = 1}},
};

const char* const kLayers[] = {
    "R", "G", "B", "A", "Z", "errorBound.A", "errorBound.RGB", "errorEstimate.A", "errorEstimate.RGB"};

// The first value of a picture that no layer may have; empty where there is none.
std::string impossibleValue(const Picture& picture) {
    for (std::size_t i = 0; i < picture.pixels.size(); ++i) {
        float values[std::size(kLayers)];
        static_assert(sizeof values == sizeof(Pixel));
        std::memcpy(values, &picture.pixels[i], sizeof values);
        for (std::size_t k = 0; k < std::size(kLayers); ++k)
            if (!std::isfinite(values[k]) || values[k] < 0 || (k == 3 && values[k] > 1))
                return fmt::format("{} is {} at ({}, {})", kLayers[k], values[k], i % picture.width,
                                   i / picture.width);
    }
    return {};
}

class ExtremeCheck {
public:
    ExtremeCheck(const FieldSource& source, const ExtremeView& view) : source_(source), view_(view) {}

    ExtremeOutcome run() {
        if (!traceReference()) return out_;
        const double peak = double(*std::max_element(depths_.begin(), depths_.end()));
        out_.peak_depth = peak;
        if (view_.density_scale) drawAll(*view_.density_scale);
        if (view_.peak_depth && peak > 0 && std::isfinite(*view_.peak_depth / peak)) {
            drawAll(*view_.peak_depth / peak);
            drawLit(*view_.peak_depth / peak);
            drawWhole(*view_.peak_depth / peak);
        }
        return out_;
    }

private:
    RenderRequest request(const QualitySettings& quality, double scale) const {
        RenderRequest request;
        request.frame = view_.frame;
        request.width = view_.width;
        request.height = view_.height;
        request.camera = view_.camera;
        request.quality = quality;
        request.density_scale = scale;
        request.scene.mutable_medium()->set_density(source_.info().name);
        // A picture of a few hundred pixels takes milliseconds: what takes this long would never end.
        request.deadline = std::chrono::seconds(60);
        return request;
    }
    std::optional<RenderOutcome> draw(const RenderRequest& request, const std::string& what) {
        auto outcome = drawStored(view_.dataset, request);
        if (!outcome) {
            out_.refusal = outcome.error().message;
            return std::nullopt;
        }
        if (!outcome->final) out_.faults.push_back(what + ": is not final");
        // Whole scenes have no guarantee, and say so.
        if (outcome->method != "beams")
            for (Pixel& pixel : outcome->picture.pixels)
                if (std::isinf(pixel.bound_radiance)) pixel.bound_radiance = 0;
        if (const std::string value = impossibleValue(outcome->picture); !value.empty())
            out_.faults.push_back(fmt::format("{}: {}", what, value));
        return std::move(*outcome);
    }
    // The optical depth of every pixel for a scale of 1. False where the renderer refuses.
    bool traceReference() {
        const auto first = draw(request({.max_error = 1}, 1), "first");
        if (!first) return false;
        const auto camera = PinholeCamera::create(first->camera, view_.width, view_.height);
        const ReferenceField field(source_);
        for (std::uint32_t y = 0; y < view_.height; ++y)
            for (std::uint32_t x = 0; x < view_.width; ++x)
                depths_.push_back(field.integral(camera->ray(x, y)));
        return true;
    }
    void drawAll(double scale) {
        for (const NamedQuality& quality : kQualities) {
            const std::string what = fmt::format("{} at density scale {:.3g}", quality.name, scale);
            const auto outcome = draw(request(quality.settings, scale), what);
            if (outcome) hold(outcome->picture, quality, scale, what);
        }
    }
    void hold(const Picture& picture, const NamedQuality& quality, double scale, const std::string& what) {
        std::size_t broken = 0, first = 0;
        for (std::size_t i = 0; i < depths_.size(); ++i) {
            const auto truth = double(-std::expm1(-depths_[i] * (long double)scale));
            const Pixel& pixel = picture.pixels[i];
            const double error = std::abs(double(pixel.alpha) - truth);
            // An empty pixel's bound is 0; what a float cannot hold is not held against it.
            if (!(error <= double(pixel.bound_alpha) + 1e-12) && broken++ == 0) first = i;
            if (!quality.settings.reference) continue;
            out_.worst_alpha = std::max(out_.worst_alpha, error);
            if (truth > 1e-37) out_.worst_relative = std::max(out_.worst_relative, error / truth);
        }
        if (broken == 0) return;
        const Pixel& pixel = picture.pixels[first];
        out_.faults.push_back(fmt::format(
            "{}: {} pixels are beyond their bound; first ({}, {}): alpha {:.9g}, truth {:.9g}, bound {:.3g}",
            what, broken, first % view_.width, first / view_.width, pixel.alpha,
            double(-std::expm1(-depths_[first] * (long double)scale)), pixel.bound_alpha));
    }
    // Light and glow: no value may be impossible, whatever the numbers.
    void drawLit(double scale) {
        for (const NamedQuality& quality : {kQualities[0], kQualities[1]}) {
            RenderRequest lit = request(quality.settings, scale);
            lit.width = lit.height = 4;
            Light* light = lit.scene.add_lights();
            for (const double d : {0.3, -1.0, 0.2}) light->add_direction(d);
            Emission* emission = lit.scene.mutable_medium()->mutable_emission();
            emission->set_channel(source_.info().name);
            emission->set_scale(scale);
            draw(lit, fmt::format("{}, lit and glowing, at density scale {:.3g}", quality.name, scale));
        }
    }

    // As whole scenes are drawn: it ends, what it shows is possible, and the same within what that way
    // promises.
    void drawWhole(double scale) {
        constexpr double kMost = 1e-3;
        RenderRequest whole = request({.reference = true}, scale);
        whole.shadows = ShadowMethod::kNone;
        const std::string what = fmt::format("reference, as a whole scene, at density scale {:.3g}", scale);
        const auto outcome = draw(whole, what);
        if (!outcome) return;
        double worst = 0;
        for (std::size_t i = 0; i < depths_.size(); ++i)
            worst = std::max(worst, std::abs(double(outcome->picture.pixels[i].alpha) +
                                             double(std::expm1(-depths_[i] * (long double)scale))));
        if (worst > kMost) out_.faults.push_back(fmt::format("{}: alpha is off by {:.3g}", what, worst));
    }

    const FieldSource& source_;
    const ExtremeView& view_;
    ExtremeOutcome out_;
    std::vector<long double> depths_;
};

}  // namespace

ExtremeOutcome drawExtreme(const FieldSource& source, const ExtremeView& view) {
    return ExtremeCheck(source, view).run();
}

}  // namespace brickyard

#include "tools/scene_emission.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <utility>

#include "client/shading/black_body.h"
#include "client/shading/color_ramp.h"

namespace brickyard {

namespace {

constexpr double kHotKelvin = 2200, kCoolKelvin = 1400, kKelvinAtOne = 2000;

double most(const glm::dvec3& color) { return std::max({color.x, color.y, color.z}); }

// Solvers store kelvin, or a number of their own: then what burns spans from dull red to yellow.
void chooseKelvin(const FireFields& fields, BlackBodyEmission& body) {
    std::vector<std::pair<double, double>> burning;  // heat, and how much of it
    double whole = 0;
    for (std::size_t i = 0; i < fields.heat.size(); ++i) {
        const double weight = fields.has_flame ? fields.flame[i] : 1;
        if (!(fields.heat[i] > 0 && weight > 0)) continue;
        burning.emplace_back(fields.heat[i], weight);
        whole += weight;
    }
    if (burning.empty()) return;
    std::sort(burning.begin(), burning.end());
    double sum = 0, cool = -1, hot = burning.back().first;
    for (const auto& [value, weight] : burning) {
        sum += weight;
        if (cool < 0 && sum >= 0.05 * whole) cool = value;
        if (sum >= 0.98 * whole) {
            hot = value;
            break;
        }
    }
    if (hot >= 1000 && hot <= 10000) return;
    // Without a flame to say what burns, heat alone does: nothing glows at 0. So where all is equally hot.
    const bool spans = fields.has_flame && hot - cool >= 0.1 * hot;
    const double scale = rounded(spans ? (kHotKelvin - kCoolKelvin) / (hot - cool) : kHotKelvin / hot);
    if (!(scale > 0) || !std::isfinite(scale)) return;
    body.set_kelvin_scale(scale);
    if (spans) body.set_kelvin_offset(std::round(kHotKelvin - scale * hot));
}

}  // namespace

double rounded(double value) { return std::strtod(fmt::format("{:.3g}", value).c_str(), nullptr); }

FireProposal proposeEmission(const FireFields& fields, std::int64_t samples) {
    FireProposal out;
    out.glow.assign(std::size_t(samples), 0);
    if (fields.has_heat) {
        BlackBodyEmission& body = *out.emission.mutable_black_body();
        body.set_kelvin_at_one(kKelvinAtOne);
        chooseKelvin(fields, body);
        const double scale = body.kelvin_scale() == 0 ? 1 : body.kelvin_scale();
        const BlackBody black(kKelvinAtOne);
        for (std::size_t i = 0; i < out.glow.size(); ++i)
            out.glow[i] = (fields.has_flame ? fields.flame[i] : 1) *
                          most(black.radiance(body.kelvin_offset() + scale * fields.heat[i]));
        return out;
    }
    Ramp& ramp = *out.emission.mutable_ramp();
    ramp.set_preset("fire");
    std::vector<double> burning = fields.flame;
    std::erase_if(burning, [](double value) { return !(value > 0); });
    if (!burning.empty()) {
        const auto hot = burning.begin() + std::ptrdiff_t(0.995 * double(burning.size() - 1));
        std::nth_element(burning.begin(), hot, burning.end());
        ramp.set_high(rounded(*hot));
    }
    const Result<ColorRamp> colors = ColorRamp::create(ramp, "medium.emission.ramp");
    for (std::size_t i = 0; colors && i < out.glow.size(); ++i)
        out.glow[i] = most(colors->at(fields.flame[i]));
    return out;
}

}  // namespace brickyard

#include "tools/bench/mode_error.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <vector>

namespace brickyard {
namespace {

// Pictures are floats: closer than this no error can be told from rounding.
constexpr double kRounding = 2e-6;

double difference(const Pixel& a, const Pixel& b, bool of_alpha) {
    if (of_alpha) return std::abs(double(a.alpha) - double(b.alpha));
    double most = 0;
    for (std::size_t c = 0; c < 3; ++c) {
        const double one = std::abs(double(a.radiance[c]) - double(b.radiance[c]));
        if (!(one <= most)) most = one;  // what is not a number stays
    }
    return most;
}

}  // namespace

ModeError modeError(const Picture& picture, const Picture& truth, bool of_alpha) {
    assert(picture.pixels.size() == truth.pixels.size());
    ModeError out;
    std::vector<double> errors;
    double squares = 0, estimates = 0;
    std::uint64_t within = 0;
    for (std::size_t i = 0; i < truth.pixels.size(); ++i) {
        const Pixel &a = picture.pixels[i], &b = truth.pixels[i];
        if (!(a.alpha > 0) && !(b.alpha > 0)) continue;
        const double error = difference(a, b, of_alpha);
        const double estimate = double(of_alpha ? a.estimate_alpha : a.estimate_radiance);
        const double truths = double(of_alpha ? b.estimate_alpha : b.estimate_radiance);
        errors.push_back(error);
        squares += error * error;
        estimates += estimate;
        within += error <= 3 * std::hypot(estimate, truths) + kRounding;
    }
    out.pixels = errors.size();
    if (errors.empty()) return out;
    const auto count = double(errors.size());
    out.rms = std::sqrt(squares / count);
    out.mean_estimate = estimates / count;
    out.within_3 = double(within) / count;
    std::sort(errors.begin(), errors.end());
    out.p99 = errors[std::size_t(0.99 * (count - 1) + 0.5)];
    out.worst = errors.back();
    return out;
}

nlohmann::json toJson(const ModeError& error) {
    return {{"rms", error.rms},           {"p99", error.p99},
            {"worst", error.worst},       {"mean_estimate", error.mean_estimate},
            {"within_3", error.within_3}, {"pixels", error.pixels}};
}

}  // namespace brickyard

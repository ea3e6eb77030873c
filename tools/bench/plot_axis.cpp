#include "tools/bench/plot_axis.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace brickyard {

PlotAxis::PlotAxis(const std::vector<double>& values, bool logarithmic) : logarithmic_(logarithmic) {
    bool any = false;
    for (const double value : values) {
        if (!shows(value)) continue;
        const double v = logarithmic_ ? std::log10(value) : value;
        low_ = any ? std::min(low_, v) : v;
        high_ = any ? std::max(high_, v) : v;
        any = true;
    }
    // An axis of amounts starts at nothing, or lengths on it could not be compared.
    if (any && !logarithmic_ && low_ > 0) low_ = 0;
    if (!(high_ > low_)) high_ = low_ + (logarithmic_ ? 1 : std::max(std::abs(low_), 1.0));
    const double air = 0.05 * (high_ - low_);
    high_ += air;
    if (logarithmic_ || low_ < 0) low_ -= air;
    logarithmic_ ? makeLogarithmicTicks() : makeLinearTicks();
}

bool PlotAxis::shows(double value) const { return std::isfinite(value) && (!logarithmic_ || value > 0); }

double PlotAxis::place(double value) const {
    return ((logarithmic_ ? std::log10(value) : value) - low_) / (high_ - low_);
}

void PlotAxis::makeLinearTicks() {
    // The largest of 1, 2, 5 times a power of ten that gives at least four steps.
    const double raw = (high_ - low_) / 4, power = std::pow(10, std::floor(std::log10(raw)));
    const double step = raw >= 5 * power ? 5 * power : raw >= 2 * power ? 2 * power : power;
    for (double i = std::ceil(low_ / step); i * step <= high_; ++i)
        ticks_.push_back({i * step, fmt::format("{:.6g}", i * step)});
}

void PlotAxis::makeLogarithmicTicks() {
    const double decades = high_ - low_;
    for (double decade = std::floor(low_); decade <= high_; ++decade)
        for (int digit = 1; digit < 10; ++digit) {
            const double value = digit * std::pow(10, decade), at = std::log10(value);
            if (at < low_ || at > high_) continue;
            // Where few decades are in sight, powers of ten alone would leave the axis without numbers.
            const bool numbered =
                digit == 1 || (decades < 2.5 && (digit == 2 || digit == 5)) || decades < 0.8;
            ticks_.push_back({value, numbered ? fmt::format("{:.6g}", value) : std::string()});
        }
}

}  // namespace brickyard

#include "client/shading/color_ramp.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <glm/common.hpp>
#include <utility>

namespace brickyard {

namespace {

// IEC 61966-2-1, from 8 bits a channel.
glm::dvec3 linearOf(std::uint32_t srgb) {
    glm::dvec3 color;
    for (int c = 0; c < 3; ++c) {
        const double v = (srgb >> (16 - 8 * c) & 0xff) / 255.0;
        color[c] = v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
    }
    return color;
}

// Matplotlib's maps (CC0), every tenth of them, as sRGB. Straight lines between these are within 0.02 of
// them.
constexpr std::array<std::uint32_t, 11> kViridis{0x440154, 0x482576, 0x414487, 0x35608d, 0x2a788e, 0x21908c,
                                                 0x22a884, 0x43bf71, 0x7ad151, 0xbbdf27, 0xfde725};
constexpr std::array<std::uint32_t, 11> kMagma{0x000004, 0x150e37, 0x3b0f70, 0x641a80, 0x8c2981, 0xb63679,
                                               0xde4968, 0xf76f5c, 0xfe9f6d, 0xfece91, 0xfcfdbf};

std::vector<ColorRamp::Point> evenly(const std::array<std::uint32_t, 11>& srgb) {
    std::vector<ColorRamp::Point> points;
    for (std::size_t i = 0; i < srgb.size(); ++i)
        points.push_back({double(i) / double(srgb.size() - 1), linearOf(srgb[i])});
    return points;
}

}  // namespace

std::vector<ColorRamp::Point> namedColors(const std::string& name) {
    if (name == "viridis") return evenly(kViridis);
    if (name == "magma") return evenly(kMagma);
    // A flame's core is far brighter than its edge: linear values above 1, so that it also lights what is
    // near.
    if (name == "fire")
        return {{0.0, {0, 0, 0}},         {0.2, {0.06, 0.004, 0.0005}}, {0.4, {0.6, 0.06, 0.004}},
                {0.6, {1.8, 0.42, 0.03}}, {0.8, {3.2, 1.5, 0.25}},      {1.0, {4.5, 3.6, 2.2}}};
    if (name == "grey") return {{0, glm::dvec3(0)}, {1, glm::dvec3(1)}};
    return {};
}

ColorRamp::ColorRamp(std::vector<Point> points) : points_(std::move(points)) { assert(!points_.empty()); }

Result<ColorRamp> ColorRamp::create(const Ramp& ramp, const std::string& where) {
    const auto invalid = [&](const std::string& what) {
        return fail(ErrorCode::kInvalid, fmt::format("scene: {}{}", where, what));
    };
    if (ramp.points().empty() == ramp.preset().empty())
        return invalid(ramp.points().empty() ? ": wants points or a preset (fire, viridis, magma, grey)"
                                             : ": has points and a preset; leave one out");
    if (!std::isfinite(ramp.low()) || !std::isfinite(ramp.high()))
        return invalid(": low or high is not finite");

    if (!ramp.preset().empty()) {
        const bool unit = ramp.low() == 0 && ramp.high() == 0;
        const double low = ramp.low(), high = unit ? 1 : ramp.high();
        if (!(low < high))
            return invalid(fmt::format(".low: is {}; it wants a number below high, {}", low, high));
        std::vector<Point> points = namedColors(ramp.preset());
        if (points.empty())
            return invalid(
                fmt::format(".preset: is '{}'; there are fire, viridis, magma, grey", ramp.preset()));
        for (Point& point : points) point.value = low + (high - low) * point.value;
        return ColorRamp(std::move(points));
    }
    if (ramp.low() != 0 || ramp.high() != 0)
        return invalid(": low and high are of a preset; points have values");
    std::vector<Point> points;
    for (int i = 0; i < ramp.points_size(); ++i) {
        const RampPoint& from = ramp.points(i);
        if (!std::isfinite(from.value())) return invalid(fmt::format(".points[{}].value: is not finite", i));
        if (i > 0 && !(from.value() > ramp.points(i - 1).value()))
            return invalid(fmt::format(".points[{}].value: is {}, not above the one before, {}", i,
                                       from.value(), ramp.points(i - 1).value()));
        if (from.color_size() != 3) return invalid(fmt::format(".points[{}].color: wants 3 numbers", i));
        Point point{from.value(), {}};
        for (int c = 0; c < 3; ++c) {
            point.color[c] = double(from.color(c));
            if (!(point.color[c] >= 0) || !std::isfinite(point.color[c]))
                return invalid(fmt::format(".points[{}].color: wants finite numbers, none negative", i));
        }
        points.push_back(point);
    }
    return ColorRamp(std::move(points));
}

glm::dvec3 ColorRamp::at(double value) const {
    // NaN compares as below the first.
    if (!(value > points_.front().value)) return points_.front().color;
    if (value >= points_.back().value) return points_.back().color;
    const auto above = std::upper_bound(points_.begin(), points_.end(), value,
                                        [](double v, const Point& point) { return v < point.value; });
    const Point &a = *(above - 1), &b = *above;
    return glm::mix(a.color, b.color, (value - a.value) / (b.value - a.value));
}

double ColorRamp::most(double low, double high) const {
    const auto largest = [](const glm::dvec3& c) { return std::max({c.x, c.y, c.z}); };
    double most = std::max(largest(at(low)), largest(at(high)));
    for (const Point& point : points_)
        if (point.value > low && point.value < high) most = std::max(most, largest(point.color));
    return most;
}

}  // namespace brickyard

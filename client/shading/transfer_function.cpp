#include "client/shading/transfer_function.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <utility>

#include "client/shading/color_ramp.h"

namespace brickyard {

namespace {

using Point = TransferFunction::Point;
using Sample = TransferFunction::Sample;

constexpr const char* kPresets = "bone, skin, viridis, magma, grey";

// Over [0, 1]: colours of ramp `name`, opacity rising from nothing as value^2, as straight lines.
std::vector<Point> rising(const std::string& name) {
    std::vector<Point> points;
    for (const ColorRamp::Point& from : namedColors(name))
        points.push_back({from.value, from.color, from.value * from.value});
    if (points.size() == 2)
        points.insert(points.begin() + 1, {0.5, 0.5 * (points[0].color + points[1].color), 0.25});
    return points;
}

std::vector<Point> preset(const std::string& name) {
    // Soft tissue is a breath of red, bone is ivory.
    if (name == "bone")
        return {{0.00, {0.55, 0.25, 0.15}, 0},    {0.30, {0.55, 0.25, 0.15}, 0},
                {0.38, {0.62, 0.27, 0.17}, 0.02}, {0.50, {0.75, 0.50, 0.33}, 0.06},
                {0.60, {0.88, 0.80, 0.62}, 0.60}, {0.75, {0.93, 0.88, 0.74}, 0.90},
                {1.00, {1.00, 0.98, 0.92}, 1.00}};
    // A shell that one sees through, thin fat below it, and what is dense stands solid.
    if (name == "skin")
        return {{0.00, {0.80, 0.45, 0.32}, 0},    {0.12, {0.80, 0.45, 0.32}, 0},
                {0.18, {0.85, 0.52, 0.38}, 0.18}, {0.26, {0.85, 0.52, 0.38}, 0.10},
                {0.34, {0.80, 0.38, 0.28}, 0.02}, {0.50, {0.72, 0.30, 0.24}, 0.06},
                {0.65, {0.90, 0.78, 0.62}, 0.70}, {1.00, {1.00, 0.95, 0.88}, 1.00}};
    if (name == "viridis" || name == "magma" || name == "grey") return rising(name);
    return {};
}

Result<std::vector<Point>> pointsOf(const Transfer& entry, const std::string& where) {
    const auto invalid = [&](int i, const char* part, const std::string& what) {
        return fail(ErrorCode::kInvalid, fmt::format("scene: {}.points[{}].{}: {}", where, i, part, what));
    };
    std::vector<Point> points;
    for (int i = 0; i < entry.points_size(); ++i) {
        const TransferPoint& from = entry.points(i);
        if (!std::isfinite(from.value())) return invalid(i, "value", "is not finite");
        if (i > 0 && !(from.value() > points.back().value))
            return invalid(
                i, "value",
                fmt::format("is {}, not above the one before, {}", from.value(), points.back().value));
        if (from.color_size() != 3) return invalid(i, "color", "wants 3 numbers");
        if (!(from.opacity() >= 0) || !std::isfinite(from.opacity()))
            return invalid(i, "opacity",
                           fmt::format("is {}; it wants a finite number, at least 0", from.opacity()));
        Point point{from.value(), {}, from.opacity()};
        for (int c = 0; c < 3; ++c) {
            point.color[c] = double(from.color(c));
            if (!(point.color[c] >= 0) || !std::isfinite(point.color[c]))
                return invalid(i, "color", "wants finite numbers, none negative");
        }
        points.push_back(point);
    }
    return points;
}

// Both linear from `a` to `b`, and not yet divided.
struct Linear {
    double opacity = 0;
    glm::dvec3 color{0};
};

Linear between(const Point& a, const Point& b, double value) {
    const double t = (value - a.value) / (b.value - a.value);
    return {(1 - t) * a.opacity + t * b.opacity, (1 - t) * a.color + t * b.color};
}

struct Integral {
    double opacity = 0;
    glm::dvec3 emission{0};  // opacity * color
};

// Over [low, high] of one segment. Simpson's rule is exact for the product, a quadratic, and cancels nothing.
Integral within(const Point& a, const Point& b, double low, double high) {
    const Linear first = between(a, b, low), middle = between(a, b, 0.5 * (low + high)),
                 last = between(a, b, high);
    const double width = high - low;
    return {
        0.5 * width * (first.opacity + last.opacity),
        width / 6 *
            (first.opacity * first.color + 4 * middle.opacity * middle.color + last.opacity * last.color)};
}

}  // namespace

TransferFunction::TransferFunction(std::vector<Point> points) : points_(std::move(points)) {
    assert(!points_.empty());
    Integral sum;
    for (std::size_t i = 0; i < points_.size(); ++i) {
        if (i > 0) {
            const Integral part = within(points_[i - 1], points_[i], points_[i - 1].value, points_[i].value);
            sum.opacity += part.opacity;
            sum.emission += part.emission;
        }
        opacity_.push_back(sum.opacity);
        emission_.push_back(sum.emission);
    }
}

Result<TransferFunction> TransferFunction::create(const Transfer& entry, double low, double high,
                                                  const std::string& where) {
    const auto invalid = [&](const std::string& what) {
        return fail(ErrorCode::kInvalid, fmt::format("scene: {}{}", where, what));
    };
    if (entry.points().empty() == entry.preset().empty())
        return invalid(entry.points().empty() ? fmt::format(": wants points or a preset ({})", kPresets)
                                              : ": has points and a preset; leave one out");
    if (!std::isfinite(entry.level())) return invalid(".level: is not finite");
    if (!(entry.width() >= 0) || !std::isfinite(entry.width()))
        return invalid(fmt::format(".width: is {}; it wants a number above 0", entry.width()));
    if (entry.width() == 0 && entry.level() != 0) return invalid(".level: is of no use without a width");

    Result<std::vector<Point>> points = pointsOf(entry, where);
    if (!points) return tl::unexpected(points.error());
    const bool named = !entry.preset().empty();
    if (named) *points = preset(entry.preset());
    if (points->empty())
        return invalid(fmt::format(".preset: is '{}'; there are {}", entry.preset(), kPresets));

    // [0, 1] becomes the window.
    double begin = entry.level() - 0.5 * entry.width(), width = entry.width();
    if (width == 0 && named) {
        begin = high > low ? low : low - 0.5;
        width = high > low ? high - low : 1;
    }
    if (width > 0)
        for (Point& point : *points) point.value = begin + width * point.value;
    // A preset goes on above its window as it ends there: what is denser than all else must not vanish.
    if (named) {
        Point last = points->back();
        last.value = std::max(last.value, high) + std::max(width, high - low);
        points->push_back(last);
    }
    for (std::size_t i = 0; i < points->size(); ++i)
        if (!std::isfinite((*points)[i].value) || (i > 0 && !((*points)[i].value > (*points)[i - 1].value)))
            return invalid(": its window is too narrow for its values, or too wide to be counted");
    return TransferFunction(std::move(*points));
}

Sample TransferFunction::at(double value) const {
    if (!(value >= points_.front().value) || value > points_.back().value) return {};
    if (points_.size() == 1)
        return {points_[0].opacity > 0 ? points_[0].color : glm::dvec3(0), points_[0].opacity};
    auto above = std::upper_bound(points_.begin(), points_.end(), value,
                                  [](double v, const Point& point) { return v < point.value; });
    if (above == points_.end()) --above;  // the last point itself
    const Linear here = between(*(above - 1), *above, value);
    return {here.opacity > 0 ? here.color : glm::dvec3(0), here.opacity};
}

Sample TransferFunction::mean(double a, double b) const {
    const double low = std::min(a, b), high = std::max(a, b);
    // Too near to tell apart; infinities and NaN end here, too.
    if (!(high - low > 1e-12 * std::max(std::abs(low), std::abs(high))) || !std::isfinite(high - low))
        return at(low + 0.5 * (high - low));
    const double begin = std::max(low, points_.front().value), end = std::min(high, points_.back().value);
    if (!(begin < end)) return {};

    // The first point above `begin`, and the last segment's upper one: [begin, end] is not empty, so both
    // exist.
    const auto byValue = [](double v, const Point& point) { return v < point.value; };
    const std::size_t first =
        std::size_t(std::upper_bound(points_.begin(), points_.end(), begin, byValue) - points_.begin());
    std::size_t last =
        std::size_t(std::upper_bound(points_.begin(), points_.end(), end, byValue) - points_.begin());
    last = std::min(last, points_.size() - 1);

    Integral sum;
    const auto add = [&](std::size_t upper, double from, double to) {
        const Integral part = within(points_[upper - 1], points_[upper], from, to);
        sum.opacity += part.opacity;
        sum.emission += part.emission;
    };
    if (first == last) {
        add(first, begin, end);
    } else {
        add(first, begin, points_[first].value);
        add(last, points_[last - 1].value, end);
        sum.opacity += opacity_[last - 1] - opacity_[first];
        sum.emission += emission_[last - 1] - emission_[first];
    }
    if (!(sum.opacity > 0)) return {};
    return {sum.emission / sum.opacity, sum.opacity / (high - low)};
}

double TransferFunction::most(double low, double high) const {
    double most = std::max(at(low).opacity, at(high).opacity);
    for (const Point& point : points_)
        if (point.value >= low && point.value <= high) most = std::max(most, point.opacity);
    return most;
}

}  // namespace brickyard

#include "tools/velocity_fit.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

namespace brickyard {

namespace {

// Enough for a mean; what is left out lies between them.
constexpr std::int64_t kMostPlaces = 20000;

struct Place {
    glm::dvec3 world, velocity;  // in the next frame, where the density has come to
    double density = 0;
};

std::vector<Place> movingPlaces(const MovingFrame& frame, const MovingFrame& next) {
    std::vector<Place> places;
    // Odd: rows have even and odd lengths, and no column is met again and again.
    const std::int64_t stride = std::max<std::int64_t>(1, next.density.count() / kMostPlaces) | 1;
    for (std::int64_t i = 0; i < next.density.count(); i += stride) {
        const glm::dvec3 world = next.density.world(i), v = next.velocity.vectorAt(world);
        if (glm::length(v) + glm::length(frame.velocity.vectorAt(world)) > 0)
            places.push_back({world, v, double(next.density.value(i))});
    }
    return places;
}

double squaredError(const MovingFrame& frame, const std::vector<Place>& places, double scale) {
    double sum = 0;
    for (const Place& place : places) {
        // Where it left follows from the velocity there: two steps of the fixed point are near enough.
        glm::dvec3 left = place.world - scale * place.velocity;
        for (int i = 0; i < 2 && scale > 0; ++i)
            left = place.world - 0.5 * scale * (frame.velocity.vectorAt(left) + place.velocity);
        const double error = frame.density.at(left) - place.density;
        sum += error * error;
    }
    return sum;
}

}  // namespace

VelocityFit fitVelocityScale(const MovingFrame& frame, const MovingFrame& next) {
    VelocityFit fit;
    const SampledField& density = frame.density;
    if (density.empty() || frame.velocity.empty() || next.density.empty() || next.velocity.empty())
        return fit;
    const std::vector<Place> places = movingPlaces(frame, next);
    if (places.empty()) return fit;
    std::vector<double> speeds;
    for (const Place& place : places) speeds.push_back(glm::length(place.velocity));
    const auto fast = speeds.begin() + std::ptrdiff_t(0.95 * double(speeds.size() - 1));
    std::nth_element(speeds.begin(), fast, speeds.end());
    if (!(*fast > 0)) return fit;
    double box = 0, sample = HUGE_VAL;
    for (int a = 0; a < 3; ++a) {
        box = std::max(box, density.spacing(a) * double(density.size(a)));
        sample = std::min(sample, density.spacing(a));
    }
    const double resting = squaredError(frame, places, 0), least = 0.1 * sample / *fast,
                 most = 0.2 * box / *fast;
    if (!(resting > 0) || !(least > 0) || !(most > least) || !std::isfinite(most)) return fit;

    // First a ladder, since a far motion may fit by chance at several; then between the best's neighbours.
    constexpr double kStep = 1.15;
    double best = 0, smallest = resting;
    for (double scale = least; scale < most; scale *= kStep) {
        const double error = squaredError(frame, places, scale);
        if (error < smallest) smallest = error, best = scale;
    }
    if (best == 0) return fit;
    double low = best / kStep, high = best * kStep;
    for (int i = 0; i < 12; ++i) {
        const double a = low + 0.382 * (high - low), b = low + 0.618 * (high - low);
        if (squaredError(frame, places, a) < squaredError(frame, places, b))
            high = b;
        else
            low = a;
    }
    fit.scale = 0.5 * (low + high);
    fit.explained = 1 - squaredError(frame, places, fit.scale) / resting;
    return fit;
}

}  // namespace brickyard

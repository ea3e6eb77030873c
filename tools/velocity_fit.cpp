#include "tools/velocity_fit.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

namespace brickyard {

namespace {

// Enough for a mean; what is left out lies between them.
constexpr std::int64_t kMostPlaces = 20000;

struct Place {
    glm::dvec3 world, velocity;
    double next = 0;
};

std::vector<Place> movingPlaces(const SampledField& velocity, const SampledField& next) {
    std::vector<Place> places;
    // An odd stride that shares no factor with the rows goes through all of the box.
    const std::int64_t stride = std::max<std::int64_t>(1, next.count() / kMostPlaces) | 1;
    for (std::int64_t i = 0; i < next.count(); i += stride) {
        const glm::dvec3 world = next.world(i), v = velocity.vectorAt(world);
        if (glm::length(v) > 0) places.push_back({world, v, double(next.value(i))});
    }
    return places;
}

double squaredError(const SampledField& density, const std::vector<Place>& places, double scale) {
    double sum = 0;
    for (const Place& place : places) {
        const double error = density.at(place.world - scale * place.velocity) - place.next;
        sum += error * error;
    }
    return sum;
}

}  // namespace

VelocityFit fitVelocityScale(const SampledField& density, const SampledField& velocity,
                             const SampledField& next) {
    VelocityFit fit;
    if (density.empty() || velocity.empty() || next.empty()) return fit;
    const std::vector<Place> places = movingPlaces(velocity, next);
    if (places.empty()) return fit;
    std::vector<double> speeds;
    for (const Place& place : places) speeds.push_back(glm::length(place.velocity));
    const auto fast = speeds.begin() + std::ptrdiff_t(0.95 * double(speeds.size() - 1));
    std::nth_element(speeds.begin(), fast, speeds.end());
    double box = 0, sample = HUGE_VAL;
    for (int a = 0; a < 3; ++a) {
        box = std::max(box, density.spacing(a) * double(density.size(a)));
        sample = std::min(sample, density.spacing(a));
    }
    const double resting = squaredError(density, places, 0), least = 0.1 * sample / *fast,
                 most = 0.2 * box / *fast;
    if (!(resting > 0) || !(least > 0) || !(most > least) || !std::isfinite(most)) return fit;

    // First a ladder, since a far motion may fit by chance at several; then between the best's neighbours.
    constexpr double kStep = 1.15;
    double best = 0, smallest = resting;
    for (double scale = least; scale < most; scale *= kStep) {
        const double error = squaredError(density, places, scale);
        if (error < smallest) smallest = error, best = scale;
    }
    if (best == 0) return fit;
    double low = best / kStep, high = best * kStep;
    for (int i = 0; i < 12; ++i) {
        const double a = low + 0.382 * (high - low), b = low + 0.618 * (high - low);
        if (squaredError(density, places, a) < squaredError(density, places, b))
            high = b;
        else
            low = a;
    }
    fit.scale = 0.5 * (low + high);
    fit.explained = 1 - squaredError(density, places, fit.scale) / resting;
    return fit;
}

}  // namespace brickyard

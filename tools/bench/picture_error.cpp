#include "tools/bench/picture_error.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace brickyard {
namespace {

// Truth and picture are floats near 1: closer than this no error can be told from rounding.
constexpr double kRounding = 2e-6;

}  // namespace

std::vector<float> alphaOf(std::span<const double> depths, double density_scale) {
    std::vector<float> alpha(depths.size());
    for (std::size_t i = 0; i < depths.size(); ++i) alpha[i] = float(-std::expm1(-density_scale * depths[i]));
    return alpha;
}

void PictureError::addPixel(double value, double truth) {
    // What is not finite is as wrong as can be.
    const double error = std::isfinite(value) ? std::abs(value - truth) : 1;
    worst_ = std::max(worst_, error);
    sum_squares_ += error * error;
    ++pixels_;
}

void PictureError::addValues(std::span<const float> values, std::span<const float> truth) {
    assert(values.size() == truth.size());
    for (std::size_t i = 0; i < values.size(); ++i) addPixel(double(values[i]), double(truth[i]));
}

void PictureError::addPicture(const Picture& picture, std::span<const float> truth) {
    assert(picture.pixels.size() == truth.size());
    for (std::size_t i = 0; i < truth.size(); ++i) {
        const Pixel& pixel = picture.pixels[i];
        const double error = std::abs(double(pixel.alpha) - double(truth[i]));
        addPixel(double(pixel.alpha), double(truth[i]));
        sum_estimate_ += double(pixel.estimate_alpha);
        sum_bound_ += double(pixel.bound_alpha);
        broken_ += !(error <= double(pixel.bound_alpha) + kRounding);
        // Rays that meet nothing are right by themselves and would only embellish the share.
        if (!(pixel.alpha > 0) && !(truth[i] > 0)) continue;
        ++seen_;
        for (int sigmas = 1; sigmas <= 3; ++sigmas)
            within_[std::size_t(sigmas - 1)] += error <= sigmas * double(pixel.estimate_alpha) + kRounding;
    }
}

void PictureError::add(const PictureError& other) {
    sum_squares_ += other.sum_squares_;
    worst_ = std::max(worst_, other.worst_);
    sum_estimate_ += other.sum_estimate_;
    sum_bound_ += other.sum_bound_;
    for (std::size_t i = 0; i < within_.size(); ++i) within_[i] += other.within_[i];
    pixels_ += other.pixels_;
    seen_ += other.seen_;
    broken_ += other.broken_;
}

double PictureError::rms() const { return std::sqrt(mean(sum_squares_)); }

double PictureError::within(int sigmas) const {
    return seen_ > 0 ? double(within_[std::size_t(sigmas - 1)]) / double(seen_) : 1;
}

nlohmann::json toJson(const PictureError& error) {
    return {{"rms", error.rms()},
            {"worst", error.worst()},
            {"mean_estimate", error.meanEstimate()},
            {"mean_bound", error.meanBound()},
            {"within_1", error.within(1)},
            {"within_2", error.within(2)},
            {"within_3", error.within(3)},
            {"bounds_broken", error.broken()}};
}

}  // namespace brickyard

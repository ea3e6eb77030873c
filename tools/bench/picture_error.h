// How far a picture is from the truth, and whether what it says of itself holds. Plain values, any thread.
#pragma once

#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <span>
#include <vector>

#include "client/picture.h"

namespace brickyard {

// Alpha of the optical depths that ScalarWalk::depths gives.
std::vector<float> alphaOf(std::span<const double> depths, double density_scale);

// Sums, so that the errors of several pictures add up to one of them all.
class PictureError {
public:
    // Of a picture's alpha, with what it says of it.
    void addPicture(const Picture& picture, std::span<const float> truth);
    // Of figures that say nothing of themselves.
    void addValues(std::span<const float> values, std::span<const float> truth);
    void add(const PictureError& other);

    double rms() const;
    double worst() const { return worst_; }
    double meanEstimate() const { return mean(sum_estimate_); }
    double meanBound() const { return mean(sum_bound_); }
    // Pixels whose error is at most `sigmas` (1, 2 or 3) estimates, as a fraction of those with something in
    // them; 1 where there are none.
    double within(int sigmas) const;
    // Pixels whose error is above their bound.
    std::uint64_t broken() const { return broken_; }
    std::uint64_t pixels() const { return pixels_; }

private:
    void addPixel(double value, double truth);
    double mean(double sum) const { return pixels_ > 0 ? sum / double(pixels_) : 0; }

    double sum_squares_ = 0, worst_ = 0, sum_estimate_ = 0, sum_bound_ = 0;
    std::array<std::uint64_t, 3> within_{};
    std::uint64_t pixels_ = 0, seen_ = 0, broken_ = 0;
};

// rms, worst, and what the picture says of itself.
nlohmann::json toJson(const PictureError& error);

}  // namespace brickyard

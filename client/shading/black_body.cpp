#include "client/shading/black_body.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace brickyard {

namespace {

// A linear table of this step is off by less than 0.2 % from 1000 kelvin on.
constexpr double kStepKelvin = 5, kMostKelvin = 40000;

// One side of a lobe is wider than the other; lengths are in nanometres.
double lobe(double wave, double middle, double left, double right) {
    const double t = (wave - middle) / (wave < middle ? left : right);
    return std::exp(-0.5 * t * t);
}

// Wyman, Sloan and Shirley's multi-lobe fit, their table 1.
glm::dvec3 observer(double wave) {
    return {1.056 * lobe(wave, 599.8, 37.9, 31.0) + 0.362 * lobe(wave, 442.0, 16.0, 26.7) -
                0.065 * lobe(wave, 501.1, 20.4, 26.2),
            0.821 * lobe(wave, 568.8, 46.9, 40.5) + 0.286 * lobe(wave, 530.9, 16.3, 31.1),
            1.217 * lobe(wave, 437.0, 11.8, 36.0) + 0.681 * lobe(wave, 459.0, 26.0, 13.8)};
}

struct Wave {
    double hc_over_kl = 0;  // kelvin
    glm::dvec3 weight{0};   // observer / wave^5
};

std::vector<Wave> waves() {
    constexpr double kSecondRadiation = 1.438776877e7;  // h c / k, nanometre kelvin
    std::vector<Wave> all;
    for (double wave = 380; wave <= 780; wave += 5)
        all.push_back({kSecondRadiation / wave, observer(wave) * std::pow(wave / 560, -5)});
    return all;
}

// CIE XYZ, in a unit of its own.
glm::dvec3 tristimulus(const std::vector<Wave>& waves, double kelvin) {
    glm::dvec3 sum(0);
    if (!(kelvin > 0)) return sum;
    for (const Wave& wave : waves) sum += wave.weight / std::expm1(wave.hc_over_kl / kelvin);
    return sum;
}

// IEC 61966-2-1, D65.
glm::dvec3 linearSrgb(const glm::dvec3& xyz) {
    return {3.2404542 * xyz.x - 1.5371385 * xyz.y - 0.4985314 * xyz.z,
            -0.9692660 * xyz.x + 1.8760108 * xyz.y + 0.0415560 * xyz.z,
            0.0556434 * xyz.x - 0.2040259 * xyz.y + 1.0572252 * xyz.z};
}

}  // namespace

BlackBody::BlackBody(double kelvin_at_one) : step_(kStepKelvin) {
    const std::vector<Wave> all = waves();
    // Below 100 kelvin hardly a photon is left to divide by.
    const double luminance = tristimulus(all, std::clamp(kelvin_at_one, 100.0, kMostKelvin)).y;
    table_.reserve(std::size_t(kMostKelvin / step_) + 1);
    for (std::size_t i = 0; double(i) * step_ <= kMostKelvin; ++i) {
        const glm::dvec3 color = linearSrgb(tristimulus(all, double(i) * step_) / luminance);
        table_.push_back({std::max(color.x, 0.0), std::max(color.y, 0.0), std::max(color.z, 0.0)});
    }
}

glm::dvec3 BlackBody::radiance(double kelvin) const {
    if (!(kelvin > 0)) return glm::dvec3(0);  // NaN too
    const double place = std::min(kelvin / step_, double(table_.size() - 1));
    const std::size_t i = std::min(std::size_t(place), table_.size() - 2);
    const double t = place - double(i);
    return (1 - t) * table_[i] + t * table_[i + 1];
}

}  // namespace brickyard

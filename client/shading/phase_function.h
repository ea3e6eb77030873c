// How scattered light is distributed over directions, per steradian; integrates to 1. `cosine` is between the
// way the light goes before and after. Pure functions, any thread.
// Henyey, Greenstein. Diffuse radiation in the galaxy. 1941. Rayleigh for unpolarised light.
#pragma once

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <numbers>

namespace brickyard {

struct PhaseFunction {
    enum class Kind { kHenyeyGreenstein, kRayleigh } kind = Kind::kHenyeyGreenstein;
    double anisotropy = 0;  // g

    double operator()(double cosine) const {
        if (kind == Kind::kRayleigh) return 3 / (16 * std::numbers::pi) * (1 + cosine * cosine);
        const double g = anisotropy;
        const double d = std::max(1 + g * g - 2 * g * cosine, 1e-12);
        return (1 - g * g) / (4 * std::numbers::pi * d * std::sqrt(d));
    }
    // A cosine with just that density over directions; `u` is uniform in [0, 1).
    double pickCosine(double u) const {
        if (kind == Kind::kRayleigh) {
            // Frisvad. Importance sampling the Rayleigh phase function. 2011.
            const double a = 4 * u - 2, b = std::cbrt(std::sqrt(a * a + 1) + a);
            return std::clamp(b - 1 / b, -1.0, 1.0);
        }
        const double g = anisotropy;
        if (std::abs(g) < 1e-3) return 1 - 2 * u;
        const double s = (1 - g * g) / (1 - g + 2 * g * u);
        return std::clamp((1 + g * g - s * s) / (2 * g), -1.0, 1.0);
    }
};

// Unit vector at `cosine` to unit `axis`, at azimuth 2 pi * `turn`.
inline glm::dvec3 aroundAxis(const glm::dvec3& axis, double cosine, double turn) {
    // Duff et al. Building an Orthonormal Basis, Revisited. JCGT 2017.
    const double sign = std::copysign(1.0, axis.z), a = -1 / (sign + axis.z), b = axis.x * axis.y * a;
    const glm::dvec3 s(1 + sign * axis.x * axis.x * a, sign * b, -sign * axis.x),
        t(b, sign + axis.y * axis.y * a, -axis.y);
    const double sine = std::sqrt(std::max(0.0, 1 - cosine * cosine)), phi = 2 * std::numbers::pi * turn;
    return sine * std::cos(phi) * s + sine * std::sin(phi) * t + cosine * axis;
}

}  // namespace brickyard

// The ambient occlusion of SurfaceTracer.

#include <cmath>
#include <numbers>

#include "client/trace/surface_tracer.h"

namespace brickyard {

namespace {

// Vigna's splitmix64.
std::uint64_t mixed(std::uint64_t x) {
    x += 0x9e3779b97f4a7c15ull;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ull;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebull;
    return x ^ (x >> 31);
}
double unitOf(std::uint64_t bits) { return double(bits >> 11) * 0x1p-53; }
double radicalInverse(std::uint32_t i) {
    i = (i << 16) | (i >> 16);
    i = (i & 0x00ff00ffu) << 8 | (i & 0xff00ff00u) >> 8;
    i = (i & 0x0f0f0f0fu) << 4 | (i & 0xf0f0f0f0u) >> 4;
    i = (i & 0x33333333u) << 2 | (i & 0xccccccccu) >> 2;
    i = (i & 0x55555555u) << 1 | (i & 0xaaaaaaaau) >> 1;
    return double(i) * 0x1p-32;
}
double wrapped(double x) { return x - std::floor(x); }

}  // namespace

SurfaceTracer::Found SurfaceTracer::openness(const SurfaceHit& hit, const glm::dvec3& normal, double reach,
                                             std::uint32_t rays, std::uint64_t seed,
                                             const RayContext& context, Openness& out, double worth,
                                             bool* failed) const {
    out = {};
    if (rays == 0 || !(reach > 0)) return Found::kHit;
    // Duff et al. Building an Orthonormal Basis, Revisited. 2017.
    const double sign = std::copysign(1.0, normal.z), a = -1 / (sign + normal.z), b = normal.x * normal.y * a;
    const glm::dvec3 tangent(1 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x);
    const glm::dvec3 other(b, sign + normal.y * normal.y * a, -normal.y);

    const double move_u = unitOf(mixed(seed)), move_v = unitOf(mixed(~seed));
    std::uint32_t free = 0, known = 0;
    for (std::uint32_t i = 0; i < rays; ++i) {
        // A disc's points lifted to the hemisphere are weighted with the cosine.
        const double u = wrapped((i + 0.5) / rays + move_u), v = wrapped(radicalInverse(i) + move_v);
        const double angle = 2 * std::numbers::pi * v, radius = std::sqrt(u);
        const glm::dvec3 direction =
            radius * std::cos(angle) * tangent + radius * std::sin(angle) * other + std::sqrt(1 - u) * normal;
        const Found found = occludedFrom(hit, direction, reach, context, worth / rays, failed);
        known += found != Found::kMissing;
        free += found == Found::kNothing;
    }
    if (known > 0) out.share = double(free) / known;
    // As if the rays were independent, which says too much; never 0, for some rays are not all directions.
    const double guess = (free + 0.5) / (known + 1.0);
    out.deviation = std::sqrt(guess * (1 - guess) / std::max(1u, known));
    return known == rays ? Found::kHit : Found::kMissing;
}

}  // namespace brickyard

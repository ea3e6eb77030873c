// From the segments of a ray to its pixel: transmittance, radiance, depth, and how wrong each may be.
// How node errors add up to these: docs/error-bounds.md. Pure functions, any thread.
#pragma once

#include <vector>

#include "client/cpu/channel_ray.h"
#include "client/cpu/render_plan.h"
#include "client/picture.h"

namespace brickyard {

// A ray's pixel, in double, and how much of its error each segment carries.
struct RayComposite {
    double alpha = 0, transmittance = 1;
    glm::dvec3 radiance{0};
    double depth = 0;  // world distance to half the final opacity; 0 where empty
    double bound_alpha = 0, bound_radiance = 0;
    double estimate_alpha = 0, estimate_radiance = 0;
    // Optical depth: as integrated, and the interval that holds the true one.
    double optical_depth = 0, optical_low = 0, optical_high = 0;
    // d(pixel) / d(integral) of a segment, largest of alpha (and of the radiances).
    std::vector<double> density_alpha;      // by density segment: effect on alpha
    std::vector<double> density_radiance;   // by density segment: effect on the worst radiance
    std::vector<double> emission_radiance;  // by emission segment

    Pixel pixel() const;
};

// `emission` may be null. `with_light` says that the density's cells carry shadows. `view` is the ray's
// direction.
RayComposite compositeRay(const RenderPlan& plan, const glm::dvec3& view,
                          const std::vector<RaySegment>& density, const std::vector<RaySegment>* emission,
                          bool with_light);

// Alpha, transmittance and their errors from the optical depth of a ray that meets the medium, the interval
// [low, high] that holds the true one, and the variance of its expected error.
struct AlphaComposite {
    double alpha = 0, transmittance = 1, bound = 0, estimate = 0;
};
AlphaComposite compositeAlpha(double depth, double low, double high, double variance);

// Henyey and Greenstein's phase function, per steradian; `cosine` between the ways light travels before and
// after.
double henyeyGreenstein(double g, double cosine);

}  // namespace brickyard

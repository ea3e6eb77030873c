// Light from everywhere: one radiance, or a lat-long picture, constant over each of its texels, so that what
// is picked and what is added up is exactly what is seen. Immutable: any thread.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "core/result.h"

namespace brickyard {

class EnvironmentMap {
public:
    // The same from everywhere.
    explicit EnvironmentMap(const glm::dvec3& radiance);
    // Row 0 is the north pole, at `up`; the columns run over the longitudes, turned by `rotation` degrees
    // about it. Who looks along world X (Y where `up` is parallel to X) sees the picture's middle, unturned,
    // and its right half on the right, as in Cycles. `factor` multiplies. Errors: kNotFound; kCorrupt (no
    // EXR, no R G B); kInvalid (a texel is not finite or is negative); kUnsupported (more than 2^26 texels).
    static Result<EnvironmentMap> read(const std::filesystem::path& file, const glm::dvec3& factor,
                                       const glm::dvec3& up, double rotation);
    // The same from texels in memory, row by row. REQUIRES: width * height of them, finite, none negative;
    // `up` has a length.
    EnvironmentMap(std::vector<glm::vec3> texels, std::uint32_t width, const glm::dvec3& up, double rotation);

    // Radiance that comes from unit `direction` (world, from the scene towards the sky).
    glm::dvec3 radiance(const glm::dvec3& direction) const;
    // The same to look at: between texels interpolated.
    glm::dvec3 backdrop(const glm::dvec3& direction) const;
    // A direction with probability in proportion to what comes from there. u and v are uniform in [0, 1).
    struct Pick {
        glm::dvec3 direction{0, 0, 1};
        double density = 0;  // per steradian; 0: nothing shines
        glm::dvec3 radiance{0};
    };
    Pick pick(double u, double v) const;
    bool constant() const { return width_ == 0; }
    double density(const glm::dvec3& direction) const;

    // The whole as `count` (about) distant lights: regions of equal power (Debevec. A Median Cut Algorithm
    // for Light Probe Sampling. 2005); a constant one as points spread evenly over the sphere. Irradiances
    // add up to the integral of radiance.
    struct DistantLight {
        glm::dvec3 to_light{0, 0, 1};
        glm::dvec3 irradiance{0};
    };
    std::vector<DistantLight> distantLights(std::size_t count) const;

private:
    double rowCosine(std::uint32_t row) const;  // of the angle from the pole to the row's upper edge
    double texelSolidAngle(std::uint32_t row) const;
    glm::dvec3 texelDirection(double column, double cosine) const;
    std::size_t texelAt(const glm::dvec3& direction) const;

    std::uint32_t width_ = 0, height_ = 0;  // 0: constant_
    glm::dvec3 constant_{0};
    glm::dmat3 to_world_{1.0}, to_map_{1.0};
    std::vector<glm::vec3> texels_;
    // Luminance times solid angle, added up: over the rows, and within each row.
    std::vector<double> row_cdf_, texel_cdf_;
    double total_ = 0;
};

}  // namespace brickyard

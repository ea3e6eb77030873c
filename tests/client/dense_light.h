// One light scattered once, in double and by means of its own: what lit pictures are held against. Samples
// lie in an array; a ray goes from cell to cell, with Gauss points in each, and from every one of those to
// the light.
#pragma once

#include <vector>

#include "core/camera.h"
#include "core/field_source.h"

namespace brickyard {

class DenseLight {
public:
    // The field must not be negative, and 0 outside its active box. Its index space is the world.
    explicit DenseLight(const FieldSource& source);

    // Of the field along the ray, from its origin on.
    double depth(const WorldRay& ray) const;
    // Integral of transmittance * extinction * transmittance towards the light.
    double scatteredWeight(const WorldRay& ray, double density_scale, const glm::dvec3& to_light) const;

private:
    struct Step {
        const float* corner;  // of the cell, the lowest one
        glm::dvec3 from, to;  // within the cell
        double begin, end;
    };
    template <class Visit>
    void walk(const WorldRay& ray, Visit&& visit) const;
    double at(const float* corner, const glm::dvec3& inside) const;
    double mean(const Step& step) const;

    glm::dvec3 low_;  // of the first sample
    std::int64_t edge_[3];
    std::vector<float> samples_;
};

}  // namespace brickyard

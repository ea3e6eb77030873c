// What a black body of a temperature radiates, as linear sRGB: Planck's law through the CIE 1931 2-degree
// observer (Wyman, Sloan, Shirley. Simple Analytic Approximations to the CIE XYZ Color Matching Functions.
// JCGT 2013). Immutable: any thread.
#pragma once

#include <glm/vec3.hpp>
#include <vector>

namespace brickyard {

class BlackBody {
public:
    // Luminance is 1 at `kelvin_at_one`, and elsewhere what Planck's law makes of that. REQUIRES: above 0,
    // finite.
    explicit BlackBody(double kelvin_at_one);

    // Negative components (colours outside sRGB) are 0. 0 below some hundred kelvin; what is hotter than 40
    // 000 kelvin radiates as if it were that hot.
    glm::dvec3 radiance(double kelvin) const;

private:
    std::vector<glm::dvec3> table_;  // over the temperature; interpolated
    double step_ = 1;
};

}  // namespace brickyard

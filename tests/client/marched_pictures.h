// Fields and measures for tests of pictures that have a closed form.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>

#include "reference_field.h"
#include "scene_pictures.h"

namespace brickyard {

using Position = std::int64_t;

inline FormulaField solid(const std::string& name, const IndexBox& box, double value = 1) {
    return FormulaField(name, box, [=](Position, Position, Position, int) { return value; });
}
inline FormulaField ball(const std::string& name, const glm::dvec3& centre, double radius,
                         const IndexBox& box) {
    return FormulaField(name, box, [=](Position x, Position y, Position z, int) {
        return std::clamp(radius - glm::length(glm::dvec3(double(x), double(y), double(z)) - centre), 0.0,
                          3.0) /
               3;
    });
}

class RayMarchTest : public ScenePictures {
protected:
    static PinholeCamera lens(const RenderRequest& request) {
        return *PinholeCamera::create(*request.camera, request.width, request.height);
    }
    // `truth(ray)` is what a pixel's number should be.
    template <class Number, class Truth>
    static double worst(const Picture& picture, const RenderRequest& request, Number number, Truth truth) {
        double most = 0;
        const PinholeCamera camera = lens(request);
        for (std::uint32_t y = 0; y < picture.height; ++y)
            for (std::uint32_t x = 0; x < picture.width; ++x)
                most = std::max(most, std::abs(double(number(picture.pixels[y * picture.width + x])) -
                                               double(truth(camera.ray(x, y)))));
        return most;
    }
    static float alpha(const Pixel& pixel) { return pixel.alpha; }
    static float red(const Pixel& pixel) { return pixel.radiance[0]; }
    static float depth(const Pixel& pixel) { return pixel.depth; }
    // Length of a ray's way between two heights.
    static double along(const WorldRay& ray, double low, double high) {
        return (high - low) / std::abs(ray.direction.z);
    }
};

// Looks down on what lies about (32, 32, 5), from 60 above, at its middle only.
inline const Camera kAbove = cameraAt({20, 28, 60}, {30, 33, 5}, 30);

}  // namespace brickyard

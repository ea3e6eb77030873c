// The pinhole camera of the picture contract (DESIGN.md, section 9): world space is right-handed, the ray of
// pixel (x, y) goes through (x + 0.5, y + 0.5), row 0 is the top. Plain value, any thread.
#pragma once

#include <glm/vec3.hpp>

#include "core/result.h"
#include "proto/scene.pb.h"

namespace brickyard {

struct WorldRay {
    glm::dvec3 origin;
    glm::dvec3 direction;  // unit length
};

class PinholeCamera {
public:
    // Errors: kInvalid (not finite, eye equals target, up parallel to the view, field of view outside (0,
    // 180)).
    static Result<PinholeCamera> create(const Camera& camera, std::uint32_t width, std::uint32_t height);

    WorldRay ray(std::uint32_t x, std::uint32_t y) const {
        return rayThrough(double(x) + 0.5, double(y) + 0.5);
    }
    // Of a place in the picture, in pixels from its upper left corner.
    WorldRay rayThrough(double x, double y) const;
    // The same view from elsewhere.
    PinholeCamera moved(const glm::dvec3& by) const {
        PinholeCamera camera = *this;
        camera.eye_ += by;
        return camera;
    }
    const glm::dvec3& eye() const { return eye_; }
    // Unit vectors; right x up = -forward.
    const glm::dvec3& forward() const { return forward_; }
    const glm::dvec3& right() const { return right_; }
    const glm::dvec3& up() const { return up_; }
    // Half the picture's extent at distance 1.
    double halfHeight() const { return half_height_; }
    double halfWidth() const { return half_height_ * double(width_) / double(height_); }
    // World edge of a pixel at distance 1 along `forward`.
    double pixelEdge() const { return 2 * half_height_ / double(height_); }
    std::uint32_t width() const { return width_; }
    std::uint32_t height() const { return height_; }

private:
    PinholeCamera() = default;
    glm::dvec3 eye_{0}, forward_{0}, right_{0}, up_{0};
    double half_height_ = 0;
    std::uint32_t width_ = 0, height_ = 0;
};

}  // namespace brickyard

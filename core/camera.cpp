#include "core/camera.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>

namespace brickyard {
namespace {

constexpr double kDefaultFovDegrees = 40;
// Below this sine of the angle between them, two directions count as parallel.
constexpr double kParallelSine = 1e-9;

bool isFinite(const glm::dvec3& v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

// Scaled first, so that neither 1e-200 nor 1e+200 is lost in the squares. REQUIRES: v is finite and not zero.
glm::dvec3 unit(const glm::dvec3& v) {
    const double scale = std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)});
    return glm::normalize(v / scale);
}

Result<glm::dvec3> vectorOf(const google::protobuf::RepeatedField<double>& numbers, const char* name) {
    if (numbers.size() != 3)
        return fail(ErrorCode::kInvalid, std::string("camera: ") + name + " has " +
                                             std::to_string(numbers.size()) + " numbers; give three");
    const glm::dvec3 v{numbers[0], numbers[1], numbers[2]};
    if (!isFinite(v))
        return fail(ErrorCode::kInvalid,
                    std::string("camera: ") + name + " is not finite; give three finite numbers");
    return v;
}

}  // namespace

Result<PinholeCamera> PinholeCamera::create(const Camera& camera, std::uint32_t width, std::uint32_t height) {
    if (width == 0 || height == 0)
        return fail(ErrorCode::kInvalid,
                    "camera: the picture has no pixels; give a width and a height of at least 1");
    const auto eye = vectorOf(camera.eye(), "eye");
    if (!eye) return tl::unexpected(eye.error());
    const auto target = vectorOf(camera.target(), "target");
    if (!target) return tl::unexpected(target.error());
    const glm::dvec3 view = *target - *eye;
    if (!isFinite(view))
        return fail(ErrorCode::kInvalid, "camera: eye and target are too far apart; move them closer");
    if (view == glm::dvec3(0))
        return fail(ErrorCode::kInvalid, "camera: eye and target are the same point; move one of them");

    PinholeCamera pinhole;
    pinhole.eye_ = *eye;
    pinhole.forward_ = unit(view);
    glm::dvec3 up{0, 1, 0};
    if (camera.up_size() == 0) {
        // The default must work from everywhere, so straight up and straight down get another one.
        if (glm::length(glm::cross(pinhole.forward_, up)) < kParallelSine) up = {0, 0, 1};
    } else {
        const auto given = vectorOf(camera.up(), "up");
        if (!given) return tl::unexpected(given.error());
        if (*given == glm::dvec3(0)) return fail(ErrorCode::kInvalid, "camera: up is zero; give a direction");
        up = unit(*given);
        if (glm::length(glm::cross(pinhole.forward_, up)) < kParallelSine)
            return fail(ErrorCode::kInvalid, "camera: up is parallel to the view; choose another up");
    }
    pinhole.right_ = unit(glm::cross(pinhole.forward_, up));
    pinhole.up_ = glm::cross(pinhole.right_, pinhole.forward_);

    const double fov =
        camera.vertical_fov_degrees() == 0 ? kDefaultFovDegrees : camera.vertical_fov_degrees();
    if (!(fov > 0 && fov < 180))
        return fail(ErrorCode::kInvalid, "camera: vertical_fov_degrees is " + std::to_string(fov) +
                                             "; give one above 0 and below 180");
    pinhole.half_height_ = std::tan(fov * std::numbers::pi / 180 / 2);
    pinhole.width_ = width;
    pinhole.height_ = height;
    return pinhole;
}

WorldRay PinholeCamera::rayThrough(double x, double y) const {
    const double px = (2 * x / double(width_) - 1) * half_height_ * double(width_) / double(height_);
    const double py = (1 - 2 * y / double(height_)) * half_height_;
    return {eye_, glm::normalize(forward_ + right_ * px + up_ * py)};
}

}  // namespace brickyard

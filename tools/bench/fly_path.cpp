#include "tools/bench/fly_path.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <numbers>

namespace brickyard {
namespace {

constexpr double kNearest = 1.0 / 15;

double smooth(double x) { return x * x * (3 - 2 * x); }

glm::dvec3 vectorOf(const google::protobuf::RepeatedField<double>& numbers) {
    return {numbers[0], numbers[1], numbers[2]};
}

}  // namespace

Camera flyCamera(const Camera& framing, double part) {
    const glm::dvec3 middle = vectorOf(framing.target()), up = glm::normalize(vectorOf(framing.up()));
    const glm::dvec3 away = vectorOf(framing.eye()) - middle;
    // Two turns in all, and none while the camera is on its way back: what it then sees, it has seen before.
    const double angle = 4 * std::numbers::pi * std::min(1.0, part * 1.5);
    const glm::dvec3 turned = std::cos(angle) * away + std::sin(angle) * glm::cross(up, away) +
                              (1 - std::cos(angle)) * glm::dot(up, away) * up;
    const double third = 3 * part;
    const double depth = third < 1 ? 0 : third < 2 ? smooth(third - 1) : smooth(3 - third);
    const glm::dvec3 eye = middle + std::pow(kNearest, depth) * turned;
    Camera camera = framing;
    for (int a = 0; a < 3; ++a) camera.set_eye(a, eye[a]);
    return camera;
}

}  // namespace brickyard

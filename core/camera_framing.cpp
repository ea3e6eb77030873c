#include "core/camera_framing.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <vector>

#include "core/affine.h"

namespace brickyard {

Camera frameChannel(const ChannelFooter& channel, double aspect) {
    constexpr double kFovDegrees = 40;
    const std::vector<double> columns(channel.index_to_world().begin(), channel.index_to_world().end());
    const Affine transform = Affine::fromColumns(columns).value_or(Affine());
    glm::dvec3 low(std::numeric_limits<double>::max()), high(std::numeric_limits<double>::lowest());
    for (int corner = 0; corner < 8; ++corner) {
        glm::dvec3 index(0);
        if (channel.active_min_size() == 3)
            for (int a = 0; a < 3; ++a)
                index[a] = (corner >> a & 1) ? channel.active_max(a) + 1.0 : channel.active_min(a) - 1.0;
        low = glm::min(low, transform.point(index));
        high = glm::max(high, transform.point(index));
    }
    const glm::dvec3 center = low + 0.5 * (high - low), size = high - low;
    const double radius = 0.5 * std::max(glm::length(size), transform.voxelSize());
    const bool z_up = size.z > size.y;
    const glm::dvec3 from =
        z_up ? glm::normalize(glm::dvec3(0.45, -1, 0.25)) : glm::normalize(glm::dvec3(0.45, 0.25, 1));
    // The narrower of the two half angles must hold the bounding sphere.
    const double half = kFovDegrees * 0.5 * 3.14159265358979323846 / 180;
    const double narrow = aspect < 1 ? std::atan(std::tan(half) * aspect) : half;
    const glm::dvec3 eye = center + from * (radius / std::sin(narrow));

    Camera camera;
    for (int a = 0; a < 3; ++a) {
        camera.add_eye(eye[a]);
        camera.add_target(center[a]);
        camera.add_up(a == (z_up ? 2 : 1) ? 1 : 0);
    }
    camera.set_vertical_fov_degrees(kFovDegrees);
    return camera;
}

}  // namespace brickyard

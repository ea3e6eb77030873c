#include "client/default_scene.h"

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>

#include "core/camera_framing.h"

namespace brickyard {

namespace {

// Decimals that a person would write.
double rounded(double value, double step) {
    return double(std::int64_t(value / step + (value < 0 ? -0.5 : 0.5))) * step;
}

template <class Repeated>
glm::dvec3 vectorOf(const Repeated& numbers) {
    return {numbers[0], numbers[1], numbers[2]};
}

bool holdsScalars(const ChannelFooter& channel) {
    return channel.components() == 1 && channel.active_voxels() > 0;
}

}  // namespace

std::optional<std::uint32_t> onlyLevelSet(const FrameFooter& frame) {
    std::optional<std::uint32_t> found;
    for (int i = 0; i < frame.channels_size(); ++i) {
        const ChannelFooter& channel = frame.channels(i);
        if (!holdsScalars(channel) || channel.grid_class() != "level set") continue;
        if (found) return std::nullopt;
        found = std::uint32_t(i);
    }
    return found;
}

Surface defaultSurface(const ChannelFooter& channel) {
    Surface surface;
    surface.set_channel(channel.name());
    for (int c = 0; c < 3; ++c) surface.add_color(0.75f);
    surface.set_specular(0.2);
    double diagonal = 0;
    const auto& m = channel.index_to_world();
    for (int a = 0; a < 3 && m.size() == 16 && channel.active_min_size() == 3; ++a) {
        const double edge = double(channel.active_max(a)) - double(channel.active_min(a)) + 1;
        const glm::dvec3 axis(m[4 * a], m[4 * a + 1], m[4 * a + 2]);
        diagonal += edge * edge * glm::dot(axis, axis);
    }
    if (std::isfinite(diagonal)) surface.set_ambient_occlusion(0.1 * std::sqrt(diagonal));
    return surface;
}

void addStudioLights(const Camera& camera, double key_irradiance, double sky_radiance, Scene& scene) {
    const glm::dvec3 view = glm::normalize(vectorOf(camera.target()) - vectorOf(camera.eye()));
    const glm::dvec3 right = glm::normalize(glm::cross(view, vectorOf(camera.up()))),
                     above = glm::cross(right, view);
    const glm::dvec3 direction = glm::normalize(0.7 * view + 0.55 * right - 0.65 * above);
    Light& key = *scene.add_lights();
    for (int a = 0; a < 3; ++a) key.add_direction(rounded(direction[a], 0.001));
    for (const double part : {1.0, 0.97, 0.92}) key.add_irradiance(float(key_irradiance * part));
    Light& sky = *scene.add_lights();
    sky.set_type("environment");
    for (const double part : {0.8, 0.9, 1.0}) sky.add_radiance(float(sky_radiance * part));
}

Scene defaultScene(const FrameFooter& frame) {
    Scene scene;
    int scalars = 0;
    for (const ChannelFooter& channel : frame.channels()) scalars += holdsScalars(channel) ? 1 : 0;
    const std::optional<std::uint32_t> level_set = onlyLevelSet(frame);
    if (scalars != 1 || !level_set) return scene;
    const ChannelFooter& channel = frame.channels(int(*level_set));
    // A fog under that class has no inside.
    if (!(channel.value_min() < 0 && channel.value_max() > 0)) return scene;
    *scene.add_surfaces() = defaultSurface(channel);
    addStudioLights(frameChannel(channel, 1.5), 3, 0.25, scene);
    return scene;
}

}  // namespace brickyard

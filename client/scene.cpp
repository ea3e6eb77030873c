#include "client/scene.h"

#include <fmt/format.h>
#include <google/protobuf/util/json_util.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <glm/geometric.hpp>
#include <sstream>

#include "client/scene_entry.h"

namespace brickyard {

namespace {

constexpr std::size_t kMaxSceneBytes = 1u << 20;

template <class Message>
Result<Message> readJson(const std::string& text_or_file, const char* what) {
    std::string text = text_or_file, where = fmt::format("{} JSON", what);
    const std::size_t begin = text.find_first_not_of(" \t\r\n");
    if (begin == std::string::npos || text[begin] != '{') {
        where = text_or_file;
        std::ifstream in(text_or_file, std::ios::binary);
        if (!in)
            return fail(ErrorCode::kNotFound,
                        fmt::format("{}: no such {} file, and not JSON", text_or_file, what));
        std::ostringstream bytes;
        bytes << in.rdbuf();
        text = bytes.str();
    }
    if (text.size() > kMaxSceneBytes)
        return fail(ErrorCode::kInvalid, fmt::format("{}: is larger than a {} can be", where, what));
    Message message;
    const auto status = google::protobuf::util::JsonStringToMessage(text, &message);
    if (!status.ok()) {
        std::string reason(status.message());
        std::replace(reason.begin(), reason.end(), '\n', ' ');
        return fail(ErrorCode::kInvalid, fmt::format("{}: {}; docs/scene.md lists the keys", where, reason));
    }
    return message;
}

}  // namespace

Result<Scene> readScene(const std::string& text_or_file) { return readJson<Scene>(text_or_file, "scene"); }

Result<Camera> readCamera(const std::string& text_or_file) {
    return readJson<Camera>(text_or_file, "camera");
}

Result<SceneSettings> bindScene(const Scene& scene, FrameFooter& frame) {
    SceneSettings settings;
    const Medium& medium = scene.medium();
    const Result<std::uint32_t> density = medium.density().empty()
                                              ? densityEntry(frame, "medium.density")
                                              : channelEntry(frame, medium.density(), 1, "medium.density");
    if (!density) return tl::unexpected(density.error());
    settings.density_channel = *density;
    const Result<glm::dvec3> offset =
        vectorEntry(medium.sample_offset(), glm::dvec3(0), "medium.sample_offset");
    if (!offset) return tl::unexpected(offset.error());
    moveSamples(*offset, frame);

    const Result<double> scale = scaleEntry(medium.density_scale(), 1, "medium.density_scale");
    if (!scale) return tl::unexpected(scale.error());
    settings.density_scale = *scale;
    const Result<glm::dvec3> albedo = colorEntry(medium.albedo(), settings.albedo, "medium.albedo", 1);
    if (!albedo) return tl::unexpected(albedo.error());
    settings.albedo = *albedo;
    settings.anisotropy = medium.anisotropy();
    if (!(std::abs(settings.anisotropy) < 1))
        return refuseEntry("medium.anisotropy", "wants a number above -1 and below 1");

    if (medium.has_emission()) {
        EmissionSettings emission;
        const Result<std::uint32_t> channel =
            channelEntry(frame, medium.emission().channel(), 1, "medium.emission.channel");
        if (!channel) return tl::unexpected(channel.error());
        emission.channel = *channel;
        const Result<double> strength = scaleEntry(medium.emission().scale(), 1, "medium.emission.scale");
        if (!strength) return tl::unexpected(strength.error());
        emission.scale = *strength;
        const Result<glm::dvec3> color =
            colorEntry(medium.emission().color(), emission.color, "medium.emission.color");
        if (!color) return tl::unexpected(color.error());
        emission.color = *color;
        settings.emission = emission;
    }
    if (scene.lights_size() > 1)
        return fail(ErrorCode::kUnsupported,
                    fmt::format("scene: has {} lights; one is supported", scene.lights_size()));
    if (scene.lights_size() == 1) {
        LightSettings light;
        const Result<glm::dvec3> direction =
            vectorEntry(scene.lights(0).direction(), {0, -1, 0}, "lights[0].direction");
        if (!direction) return tl::unexpected(direction.error());
        if (!(glm::length(*direction) > 0) || !std::isfinite(glm::length(*direction)))
            return refuseEntry("lights[0].direction", "has no length");
        light.to_light = -glm::normalize(*direction);
        const Result<glm::dvec3> irradiance =
            colorEntry(scene.lights(0).irradiance(), light.irradiance, "lights[0].irradiance");
        if (!irradiance) return tl::unexpected(irradiance.error());
        light.irradiance = *irradiance;
        settings.light = light;
    }
    const glm::dvec3 grey(settings.background[0], settings.background[1], settings.background[2]);
    const Result<glm::dvec3> background = vectorEntry(scene.background(), grey, "background");
    if (!background) return tl::unexpected(background.error());
    for (int c = 0; c < 3; ++c) settings.background[std::size_t(c)] = float((*background)[c]);
    return settings;
}

}  // namespace brickyard

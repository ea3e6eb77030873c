#include "client/scene.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <google/protobuf/util/json_util.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <glm/geometric.hpp>
#include <sstream>
#include <vector>

#include "core/default_density.h"

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

template <class Repeated>
Result<glm::dvec3> vectorOf(const Repeated& numbers, const glm::dvec3& otherwise, const char* name) {
    if (numbers.empty()) return otherwise;
    if (numbers.size() != 3) return fail(ErrorCode::kInvalid, fmt::format("scene: {} wants 3 numbers", name));
    const glm::dvec3 v(numbers[0], numbers[1], numbers[2]);
    if (!std::isfinite(v.x) || !std::isfinite(v.y) || !std::isfinite(v.z))
        return fail(ErrorCode::kInvalid, fmt::format("scene: {} is not finite", name));
    return v;
}

Result<std::uint32_t> findChannel(const FrameFooter& frame, const std::string& name, const char* role) {
    std::vector<std::string> names;
    for (int i = 0; i < frame.channels_size(); ++i) {
        const ChannelFooter& channel = frame.channels(i);
        names.push_back(channel.name());
        if (channel.name() != name) continue;
        if (channel.components() != 1)
            return fail(ErrorCode::kInvalid,
                        fmt::format("scene: channel '{}' holds vectors and cannot be the {}", name, role));
        return std::uint32_t(i);
    }
    return fail(ErrorCode::kNotFound, fmt::format("scene: no channel '{}' for the {}; there are: {}", name,
                                                  role, fmt::join(names, ", ")));
}

Result<std::uint32_t> findDensity(const FrameFooter& frame) {
    if (const std::optional<std::uint32_t> channel = defaultDensity(frame)) return *channel;
    std::vector<std::string> names;
    for (const ChannelFooter& channel : frame.channels()) names.push_back(channel.name());
    return fail(ErrorCode::kNotFound,
                fmt::format("the frame has no channel 'density'; name one in the scene's "
                            "medium.density; there are: {}",
                            fmt::join(names, ", ")));
}

Result<double> positive(double value, const char* name) {
    if (value == 0) return 1.0;
    if (!std::isfinite(value) || value < 0)
        return fail(ErrorCode::kInvalid,
                    fmt::format("scene: {} is {}; it wants a number above 0", name, value));
    return value;
}

// world = M * (index + offset), for every channel. A transform that is none is refused when its channel is
// opened.
Result<void> offsetSamples(const Medium& medium, FrameFooter& frame) {
    const Result<glm::dvec3> offset = vectorOf(medium.sample_offset(), glm::dvec3(0), "medium.sample_offset");
    if (!offset) return tl::unexpected(offset.error());
    if (*offset == glm::dvec3(0)) return {};
    for (ChannelFooter& channel : *frame.mutable_channels()) {
        auto& columns = *channel.mutable_index_to_world();
        if (columns.size() != 16) continue;
        for (int row = 0; row < 3; ++row)
            for (int axis = 0; axis < 3; ++axis)
                columns[12 + row] += columns[4 * axis + row] * (*offset)[axis];
    }
    return {};
}

}  // namespace

Result<Scene> readScene(const std::string& text_or_file) { return readJson<Scene>(text_or_file, "scene"); }

Result<Camera> readCamera(const std::string& text_or_file) {
    return readJson<Camera>(text_or_file, "camera");
}

Result<SceneSettings> bindScene(const Scene& scene, FrameFooter& frame) {
    SceneSettings settings;
    const Medium& medium = scene.medium();
    const Result<std::uint32_t> density =
        medium.density().empty() ? findDensity(frame) : findChannel(frame, medium.density(), "density");
    if (!density) return tl::unexpected(density.error());
    settings.density_channel = *density;
    if (Result<void> offset = offsetSamples(medium, frame); !offset) return tl::unexpected(offset.error());

    const Result<double> scale = positive(medium.density_scale(), "medium.density_scale");
    if (!scale) return tl::unexpected(scale.error());
    settings.density_scale = *scale;
    const Result<glm::dvec3> albedo = vectorOf(medium.albedo(), settings.albedo, "medium.albedo");
    if (!albedo) return tl::unexpected(albedo.error());
    for (int c = 0; c < 3; ++c)
        if ((*albedo)[c] < 0 || (*albedo)[c] > 1)
            return fail(ErrorCode::kInvalid, "scene: medium.albedo wants numbers from 0 to 1");
    settings.albedo = *albedo;
    settings.anisotropy = medium.anisotropy();
    if (!(std::abs(settings.anisotropy) < 1))
        return fail(ErrorCode::kInvalid, "scene: medium.anisotropy wants a number above -1 and below 1");

    if (medium.has_emission()) {
        EmissionSettings emission;
        const Result<std::uint32_t> channel = findChannel(frame, medium.emission().channel(), "emission");
        if (!channel) return tl::unexpected(channel.error());
        emission.channel = *channel;
        const Result<double> strength = positive(medium.emission().scale(), "medium.emission.scale");
        if (!strength) return tl::unexpected(strength.error());
        emission.scale = *strength;
        const Result<glm::dvec3> color =
            vectorOf(medium.emission().color(), emission.color, "medium.emission.color");
        if (!color) return tl::unexpected(color.error());
        for (int c = 0; c < 3; ++c)
            if ((*color)[c] < 0)
                return fail(ErrorCode::kInvalid, "scene: medium.emission.color wants no negative numbers");
        emission.color = *color;
        settings.emission = emission;
    }
    if (scene.lights_size() > 1)
        return fail(ErrorCode::kUnsupported,
                    fmt::format("scene: has {} lights; one is supported", scene.lights_size()));
    if (scene.lights_size() == 1) {
        LightSettings light;
        const Result<glm::dvec3> direction =
            vectorOf(scene.lights(0).direction(), {0, -1, 0}, "lights[0].direction");
        if (!direction) return tl::unexpected(direction.error());
        if (!(glm::length(*direction) > 0) || !std::isfinite(glm::length(*direction)))
            return fail(ErrorCode::kInvalid, "scene: lights[0].direction has no length");
        light.to_light = -glm::normalize(*direction);
        const Result<glm::dvec3> irradiance =
            vectorOf(scene.lights(0).irradiance(), light.irradiance, "lights[0].irradiance");
        if (!irradiance) return tl::unexpected(irradiance.error());
        for (int c = 0; c < 3; ++c)
            if ((*irradiance)[c] < 0)
                return fail(ErrorCode::kInvalid, "scene: lights[0].irradiance wants no negative numbers");
        light.irradiance = *irradiance;
        settings.light = light;
    }
    const glm::dvec3 grey(settings.background[0], settings.background[1], settings.background[2]);
    const Result<glm::dvec3> background = vectorOf(scene.background(), grey, "background");
    if (!background) return tl::unexpected(background.error());
    for (int c = 0; c < 3; ++c) settings.background[std::size_t(c)] = float((*background)[c]);
    return settings;
}

}  // namespace brickyard

// What is drawn: camera, medium, light. From the JSON that users write (proto/scene.proto), checked and with
// its defaults filled in. Plain values.
#pragma once

#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <string>

#include "core/result.h"
#include "proto/dataset.pb.h"
#include "proto/scene.pb.h"

namespace brickyard {

struct EmissionSettings {
    std::uint32_t channel = 0;  // index in FrameFooter.channels
    double scale = 1;           // radiance per world unit and unit of the channel
    glm::dvec3 color{1, 0.45, 0.12};
};

struct LightSettings {
    glm::dvec3 to_light{0, 1, 0};  // unit, world: against the way the light travels
    glm::dvec3 irradiance{1};
};

struct SceneSettings {
    std::uint32_t density_channel = 0;  // index in FrameFooter.channels
    double density_scale = 1;
    glm::dvec3 albedo{0.8};
    double anisotropy = 0;
    std::optional<EmissionSettings> emission;
    std::optional<LightSettings> light;
    std::array<float, 3> background{0.35f, 0.42f, 0.5f};
};

// `text_or_file`: JSON where it starts with '{', else the name of a file that holds it. Unknown keys are
// errors. Errors: kInvalid, kNotFound, kIo.
Result<Scene> readScene(const std::string& text_or_file);
Result<Camera> readCamera(const std::string& text_or_file);

// Binds a scene to a frame: channel names become indices, and the medium's sample offset becomes part of
// every channel's transform in `frame`. Errors: kNotFound (names the channels there are); kInvalid.
Result<SceneSettings> bindScene(const Scene& scene, FrameFooter& frame);

}  // namespace brickyard

// All that a scene can say (proto/scene.proto), checked, bound to the frames it is drawn from, and with its
// defaults filled in. The renderer's fast way draws a part of it: simpleScene(). Plain values.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/scene.h"
#include "client/shading/black_body.h"
#include "client/shading/color_ramp.h"
#include "client/shading/environment_map.h"
#include "client/shading/phase_function.h"
#include "client/shading/transfer_function.h"

namespace brickyard {

// Nearest: the sample itself. Trilinear: as stored. The others are separable kernels over 4^3 samples: cubic
// B-spline and Catmull-Rom (interpolates), Mitchell and Netravali's with B = C = 1/3, a Gaussian of standard
// deviation half a voxel over 4 samples, normalised.
enum class FieldFilter : std::uint8_t { kNearest, kTrilinear, kBSpline, kCatmullRom, kMitchell, kGaussian };
std::optional<FieldFilter> fieldFilter(const std::string& name);
const char* toString(FieldFilter filter);

// A channel of one of the frames a scene is bound to.
struct FieldBinding {
    std::uint32_t frame = 0;    // index in the span given to bindWorld()
    std::uint32_t channel = 0;  // index in its FrameFooter.channels
    bool operator==(const FieldBinding&) const = default;
};

struct MediumEmission {
    FieldBinding channel;
    double scale = 1;
    glm::dvec3 color{1, 0.45, 0.12};  // times max(0, value), where neither of these is there:
    std::shared_ptr<const ColorRamp> ramp;
    std::shared_ptr<const BlackBody> black_body;  // at kelvin_offset + kelvin_scale * value
    double kelvin_scale = 1, kelvin_offset = 0;
    std::optional<FieldBinding> weight;
};

struct MediumSettings {
    FieldBinding density;
    double density_scale = 1;
    FieldFilter filter = FieldFilter::kTrilinear;
    glm::dvec3 albedo{0.8};
    std::optional<FieldBinding> color;  // multiplies the albedo
    std::shared_ptr<const ColorRamp> color_ramp;
    PhaseFunction phase;
    std::optional<MediumEmission> emission;
    std::shared_ptr<const TransferFunction> transfer;
    double transfer_shading = 0;
    std::optional<FieldBinding> velocity;
    double velocity_scale = 1;    // world units a frame per unit of the channel
    glm::dvec3 sample_offset{0};  // has become part of the transforms in the footer
};

enum class ShadowMethod : std::uint8_t { kAuto, kExact, kDeepMap, kBaked, kNone };
std::optional<ShadowMethod> shadowMethod(const std::string& name);

struct WorldLight {
    enum class Kind : std::uint8_t { kDirectional, kPoint, kSpot, kEnvironment } kind = Kind::kDirectional;
    glm::dvec3 to_light{0, 1, 0};           // unit; directional: towards the light; spot: against its axis
    glm::dvec3 position{0};                 // point, spot
    glm::dvec3 power{1};                    // irradiance (directional) or intensity (point, spot)
    double cos_outer = -1, cos_inner = -1;  // spot: nothing outside the outer, all inside the inner cone
    std::shared_ptr<const EnvironmentMap> environment;
    bool visible = false;
    std::uint32_t samples = 24;
    ShadowMethod shadows = ShadowMethod::kAuto;
    std::optional<FieldBinding> baked;
};

struct SurfaceSettings {
    FieldBinding channel;
    double iso = 0;
    bool inside_below = false;  // level sets: inside is below the value; else above. Normals point outwards
    glm::dvec3 color{0.8};
    double opacity = 1;
    double specular = 0;
    double ambient_occlusion = 0;  // reach, world; 0: none
    FieldFilter normal_filter = FieldFilter::kTrilinear;
};

struct WorldClip {
    std::optional<std::array<glm::dvec3, 2>> box;  // low, high
    struct Plane {
        glm::dvec3 point{0}, normal{0, 0, 1};  // unit; kept is dot(normal, x - point) >= 0
    };
    std::vector<Plane> planes;
    bool any() const { return box || !planes.empty(); }
};

struct WorldSettings {
    std::vector<MediumSettings> media;
    std::vector<WorldLight> lights;
    std::vector<SurfaceSettings> surfaces;
    WorldClip clip;
    double shutter_open = 0, shutter_close = 0;  // frames; equal: a moment
    std::array<float, 3> background{0.35f, 0.42f, 0.5f};
};

// A frame that a scene may name, with its dataset's name in the scene ("" for the command line's).
struct BoundFrame {
    std::string dataset;
    FrameFooter* footer =
        nullptr;  // gets sample offsets and dataset transforms into its channels' transforms
};

// `folder`: where relative names in the scene begin. Unknown, missing and contradictory entries are errors
// that name the entry: kInvalid, kNotFound, kUnsupported.
Result<WorldSettings> bindWorld(const Scene& scene, std::span<const BoundFrame> frames,
                                const std::filesystem::path& folder);

// The same as the fast way's settings, where they say it all: one medium of the first frame, trilinear, with
// density, Henyey and Greenstein, an emission of one colour; no light or one directional with shadows left to
// the renderer; nothing else.
std::optional<SceneSettings> simpleScene(const WorldSettings& world);

}  // namespace brickyard

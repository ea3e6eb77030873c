// OpenVDB's own vdb_render as a peer: another process, since it is a program and no library.
#pragma once

#include <filesystem>
#include <glm/vec3.hpp>
#include <optional>
#include <string>
#include <vector>

#include "core/result.h"
#include "proto/scene.pb.h"

namespace brickyard {

struct VdbRenderJob {
    std::filesystem::path file;
    std::string grid;
    Camera camera;  // the picture is square: its fields of view are equal
    std::uint32_t size = 0;
    double extinction = 0;  // per voxel edge and unit of density
    double albedo = 0;
    glm::dvec3 to_light{0, 1, 0};
    double light = 1;  // radiance that an albedo of 1 would scatter towards the eye without shadow
};

struct VdbRenderPicture {
    double seconds = 0;           // its own figure for the rays alone, without reading and writing
    std::vector<float> radiance;  // red, row 0 is the top
};

// Where the program is, or nothing.
std::optional<std::filesystem::path> findVdbRender();

// Steps, shadow steps and cutoff stay at its defaults; its gain, a falloff of the shadow with distance that
// no physics has, is off. `scratch` is a folder for its picture. Errors: kIo, kUnsupported (it failed or said
// nothing that is understood), kTimeout.
Result<VdbRenderPicture> runVdbRender(const std::filesystem::path& program, const VdbRenderJob& job,
                                      const std::filesystem::path& scratch);

}  // namespace brickyard

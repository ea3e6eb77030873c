// Light into a dataset: its frames as they are, and a channel more for each light of a scene.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/result.h"
#include "proto/dataset.pb.h"
#include "proto/scene.pb.h"
#include "tools/frame_plan.h"

namespace brickyard {

struct BakeOptions {
    std::filesystem::path dataset, output;
    Scene scene;
    std::filesystem::path folder;    // where relative names in the scene begin
    std::optional<FrameSet> frames;  // absent: all there are
    double max_error = 0.002;        // of a baked value
    int level = 0;                   // voxels of 2^level of the density's
    unsigned jobs = 0;               // 0: one per hardware thread
    bool overwrite = false;
    // Told now and then: frames done, of how many, and of the frame under way which part. May be empty.
    std::function<void(std::uint32_t done, std::uint32_t frames, double part)> progress;
    // Asked between bricks, from any thread: true ends it there. May be empty.
    std::function<bool()> stop;
};

struct BakeReport {
    std::vector<FrameEntry> frames;
    std::vector<std::string> channels;  // "light.0" ...: the i-th is of the scene's i-th light
    std::uint64_t output_bytes = 0;
    double seconds = 0;
};

// Writes the dataset `output`. What was there of each frame is copied byte by byte; "light.I" is the
// transmittance to the scene's light I (light_sampler.h) at the voxels of the first medium's density and one
// voxel around them, and 1 elsewhere. Nothing half-written is left behind an error. Errors: of the dataset
// and the scene; kInvalid (no light, no medium, baked before, `output` exists); kNotFound (a frame that is
// not there); kIo.
Result<BakeReport> bake(const BakeOptions& options);

}  // namespace brickyard

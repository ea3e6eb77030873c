// What `brickyard render` is told on its command line, and what that asks of a renderer.
#pragma once

#include <CLI/CLI.hpp>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "client/renderer.h"
#include "core/result.h"

namespace brickyard {

struct RenderOptions {
    std::string source, output, size = "640x480", camera, scene, quality = "final", cache = "1G", max_bytes,
                                token_file, tls_ca, explain;
    std::string over, over_depth = "plane", frames;
    std::string device = "cpu", filter, shadows, between = "advect";
    std::optional<double> frame;  // 12.5 lies between two
    std::optional<double> density_scale, max_error, deadline, follow;
    std::optional<std::uint32_t> rays;  // --spp
    std::uint64_t seed = 0;
    std::uint32_t bounces = RenderRequest().most_bounces;
    unsigned threads = 0, repeats = 0, samples = 1;
    bool strict = false, json = false;
};

void addRenderOptions(CLI::App& command, RenderOptions& options);

// Everything that the options say by themselves; no file is read. An error is wrong usage.
Result<RenderRequest> requestOf(const RenderOptions& options);

// Whether a number may be a frame's, or lie between two.
bool isFrame(double number);

// Edge of the regular grid of `--samples`: the request's picture is so many times as wide and as high.
std::uint32_t gridEdge(const RenderOptions& options);

// Reads what the options name: scene and camera. Errors: those of readScene() and readCamera().
Result<void> readSceneOptions(const RenderOptions& options, RenderRequest& request);
// Where relative names in a scene begin: beside its file; JSON on the command line begins where that does.
std::filesystem::path sceneFolder(const std::string& text_or_file);
// Errors: kNotFound.
Result<std::string> readToken(const std::string& file);

}  // namespace brickyard

#include "tools/render_options.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <sstream>

#include "tools/command.h"
#include "tools/frame_plan.h"
#include "tools/numbered_name.h"
#include "tools/quality_preset.h"

namespace brickyard {

namespace {

constexpr std::uint32_t kMaxEdge = 65536;
constexpr std::uint64_t kMaxPixels = 1ull << 28;
constexpr std::uint32_t kMaxSampleEdge = 16;
constexpr std::uint32_t kMaxRays = 65536;
constexpr std::uint32_t kMaxBounces = 65536;
// Paths a pixel where neither a number nor an error is asked for.
constexpr std::uint32_t kDefaultPaths = 64;
// What a frame's number is at most (frame_plan.h): any fraction of a frame is still told apart.
constexpr std::uint32_t kLastFrame = 999'999'999;

Result<void> parsePictureSize(const std::string& text, std::uint32_t& width, std::uint32_t& height) {
    const char* end = text.data() + text.size();
    const auto [x, error] = std::from_chars(text.data(), end, width);
    if (error == std::errc() && x != end && *x == 'x') {
        const auto [rest, error2] = std::from_chars(x + 1, end, height);
        if (error2 == std::errc() && rest == end && width > 0 && height > 0 && width <= kMaxEdge &&
            height <= kMaxEdge && std::uint64_t(width) * height <= kMaxPixels)
            return {};
    }
    return fail(ErrorCode::kInvalid,
                fmt::format("--size '{}': give WIDTHxHEIGHT, each from 1 to {}, at most 2^28 pixels", text,
                            kMaxEdge));
}

Result<void> checkGrid(const RenderOptions& options, std::uint32_t width, std::uint32_t height) {
    const std::uint32_t edge = gridEdge(options);
    if (edge * edge != options.samples)
        return fail(ErrorCode::kInvalid, fmt::format("--samples {}: give a square number, 1, 4, 9 ... {}",
                                                     options.samples, kMaxSampleEdge * kMaxSampleEdge));
    if (std::uint64_t(width) * edge > kMaxEdge || std::uint64_t(height) * edge > kMaxEdge ||
        std::uint64_t(width) * height * edge * edge > kMaxPixels)
        return fail(
            ErrorCode::kInvalid,
            fmt::format("--samples {}: is too many for {} x {} pixels; at most {} samples an edge and "
                        "2^28 in all",
                        options.samples, width, height, kMaxEdge));
    return {};
}

Result<QualitySettings> qualityOf(const RenderOptions& options) {
    // The command line lets no other name through. Paths end where `final` would.
    QualitySettings quality =
        qualityPreset(options.quality == "path" ? "final" : options.quality).value_or(QualitySettings());
    if (options.max_error) {
        if (!(*options.max_error > 0 && *options.max_error <= 1))
            return fail(ErrorCode::kInvalid,
                        fmt::format("--max-error {}: give a number above 0, at most 1", *options.max_error));
        quality = {.max_error = *options.max_error};
    }
    if (options.strict && options.quality == "path")
        return fail(ErrorCode::kInvalid,
                    "--strict: --quality path is an estimate and guarantees nothing; leave one of them out");
    if (options.strict && !options.max_error)
        return fail(ErrorCode::kInvalid, "--strict: give the bound with --max-error");
    quality.strict = options.strict;
    return quality;
}

// Rays and paths a pixel.
Result<void> chooseSamples(const RenderOptions& options, RenderRequest& request) {
    request.path = options.quality == "path";
    if (options.samples > 1 && (options.rays || request.path))
        return fail(ErrorCode::kInvalid,
                    fmt::format("--samples {} is a regular grid and goes with neither --spp nor --quality "
                                "path; give --spp",
                                options.samples));
    if (options.rays && (*options.rays < 1 || *options.rays > kMaxRays))
        return fail(ErrorCode::kInvalid,
                    fmt::format("--spp {}: give a number from 1 to {}", *options.rays, kMaxRays));
    if (options.rays)
        request.samples = *options.rays;
    else if (request.path)
        request.samples = options.max_error ? 0 : kDefaultPaths;
    request.seed = options.seed;
    request.most_bounces = options.bounces;
    return {};
}

Result<void> checkFrame(const RenderOptions& options) {
    if (!options.frame || isFrame(*options.frame)) return {};
    return fail(ErrorCode::kInvalid,
                fmt::format("--frame {}: give a number from 0 to {}", *options.frame, kLastFrame));
}

// Several pictures need several names.
Result<void> checkSequence(const RenderOptions& options) {
    if (!options.follow && options.frames.empty()) return {};
    const char* option = options.follow ? "--follow" : "--frames";
    if (options.frame)
        return fail(ErrorCode::kInvalid, fmt::format("{} says which frames; leave --frame out", option));
    if (options.follow && !options.frames.empty())
        return fail(ErrorCode::kInvalid, "--follow draws all frames; leave --frames out");
    if (!options.frames.empty())
        if (const Result<FrameSet> frames = FrameSet::parse(options.frames); !frames)
            return fail(ErrorCode::kInvalid, "--frames " + frames.error().message);
    if (!hasNumberPlace(options.output))
        return fail(ErrorCode::kInvalid,
                    fmt::format("-o {}: with {} a name has a place for the frame's number, for example "
                                "frame.%04d.png",
                                options.output, option));
    return {};
}

Result<void> checkFiles(const RenderOptions& options) {
    const std::filesystem::path output(options.output);
    if (!options.explain.empty() && std::filesystem::path(options.explain).extension() != ".exr")
        return fail(ErrorCode::kInvalid, fmt::format("--explain {}: name an .exr file", options.explain));
    if (!options.over.empty() && std::filesystem::path(options.over).extension() != ".exr")
        return fail(ErrorCode::kInvalid, fmt::format("--over {}: name an .exr file", options.over));
    if (output.extension() != ".exr" && output.extension() != ".png")
        return fail(ErrorCode::kInvalid, fmt::format("-o {}: name a .png or an .exr file", options.output));
    if (options.source.empty() && options.scene.empty())
        return fail(ErrorCode::kInvalid,
                    "name a dataset folder, ws://HOST:PORT/NAME, or a --scene that does");
    return {};
}

}  // namespace

bool isFrame(double number) { return number >= 0 && number <= kLastFrame; }

std::uint32_t gridEdge(const RenderOptions& options) {
    std::uint32_t edge = 1;
    while (edge < kMaxSampleEdge && edge * edge < options.samples) ++edge;
    return edge;
}

Result<RenderRequest> requestOf(const RenderOptions& options) {
    RenderRequest request;
    if (Result<void> size = parsePictureSize(options.size, request.width, request.height); !size)
        return tl::unexpected(size.error());
    const Result<QualitySettings> quality = qualityOf(options);
    if (!quality) return tl::unexpected(quality.error());
    request.quality = *quality;
    if (Result<void> grid = checkGrid(options, request.width, request.height); !grid)
        return tl::unexpected(grid.error());
    const std::uint32_t edge = gridEdge(options);
    request.width *= edge;
    request.height *= edge;
    // A preset counts the picture's pixels, not their samples.
    request.quality.pixels_per_voxel *= double(edge);
    if (Result<void> chosen = chooseSamples(options, request); !chosen) return tl::unexpected(chosen.error());
    const Result<std::uint64_t> cache = parseSize(options.cache);
    if (!cache) return tl::unexpected(cache.error());
    request.cache_bytes = *cache;
    if (!options.max_bytes.empty()) {
        const Result<std::uint64_t> bytes = parseSize(options.max_bytes);
        if (!bytes) return tl::unexpected(bytes.error());
        request.max_stream_bytes = *bytes;
    }
    if (options.deadline) {
        if (!(*options.deadline > 0 && *options.deadline < 1e9))
            return fail(ErrorCode::kInvalid, "--deadline: give seconds above 0");
        request.deadline = std::chrono::duration<double>(*options.deadline);
    }
    if (options.density_scale) {
        if (!(*options.density_scale >= 0) || !std::isfinite(*options.density_scale))
            return fail(ErrorCode::kInvalid, "--density-scale: give a number of at least 0");
        request.density_scale = options.density_scale;
    }
    if (options.device != "cpu")
        return fail(
            ErrorCode::kUnsupported,
            fmt::format("--device {}: this build renders on the CPU; use --device cpu", options.device));
    for (const auto& check : {checkFrame, checkSequence, checkFiles})
        if (Result<void> checked = check(options); !checked) return tl::unexpected(checked.error());
    // The command line lets no other names through.
    if (!options.filter.empty()) request.filter = fieldFilter(options.filter);
    if (!options.shadows.empty()) request.shadows = shadowMethod(options.shadows);
    request.between_by = options.between == "blend" ? BetweenFrames::kBlend : BetweenFrames::kAdvect;
    request.threads = options.threads;
    request.repeats = options.repeats;
    request.explain = !options.explain.empty();
    return request;
}

Result<void> readSceneOptions(const RenderOptions& options, RenderRequest& request) {
    if (!options.scene.empty()) {
        Result<Scene> scene = readScene(options.scene);
        if (!scene) return tl::unexpected(scene.error());
        request.scene = std::move(*scene);
        request.folder = sceneFolder(options.scene);
    }
    if (!options.camera.empty()) {
        Result<Camera> camera = readCamera(options.camera);
        if (!camera) return tl::unexpected(camera.error());
        request.camera = std::move(*camera);
    }
    return {};
}

std::filesystem::path sceneFolder(const std::string& text_or_file) {
    const std::size_t first = text_or_file.find_first_not_of(" \t\r\n");
    if (first == std::string::npos || text_or_file[first] == '{') return {};
    return std::filesystem::path(text_or_file).parent_path();
}

Result<std::string> readToken(const std::string& file) {
    if (file.empty()) return std::string();
    // The server's own file will do: a line each, the token first.
    std::ifstream in(file);
    for (std::string line; std::getline(in, line);) {
        std::istringstream words(line);
        if (std::string token; words >> token && token.front() != '#') return token;
    }
    return fail(ErrorCode::kNotFound, fmt::format("--token-file {}: cannot be read, or is empty", file));
}

void addRenderOptions(CLI::App& command, RenderOptions& options) {
    command.add_option("SOURCE", options.source,
                       "Dataset folder, or ws://HOST:PORT/NAME; in place of the scene's first dataset");
    command
        .add_option("-o,--output", options.output,
                    "OUT.png (sRGB over the background) or OUT.exr (linear, with Z and error layers)")
        ->required();
    command.add_option("--frame", options.frame,
                       "Frame number, also between two: 12.5; the scene's, or the first there is");
    command
        .add_option("--frames", options.frames,
                    "Draw these frames, one after the other: 10-19, or 1,5,10-20x2; the output's name has a "
                    "place for the number, %04d")
        ->type_name("LIST");
    command
        .add_option("--between", options.between,
                    "How two frames become one in between: advect (along a velocity channel) or blend")
        ->check(CLI::IsMember({"advect", "blend"}))
        ->capture_default_str();
    command
        .add_option(
            "--follow", options.follow,
            "Draw every frame there is and each that comes, until none has come for so many seconds; the "
            "output's name has a place for the number, %04d")
        ->check(CLI::Range(0.1, 1e6));
    command.add_option("--size", options.size, "WIDTHxHEIGHT in pixels")->capture_default_str();
    command.add_option("--camera", options.camera,
                       "File or JSON: eye, target, up, vertical_fov_degrees; without one all is framed");
    command.add_option("--scene", options.scene,
                       "File or JSON: media, lights, surfaces, background, datasets ... (docs/scene.md)");
    command.add_option("--density-scale", options.density_scale,
                       "Extinction per world unit of a density of 1");
    command
        .add_option(
            "--quality", options.quality,
            "draft, preview, final, reference (exact, the finest level) or path (multiple scattering)")
        ->check(CLI::IsMember({"draft", "preview", "final", "reference", "path"}))
        ->capture_default_str();
    command.add_option("--max-error", options.max_error,
                       "Refine every pixel until hardly one is off by this; wins over --quality");
    command
        .add_option("--samples", options.samples,
                    "Samples per pixel on a regular grid, a square number; the pixel is their mean")
        ->capture_default_str();
    command.add_option("--spp", options.rays,
                       "Stratified rays per pixel, 1 to 65536; with --quality path 64, or as many as "
                       "--max-error needs");
    command
        .add_option("--bounces", options.bounces,
                    "Of a path, after the first scattering; 0: light that is scattered once")
        ->check(CLI::Range(0u, kMaxBounces))
        ->capture_default_str();
    command.add_option("--seed", options.seed, "Of what is random: another picture of the same noise")
        ->capture_default_str();
    command
        .add_option(
            "--filter", options.filter,
            "Between samples: nearest, trilinear, bspline, catmull-rom, mitchell, gaussian; wins over "
            "the scene's")
        ->check(CLI::IsMember({"nearest", "trilinear", "bspline", "catmull-rom", "mitchell", "gaussian"}));
    command
        .add_option("--shadows", options.shadows,
                    "Of lights that do not say: exact, deep, baked (see `brickyard bake`), none")
        ->check(CLI::IsMember({"exact", "deep", "baked", "none"}));
    command.add_option(
        "--over", options.over,
        "IMAGE.exr of the picture's size: rays end at its depth Z, and what is drawn goes over it; "
        "with %04d one for each frame");
    command
        .add_option("--over-depth", options.over_depth,
                    "What the image's Z is: plane (along the camera's axis), or ray (distance from the eye)")
        ->check(CLI::IsMember({"plane", "ray"}))
        ->capture_default_str();
    command.add_flag("--strict", options.strict, "Make --max-error a guarantee");
    command.add_option("--deadline", options.deadline, "Seconds; the best picture by then");
    command.add_option("--max-bytes", options.max_bytes,
                       "Stream at most this, e.g. 2M; the best picture for it");
    command.add_option("--cache", options.cache, "Page cache, e.g. 256M")->capture_default_str();
    command.add_option("--device", options.device, "cpu")
        ->check(CLI::IsMember({"cpu", "gpu"}))
        ->capture_default_str();
    command.add_option("--threads", options.threads, "Ray threads, at most 1024; one per processor")
        ->check(CLI::Range(0, 1024));
    command.add_option(
        "--explain", options.explain,
        "WHY.exr: per pixel the level drawn, and how much is queued, over budget, failed, without "
        "finer data");
    command.add_option(
        "--repeat", options.repeats,
        "Trace a final picture N times more, all pages resident; seconds_render is their median");
    command.add_option("--token-file", options.token_file, "File whose first word is the server's token");
    command.add_option("--tls-ca", options.tls_ca,
                       "Of wss://: believe the certificates in this PEM file instead of this machine's");
    command.add_flag("--json", options.json, "One JSON object on stdout and nothing else");
}

}  // namespace brickyard

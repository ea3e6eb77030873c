// `brickyard render`: a picture from a dataset folder or a server.

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "client/brick_source.h"
#include "client/picture.h"
#include "client/renderer.h"
#include "core/dataset.h"
#include "tools/command.h"
#include "tools/progress_line.h"
#include "tools/quality_preset.h"
#include "tools/stop_signal.h"

namespace brickyard {

namespace {

constexpr std::uint32_t kMaxEdge = 65536;
constexpr std::uint64_t kMaxPixels = 1ull << 28;
constexpr std::uint32_t kMaxSampleEdge = 16;

struct RenderOptions {
    std::string source, output, size = "640x480", camera, scene, quality = "final", cache = "1G", max_bytes,
                                token_file, tls_ca, explain;
    std::string device = "cpu";
    std::optional<std::uint32_t> frame;
    std::optional<double> density_scale, max_error, deadline, follow;
    unsigned threads = 0, repeats = 0, samples = 1;
    bool strict = false, json = false;
};

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

// `--samples 16` is a picture of 4 times the width and height, filtered down. Gives that 4.
Result<std::uint32_t> sampleEdge(const RenderOptions& options, std::uint32_t width, std::uint32_t height) {
    std::uint32_t edge = 1;
    while (edge < kMaxSampleEdge && edge * edge < options.samples) ++edge;
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
    return edge;
}

Result<QualitySettings> qualityOf(const RenderOptions& options) {
    // The command line lets no other name through.
    QualitySettings quality = qualityPreset(options.quality).value_or(QualitySettings());
    if (options.max_error) {
        if (!(*options.max_error > 0 && *options.max_error <= 1))
            return fail(ErrorCode::kInvalid,
                        fmt::format("--max-error {}: give a number above 0, at most 1", *options.max_error));
        quality = {.max_error = *options.max_error};
    }
    if (options.strict && !options.max_error)
        return fail(ErrorCode::kInvalid, "--strict: give the bound with --max-error");
    quality.strict = options.strict;
    return quality;
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

// The frame asked for, or the first there is.
Result<std::uint32_t> chooseFrame(const Manifest& manifest, const RenderOptions& options) {
    if (manifest.frames_size() == 0)
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: has no frames; convert some into it", options.source));
    if (!options.frame) return manifest.frames(0).frame();
    return *options.frame;
}

// Opening a source is part of a picture that has a deadline.
StreamTimeouts timeoutsOf(const RenderRequest& request) {
    StreamTimeouts timeouts;
    if (!request.deadline) return timeouts;
    // Half for the connection, the rest for the first answer.
    const auto half = std::chrono::duration_cast<std::chrono::milliseconds>(*request.deadline / 2);
    timeouts.connect = std::clamp(half, std::chrono::milliseconds(1), timeouts.connect);
    return timeouts;
}

nlohmann::json toJson(const RenderOutcome& outcome) {
    double max_bound = 0, sum_bound = 0, max_estimate = 0, sum_estimate = 0, alpha = 0;
    double max_alpha_bound = 0, max_alpha_estimate = 0;
    for (const Pixel& p : outcome.picture.pixels) {
        const double bound = double(std::max(p.bound_alpha, p.bound_radiance));
        const double estimate = double(std::max(p.estimate_alpha, p.estimate_radiance));
        max_bound = std::max(max_bound, bound);
        max_estimate = std::max(max_estimate, estimate);
        max_alpha_bound = std::max(max_alpha_bound, double(p.bound_alpha));
        max_alpha_estimate = std::max(max_alpha_estimate, double(p.estimate_alpha));
        sum_bound += bound;
        sum_estimate += estimate;
        alpha += double(p.alpha);
    }
    const double pixels = double(outcome.picture.pixels.size());
    const Camera& camera = outcome.camera;
    return {
        {"seconds_total", outcome.seconds_total},
        {"seconds_first_image", outcome.seconds_first_image},
        {"seconds_render", outcome.seconds_render},
        {"bytes_streamed", outcome.streamed.bytes_streamed},
        {"pages_streamed", outcome.streamed.pages_streamed},
        {"tree_blocks_streamed", outcome.streamed.blocks_streamed},
        {"round_trips", outcome.streamed.round_trips},
        {"reconnects", outcome.streamed.reconnects},
        {"pages_retried", outcome.retried},
        {"cache_bytes", outcome.cache_bytes},
        {"cache_reloads", outcome.cache.reloads},
        {"light_bytes", outcome.light_bytes},
        {"tree_bytes", outcome.tree_bytes},
        {"passes", outcome.passes},
        {"max_error_bound", max_bound},
        {"mean_error_bound", sum_bound / pixels},
        {"max_error_estimate", max_estimate},
        {"mean_error_estimate", sum_estimate / pixels},
        {"max_alpha_error_bound", max_alpha_bound},
        {"max_alpha_error_estimate", max_alpha_estimate},
        {"mean_alpha", alpha / pixels},
        {"final", outcome.final},
        {"not_final",
         {{"queued", outcome.not_final.queued},
          {"over_budget", outcome.not_final.over_budget},
          {"failed", outcome.not_final.failed},
          {"no_finer_data", outcome.not_final.no_finer_data}}},
        {"first_failure", outcome.first_failure},
        {"width", outcome.picture.width},
        {"height", outcome.picture.height},
        {"camera",
         {{"eye", std::vector<double>(camera.eye().begin(), camera.eye().end())},
          {"target", std::vector<double>(camera.target().begin(), camera.target().end())},
          {"up", std::vector<double>(camera.up().begin(), camera.up().end())},
          {"vertical_fov_degrees", camera.vertical_fov_degrees()}}},
    };
}

// "frame.%04d.png" for frame 7 is "frame.0007.png"; a name without a place is itself.
std::filesystem::path framePath(const std::string& pattern, std::uint32_t frame) {
    const auto place = pattern.find('%');
    const auto end = pattern.find('d', place);
    if (place == std::string::npos || end == std::string::npos) return pattern;
    std::size_t digits = 0;
    for (const char c : pattern.substr(place + 1, end - place - 1)) {
        if (c < '0' || c > '9' || digits > 20) return pattern;
        digits = digits * 10 + std::size_t(c - '0');
    }
    std::string number = std::to_string(frame);
    if (number.size() < digits) number.insert(0, digits - number.size(), '0');
    return pattern.substr(0, place) + number + pattern.substr(end + 1);
}

// Everything that the options say by themselves. An error is wrong usage.
Result<RenderRequest> requestOf(const RenderOptions& options) {
    RenderRequest request;
    if (Result<void> size = parsePictureSize(options.size, request.width, request.height); !size)
        return tl::unexpected(size.error());
    const Result<QualitySettings> quality = qualityOf(options);
    if (!quality) return tl::unexpected(quality.error());
    request.quality = *quality;
    const Result<std::uint32_t> edge = sampleEdge(options, request.width, request.height);
    if (!edge) return tl::unexpected(edge.error());
    request.width *= *edge;
    request.height *= *edge;
    // A preset counts the picture's pixels, not their samples.
    request.quality.pixels_per_voxel *= double(*edge);
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
    if (options.follow && options.frame)
        return fail(ErrorCode::kInvalid, "--follow draws all frames; leave --frame out");
    if (options.follow && framePath(options.output, 0) == framePath(options.output, 1))
        return fail(ErrorCode::kInvalid,
                    fmt::format("-o {}: with --follow a name has a place for the frame's number, for example "
                                "frame.%04d.png",
                                options.output));
    request.threads = options.threads;
    request.repeats = options.repeats;
    request.explain = !options.explain.empty();
    const std::filesystem::path output(options.output);
    if (!options.explain.empty() && std::filesystem::path(options.explain).extension() != ".exr")
        return fail(ErrorCode::kInvalid, fmt::format("--explain {}: name an .exr file", options.explain));
    if (output.extension() != ".exr" && output.extension() != ".png")
        return fail(ErrorCode::kInvalid, fmt::format("-o {}: name a .png or an .exr file", options.output));
    return request;
}

// The picture of one frame, drawn and written.
Result<RenderOutcome> drawFrame(BrickSource& source, const RenderOptions& options, RenderRequest request,
                                const std::filesystem::path& output) {
    ProgressLine line;
    request.progress = [&](std::uint64_t done, std::uint64_t pixels, std::uint64_t bytes) {
        line.show(fmt::format("{} of {} pixels final", done, pixels), double(done) / double(pixels), bytes);
    };
    Result<RenderOutcome> outcome = makeCpuRenderer()->render(source, request);
    line.clear();
    if (!outcome) return outcome;
    if (request.explain)
        if (Result<void> told = writeExplanation(outcome->picture.width, outcome->picture.height,
                                                 outcome->why, options.explain);
            !told)
            return tl::unexpected(told.error());
    if (options.samples > 1) {
        const auto edge = std::uint32_t(std::lround(std::sqrt(options.samples)));
        outcome->picture = boxFiltered(outcome->picture, edge);
    }
    const Result<void> written = output.extension() == ".exr"
                                     ? writeExr(outcome->picture, output)
                                     : writePng(outcome->picture, outcome->background, output);
    if (!written) return tl::unexpected(written.error());
    return outcome;
}

// Tells of one picture; gives the exit status.
int report(const RenderOptions& options, const RenderOutcome& outcome, const std::filesystem::path& output) {
    const nlohmann::json json = toJson(outcome);
    if (options.json) {
        fmt::print("{}\n", json.dump());
    } else {
        fmt::print(
            "{}: {} x {}, {}; expected error {:.2g} (largest {:.2g}), at most {:.2g}; {:.2f} s, {} pages, "
            "{:.2f} MB\n",
            output.string(), outcome.picture.width, outcome.picture.height,
            outcome.final ? "final" : "not final", json["mean_error_estimate"].get<double>(),
            json["max_error_estimate"].get<double>(), json["max_error_bound"].get<double>(),
            outcome.seconds_total, outcome.streamed.pages_streamed,
            double(outcome.streamed.bytes_streamed) / 1e6);
    }
    std::fflush(stdout);
    if (outcome.not_final.failed > 0)
        return reportError(
            "render", {ErrorCode::kCorrupt,
                       fmt::format("{} pages could not be had and are drawn from coarser ones; first: {}",
                                   outcome.not_final.failed, outcome.first_failure)});
    return kExitDone;
}

// Draws every frame there is, and each that comes, until none has come for so long.
Result<int> followFrames(BrickSource& source, const RenderOptions& options, const RenderRequest& request) {
    const StopSignal stop;
    int status = kExitDone;
    std::set<std::uint32_t> drawn;
    for (auto last_news = std::chrono::steady_clock::now();;) {
        const std::shared_ptr<const Manifest> manifest = source.latestManifest();
        for (const FrameEntry& entry : manifest->frames()) {
            if (StopSignal::received() != 0) return status;
            if (!drawn.insert(entry.frame()).second) continue;
            RenderRequest one = request;
            one.frame = entry.frame();
            const auto output = framePath(options.output, entry.frame());
            const Result<RenderOutcome> outcome = drawFrame(source, options, std::move(one), output);
            if (!outcome) return tl::unexpected(outcome.error());
            status = std::max(status, report(options, *outcome, output));
            last_news = std::chrono::steady_clock::now();
        }
        const auto until = last_news + std::chrono::duration_cast<std::chrono::milliseconds>(
                                           std::chrono::duration<double>(*options.follow));
        const auto now = std::chrono::steady_clock::now();
        if (now >= until || StopSignal::received() != 0) return status;
        // Not longer at a time, so that Ctrl-C is noticed.
        const auto news = source.waitForChange(std::min(until, now + std::chrono::milliseconds(200)));
        if (!news) return tl::unexpected(news.error());
    }
}

// Everything but what the options say by themselves. Gives the exit status.
Result<int> render(const RenderOptions& options, RenderRequest request) {
    // Where the picture goes is checked before anything is drawn.
    const std::filesystem::path output(options.output);
    std::error_code ignored;
    if (output.has_parent_path() && !std::filesystem::is_directory(output.parent_path(), ignored))
        return fail(ErrorCode::kNotFound,
                    fmt::format("-o {}: its folder does not exist; make it first", options.output));

    if (!options.scene.empty()) {
        Result<Scene> scene = readScene(options.scene);
        if (!scene) return tl::unexpected(scene.error());
        request.scene = std::move(*scene);
    }
    if (!options.camera.empty()) {
        Result<Camera> camera = readCamera(options.camera);
        if (!camera) return tl::unexpected(camera.error());
        request.camera = std::move(*camera);
    }
    const Result<std::string> token = readToken(options.token_file);
    if (!token) return tl::unexpected(token.error());

    const auto begin = std::chrono::steady_clock::now();
    const Result<std::unique_ptr<BrickSource>> source = openSource(
        options.source, {*token, options.tls_ca}, startHint(request, options.frame), timeoutsOf(request));
    if (!source) return tl::unexpected(source.error());
    if (options.follow) return followFrames(**source, options, request);
    if (request.deadline) *request.deadline -= std::chrono::steady_clock::now() - begin;
    const Result<std::uint32_t> frame = chooseFrame((*source)->manifest(), options);
    if (!frame) return tl::unexpected(frame.error());
    request.frame = *frame;
    const Result<RenderOutcome> outcome = drawFrame(**source, options, std::move(request), output);
    if (!outcome) return tl::unexpected(outcome.error());
    return report(options, *outcome, output);
}

int runRender(const RenderOptions& options) {
    Result<RenderRequest> request = requestOf(options);
    if (!request) {
        reportError("render", request.error());
        return kExitUsage;
    }
    const Result<int> status = render(options, std::move(*request));
    return status ? *status : reportError("render", status.error());
}

}  // namespace

void addRenderCommand(CLI::App& app, int& status) {
    auto options = std::make_shared<RenderOptions>();
    CLI::App* command = app.add_subcommand(
        "render",
        "Draw a picture of a dataset folder or of a server's: ws://HOST:PORT/NAME, or wss:// for TLS");
    command->add_option("SOURCE", options->source, "Dataset folder, or ws://HOST:PORT/NAME")->required();
    command
        ->add_option("-o,--output", options->output,
                     "OUT.png (sRGB over the background) or OUT.exr (linear, with Z and error layers)")
        ->required();
    command->add_option("--frame", options->frame, "Frame number; the first there is");
    command
        ->add_option(
            "--follow", options->follow,
            "Draw every frame there is and each that comes, until none has come for so many seconds; the "
            "output's name has a place for the number, %04d")
        ->check(CLI::Range(0.1, 1e6));
    command->add_option("--size", options->size, "WIDTHxHEIGHT in pixels")->capture_default_str();
    command->add_option("--camera", options->camera,
                        "File or JSON: eye, target, up, vertical_fov_degrees; without one all is framed");
    command->add_option("--scene", options->scene, "File or JSON: medium, light, background (docs/scene.md)");
    command->add_option("--density-scale", options->density_scale,
                        "Extinction per world unit of a density of 1");
    command
        ->add_option("--quality", options->quality,
                     "draft, preview, final or reference (exact, the finest level)")
        ->check(CLI::IsMember({"draft", "preview", "final", "reference"}))
        ->capture_default_str();
    command->add_option("--max-error", options->max_error,
                        "Refine every pixel until hardly one is off by this; wins over --quality");
    command
        ->add_option("--samples", options->samples,
                     "Samples per pixel, a square number; the pixel is their mean")
        ->capture_default_str();
    command->add_flag("--strict", options->strict, "Make --max-error a guarantee");
    command->add_option("--deadline", options->deadline, "Seconds; the best picture by then");
    command->add_option("--max-bytes", options->max_bytes,
                        "Stream at most this, e.g. 2M; the best picture for it");
    command->add_option("--cache", options->cache, "Page cache, e.g. 256M")->capture_default_str();
    command->add_option("--device", options->device, "cpu")
        ->check(CLI::IsMember({"cpu", "gpu"}))
        ->capture_default_str();
    command->add_option("--threads", options->threads, "Ray threads; one per processor");
    command->add_option(
        "--explain", options->explain,
        "WHY.exr: per pixel the level drawn, and how much is queued, over budget, failed, without "
        "finer data");
    command->add_option(
        "--repeat", options->repeats,
        "Trace a final picture N times more, all pages resident; seconds_render is their median");
    command->add_option("--token-file", options->token_file, "File whose first word is the server's token");
    command->add_option("--tls-ca", options->tls_ca,
                        "Of wss://: believe the certificates in this PEM file instead of this machine's");
    command->add_flag("--json", options->json, "One JSON object on stdout and nothing else");
    command->callback([options, &status] { status = runRender(*options); });
}

}  // namespace brickyard

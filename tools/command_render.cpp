// `brickyard render`: a picture from a dataset folder or a server.

#include <fmt/format.h>

#include <filesystem>
#include <map>
#include <set>

#include "client/picture.h"
#include "client/picture_over.h"
#include "client/renderer.h"
#include "tools/command.h"
#include "tools/frame_plan.h"
#include "tools/numbered_name.h"
#include "tools/progress_line.h"
#include "tools/render_options.h"
#include "tools/render_report.h"
#include "tools/render_sources.h"
#include "tools/stop_signal.h"

namespace brickyard {

namespace {

// The files of one picture; in a sequence with its number.
struct PictureFiles {
    std::filesystem::path output, over, explain;
    explicit PictureFiles(const RenderOptions& options)
        : output(options.output), over(options.over), explain(options.explain) {}
    PictureFiles(const RenderOptions& options, std::uint32_t number)
        : output(numberedName(options.output, number)),
          over(numberedName(options.over, number)),
          explain(numberedName(options.explain, number)) {}
};

// What stands behind a picture: as it was read, for the composite, and as rays see it.
struct Behind {
    Picture image, for_rays;
};

Result<std::optional<Behind>> readBehind(const std::filesystem::path& file, const RenderOptions& options,
                                         const RenderRequest& request) {
    if (file.empty()) return std::nullopt;
    const std::uint32_t edge = gridEdge(options);
    Result<Picture> image = readExr(file);
    if (!image) return tl::unexpected(image.error());
    if (image->width * edge != request.width || image->height * edge != request.height)
        return fail(ErrorCode::kInvalid,
                    fmt::format("--over {}: is {} x {} pixels, the picture {} x {}; give --size {}x{}",
                                file.string(), image->width, image->height, request.width / edge,
                                request.height / edge, image->width, image->height));
    const bool plane = options.over_depth == "plane";
    if (plane && !request.camera && !request.scene.has_camera())
        return fail(
            ErrorCode::kInvalid,
            fmt::format("--over {}: its depth is along the axis of its camera; give that with --camera "
                        "or in the scene",
                        file.string()));
    const auto placeDepth = [&](Picture& picture) -> Result<void> {
        if (!plane) {
            toRayDepth(picture, DepthKind::kRay, nullptr);
            return {};
        }
        const Camera& camera = request.camera ? *request.camera : request.scene.camera();
        const Result<PinholeCamera> placed = PinholeCamera::create(camera, picture.width, picture.height);
        if (!placed) return tl::unexpected(placed.error());
        toRayDepth(picture, DepthKind::kPlane, &*placed);
        return {};
    };
    Behind behind{std::move(*image), {}};
    behind.for_rays = enlarged(behind.image, edge);
    for (Picture* picture : {&behind.image, &behind.for_rays})
        if (Result<void> placed = placeDepth(*picture); !placed) return tl::unexpected(placed.error());
    return std::optional<Behind>(std::move(behind));
}

// The picture of one frame, drawn and written.
Result<RenderOutcome> drawFrame(BrickSource& source, const RenderOptions& options, RenderRequest request,
                                const PictureFiles& files) {
    const Result<std::optional<Behind>> behind = readBehind(files.over, options, request);
    if (!behind) return tl::unexpected(behind.error());
    if (*behind) request.behind = &(*behind)->for_rays;
    // A sequence's pictures may stream so much each.
    if (request.max_stream_bytes < UINT64_MAX - source.counters().bytes_streamed)
        request.max_stream_bytes += source.counters().bytes_streamed;
    ProgressLine line;
    request.progress = [&](std::uint64_t done, std::uint64_t pixels, std::uint64_t bytes) {
        line.show(fmt::format("{} of {} pixels final", done, pixels), double(done) / double(pixels), bytes);
    };
    Result<RenderOutcome> outcome = makeCpuRenderer()->render(source, request);
    line.clear();
    if (!outcome) return outcome;
    if (request.explain)
        if (Result<void> told = writeExplanation(outcome->picture.width, outcome->picture.height,
                                                 outcome->why, files.explain);
            !told)
            return tl::unexpected(told.error());
    if (options.samples > 1) outcome->picture = boxFiltered(outcome->picture, gridEdge(options));
    if (*behind) composeOver(outcome->picture, (*behind)->image);
    const Result<void> written = files.output.extension() == ".exr"
                                     ? writeExr(outcome->picture, files.output)
                                     : writePng(outcome->picture, outcome->background, files.output);
    if (!written) return tl::unexpected(written.error());
    return outcome;
}

// Draws every frame there is, and each that comes, until none has come for so long.
Result<int> followFrames(RenderSources& sources, const RenderOptions& options, const RenderRequest& request) {
    const StopSignal stop;
    int status = kExitDone;
    std::set<std::uint32_t> drawn;
    for (auto last_news = std::chrono::steady_clock::now();;) {
        const std::shared_ptr<const Manifest> manifest = sources.first().latestManifest();
        for (const FrameEntry& entry : manifest->frames()) {
            if (StopSignal::received() != 0) return status;
            if (!drawn.insert(entry.frame()).second) continue;
            RenderRequest one = request;
            const Result<double> frame = sources.sceneFrame(entry.frame());
            if (!frame) return tl::unexpected(frame.error());
            if (Result<void> chosen = sources.choose(*frame, one); !chosen)
                return tl::unexpected(chosen.error());
            const PictureFiles files(options, entry.frame());
            const Result<RenderOutcome> outcome = drawFrame(sources.first(), options, std::move(one), files);
            if (!outcome) return tl::unexpected(outcome.error());
            status = std::max(status, reportPicture(*outcome, files.output, options.json));
            last_news = std::chrono::steady_clock::now();
        }
        const auto until = last_news + std::chrono::duration_cast<std::chrono::milliseconds>(
                                           std::chrono::duration<double>(*options.follow));
        const auto now = std::chrono::steady_clock::now();
        if (now >= until || StopSignal::received() != 0) return status;
        // Not longer at a time, so that Ctrl-C is noticed.
        const auto news =
            sources.first().waitForChange(std::min(until, now + std::chrono::milliseconds(200)));
        if (!news) return tl::unexpected(news.error());
    }
}

// Draws the frames that were asked for; all of them are there, or nothing is drawn.
Result<int> drawFrames(RenderSources& sources, const RenderOptions& options, const RenderRequest& request) {
    const Result<FrameSet> wanted = FrameSet::parse(options.frames);
    if (!wanted) return tl::unexpected(wanted.error());
    const Manifest& manifest = sources.first().manifest();
    std::map<std::uint32_t, double> frames;  // the first dataset's, and the scene's
    std::set<std::uint32_t> there;
    for (const FrameEntry& entry : manifest.frames()) {
        const Result<double> of_scene = sources.sceneFrame(entry.frame());
        if (!of_scene || !wanted->contains(std::uint32_t(*of_scene))) continue;
        frames.emplace(entry.frame(), *of_scene);
        there.insert(std::uint32_t(*of_scene));
    }
    // Says which are missing, and of which dataset.
    if (const std::optional<std::uint32_t> missing = wanted->firstMissing(there)) {
        if (Result<void> found = sources.requireFrame(*missing); !found) return tl::unexpected(found.error());
    }
    for (const auto& [frame, of_scene] : frames)
        if (Result<void> found = sources.requireFrame(of_scene); !found) return tl::unexpected(found.error());

    const StopSignal stop;
    int status = kExitDone;
    for (const auto& [frame, of_scene] : frames) {
        if (StopSignal::received() != 0) return status;
        RenderRequest one = request;
        if (Result<void> chosen = sources.choose(of_scene, one); !chosen)
            return tl::unexpected(chosen.error());
        const PictureFiles files(options, std::uint32_t(of_scene));
        const Result<RenderOutcome> outcome = drawFrame(sources.first(), options, std::move(one), files);
        if (!outcome) return tl::unexpected(outcome.error());
        status = std::max(status, reportPicture(*outcome, files.output, options.json));
    }
    return status;
}

// Everything but what the options say by themselves. Gives the exit status.
Result<int> render(const RenderOptions& options, RenderRequest request) {
    // Where the picture goes is checked before anything is drawn.
    const std::filesystem::path output(options.output);
    std::error_code ignored;
    if (output.has_parent_path() && !std::filesystem::is_directory(output.parent_path(), ignored))
        return fail(ErrorCode::kNotFound,
                    fmt::format("-o {}: its folder does not exist; make it first", options.output));
    if (Result<void> read = readSceneOptions(options, request); !read) return tl::unexpected(read.error());
    const Result<std::string> token = readToken(options.token_file);
    if (!token) return tl::unexpected(token.error());

    const auto begin = std::chrono::steady_clock::now();
    std::optional<double> frame = options.frame;
    const bool sequence = options.follow || !options.frames.empty();
    if (!frame && request.scene.has_frame() && !sequence) {
        frame = request.scene.frame();
        if (!isFrame(*frame))
            return fail(ErrorCode::kInvalid,
                        fmt::format("scene: frame is {}; give a number of at least 0", *frame));
    }
    Result<RenderSources> sources =
        RenderSources::open(options.source, {*token, options.tls_ca}, request, frame);
    if (!sources) return tl::unexpected(sources.error());
    if (options.follow) return followFrames(*sources, options, request);
    if (sequence) return drawFrames(*sources, options, request);
    if (!frame) {
        const Result<double> first = sources->firstFrame();
        if (!first) return tl::unexpected(first.error());
        frame = *first;
    }
    if (Result<void> chosen = sources->choose(*frame, request); !chosen)
        return tl::unexpected(chosen.error());
    if (request.deadline) *request.deadline -= std::chrono::steady_clock::now() - begin;
    const Result<RenderOutcome> outcome =
        drawFrame(sources->first(), options, std::move(request), PictureFiles(options));
    if (!outcome) return tl::unexpected(outcome.error());
    return reportPicture(*outcome, output, options.json);
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
    addRenderOptions(*command, *options);
    command->callback([options, &status] { status = runRender(*options); });
}

}  // namespace brickyard

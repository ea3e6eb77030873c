// `brickyard render`: a picture from a dataset folder or a server.

#include <fmt/format.h>

#include <filesystem>
#include <set>

#include "client/picture.h"
#include "client/renderer.h"
#include "tools/command.h"
#include "tools/numbered_name.h"
#include "tools/progress_line.h"
#include "tools/render_options.h"
#include "tools/render_report.h"
#include "tools/render_sources.h"
#include "tools/stop_signal.h"

namespace brickyard {

namespace {

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
    if (options.samples > 1) outcome->picture = boxFiltered(outcome->picture, gridEdge(options));
    const Result<void> written = output.extension() == ".exr"
                                     ? writeExr(outcome->picture, output)
                                     : writePng(outcome->picture, outcome->background, output);
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
            const auto output = numberedName(options.output, entry.frame());
            const Result<RenderOutcome> outcome = drawFrame(sources.first(), options, std::move(one), output);
            if (!outcome) return tl::unexpected(outcome.error());
            status = std::max(status, reportPicture(*outcome, output, options.json));
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
    if (!frame && request.scene.has_frame() && !options.follow) {
        frame = request.scene.frame();
        if (!isFrame(*frame))
            return fail(ErrorCode::kInvalid,
                        fmt::format("scene: frame is {}; give a number of at least 0", *frame));
    }
    Result<RenderSources> sources =
        RenderSources::open(options.source, {*token, options.tls_ca}, request, frame);
    if (!sources) return tl::unexpected(sources.error());
    if (options.follow) return followFrames(*sources, options, request);
    if (!frame) {
        const Result<double> first = sources->firstFrame();
        if (!first) return tl::unexpected(first.error());
        frame = *first;
    }
    if (Result<void> chosen = sources->choose(*frame, request); !chosen)
        return tl::unexpected(chosen.error());
    if (request.deadline) *request.deadline -= std::chrono::steady_clock::now() - begin;
    const Result<RenderOutcome> outcome = drawFrame(sources->first(), options, std::move(request), output);
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

// `brickyard render`: a picture from a dataset folder or a server.

#include <fmt/format.h>

#include <filesystem>

#include "client/renderer.h"
#include "tools/command.h"
#include "tools/render_options.h"
#include "tools/render_picture.h"
#include "tools/render_report.h"
#include "tools/render_sequence.h"
#include "tools/render_sources.h"

namespace brickyard {

namespace {

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
        drawPicture(sources->first(), options, std::move(request), PictureFiles(options));
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

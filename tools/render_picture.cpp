#include "tools/render_picture.h"

#include <fmt/format.h>

#include <optional>

#include "client/picture.h"
#include "client/picture_over.h"
#include "tools/numbered_name.h"
#include "tools/progress_line.h"

namespace brickyard {

namespace {

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

}  // namespace

PictureFiles::PictureFiles(const RenderOptions& options)
    : output(options.output), over(options.over), explain(options.explain) {}

PictureFiles::PictureFiles(const RenderOptions& options, std::uint32_t number)
    : output(numberedName(options.output, number)),
      over(numberedName(options.over, number)),
      explain(numberedName(options.explain, number)) {}

Result<RenderOutcome> drawPicture(BrickSource& source, const RenderOptions& options, RenderRequest request,
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

}  // namespace brickyard

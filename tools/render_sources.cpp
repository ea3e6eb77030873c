#include "tools/render_sources.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "core/dataset.h"

namespace brickyard {

namespace {

// Opening a source is part of a picture that has a deadline.
StreamTimeouts timeoutsOf(const RenderRequest& request) {
    StreamTimeouts timeouts;
    if (!request.deadline) return timeouts;
    // Half for the connection, the rest for the first answer.
    const auto half = std::chrono::duration_cast<std::chrono::milliseconds>(*request.deadline / 2);
    timeouts.connect = std::clamp(half, std::chrono::milliseconds(1), timeouts.connect);
    return timeouts;
}

std::set<std::string> datasetsRead(const Scene& scene) {
    std::set<std::string> names;
    if (scene.has_medium()) names.insert(scene.medium().dataset());
    for (const Medium& medium : scene.media()) names.insert(medium.dataset());
    for (const Surface& surface : scene.surfaces()) names.insert(surface.dataset());
    return names;
}

// A folder begins at the scene's.
std::string addressOf(const std::string& source, const std::filesystem::path& folder) {
    if (source.find("://") != std::string::npos || folder.empty()) return source;
    return (folder / source).string();
}

Result<void> checkDatasets(const Scene& scene) {
    std::set<std::string> names;
    for (const SceneDataset& dataset : scene.datasets())
        if (!names.insert(dataset.name()).second)
            return fail(ErrorCode::kInvalid,
                        fmt::format("scene: two datasets are called '{}'; give each a name of its own",
                                    dataset.name()));
    return {};
}

}  // namespace

Result<RenderSources> RenderSources::open(const std::string& source, const SourceAccess& access,
                                          const RenderRequest& request, std::optional<double> frame) {
    const Scene& scene = request.scene;
    if (Result<void> checked = checkDatasets(scene); !checked) return tl::unexpected(checked.error());
    if (source.empty() && (scene.datasets().empty() || scene.datasets(0).source().empty()))
        return fail(ErrorCode::kInvalid,
                    "there is nothing to draw: name a dataset, or give the scene's first one a source");
    RenderSources sources;
    sources.access_ = access;
    sources.timeouts_ = timeoutsOf(request);
    const std::set<std::string> read = datasetsRead(scene);
    for (int i = 0; i < std::max(1, scene.datasets_size()); ++i) {
        OpenDataset dataset;
        if (i < scene.datasets_size()) {
            dataset.name = scene.datasets(i).name();
            dataset.address = addressOf(scene.datasets(i).source(), request.folder);
            dataset.frame_offset = scene.datasets(i).frame_offset();
        }
        if (i == 0 && !source.empty()) dataset.address = source;
        if (i > 0 && !read.contains(dataset.name)) continue;
        if (i > 0 && scene.datasets(i).source().empty())
            return fail(
                ErrorCode::kInvalid,
                fmt::format("scene: dataset '{}' has no source; give its folder or address", dataset.name));
        std::optional<std::uint32_t> number;
        if (frame)
            if (const Result<std::uint32_t> known = sources.frameOf(dataset, std::int64_t(*frame)))
                number = *known;
        const StartHint hint = i == 0 ? startHint(request, number) : StartHint{number, std::nullopt};
        Result<std::unique_ptr<BrickSource>> opened =
            openSource(dataset.address, access, hint, sources.timeouts_);
        if (!opened) return tl::unexpected(opened.error());
        dataset.source = std::move(*opened);
        sources.datasets_.push_back(std::move(dataset));
    }
    return sources;
}

Result<double> RenderSources::sceneFrame(std::uint32_t frame) const {
    const std::int64_t of_scene = std::int64_t(frame) - datasets_.front().frame_offset;
    if (of_scene < 0)
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: frame {} would be the scene's frame {}; mind its frame_offset",
                                datasets_.front().source->name(), frame, of_scene));
    return double(of_scene);
}

Result<double> RenderSources::firstFrame() const {
    const Manifest& manifest = first().manifest();
    if (manifest.frames_size() == 0)
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: has no frames; convert some into it", first().name()));
    return sceneFrame(manifest.frames(0).frame());
}

Result<std::uint32_t> RenderSources::frameOf(const OpenDataset& dataset, std::int64_t scene_frame) const {
    const std::int64_t frame = scene_frame + dataset.frame_offset;
    if (frame >= 0 && frame <= std::int64_t(UINT32_MAX)) return std::uint32_t(frame);
    return fail(ErrorCode::kNotFound,
                fmt::format("scene: frame {} of dataset '{}' would be {}; mind its frame_offset", scene_frame,
                            dataset.name, frame));
}

Result<void> RenderSources::requireFrame(const OpenDataset& dataset, std::int64_t scene_frame) const {
    const Result<std::uint32_t> frame = frameOf(dataset, scene_frame);
    if (!frame) return tl::unexpected(frame.error());
    const std::shared_ptr<const Manifest> manifest = dataset.source->latestManifest();
    for (const FrameEntry& entry : manifest->frames())
        if (entry.frame() == *frame) return {};
    return fail(ErrorCode::kNotFound, fmt::format("{}: has no frame {}; there are {}", dataset.source->name(),
                                                  *frame, describeFrames(*manifest)));
}

Result<void> RenderSources::requireFrame(double scene_frame) const {
    const auto whole = std::int64_t(std::floor(scene_frame));
    const std::int64_t last = scene_frame > double(whole) ? whole + 1 : whole;
    for (const OpenDataset& dataset : datasets_)
        for (std::int64_t frame = whole; frame <= last; ++frame)
            if (Result<void> there = requireFrame(dataset, frame); !there) return there;
    return {};
}

Result<void> RenderSources::choose(double scene_frame, RenderRequest& request) {
    const auto whole = std::int64_t(std::floor(scene_frame));
    request.between = scene_frame - double(whole);
    request.dataset = datasets_.front().name;
    request.others.clear();
    request.next.clear();
    if (request.between > 0)
        if (Result<void> there = requireFrame(scene_frame); !there) return there;
    const Result<std::uint32_t> frame = frameOf(datasets_.front(), whole);
    if (!frame) return tl::unexpected(frame.error());
    request.frame = *frame;
    for (OpenDataset& dataset : datasets_) {
        if (&dataset != &datasets_.front()) {
            if (Result<void> there = requireFrame(dataset, whole); !there) return there;
            request.others.push_back({dataset.name, dataset.source.get(), *frameOf(dataset, whole), nullptr});
        }
        if (!(request.between > 0)) continue;
        const std::uint32_t after = *frameOf(dataset, whole + 1);
        if (!dataset.after) {
            const StartHint hint =
                &dataset == &datasets_.front() ? startHint(request, after) : StartHint{after, std::nullopt};
            auto opened = openSource(dataset.address, access_, hint, timeouts_);
            if (!opened) return tl::unexpected(opened.error());
            dataset.after = std::move(*opened);
        }
        request.next.push_back({dataset.name, dataset.after.get(), after, nullptr});
    }
    return {};
}

}  // namespace brickyard

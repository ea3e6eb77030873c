// The renderer on the CPU: the loop of draw, miss, wish, arrive.

#include <thread>

#include "client/cpu/cpu_picture.h"
#include "client/trace/trace_picture.h"
#include "core/camera_framing.h"

namespace brickyard {

namespace {

// The first wish of a cold client: an overview, chosen by the source.
constexpr std::uint64_t kOverviewBytes = 256u << 10;
constexpr float kOverviewPixelsPerVoxel = 16;

std::uint64_t overviewCredit(const RenderRequest& request) {
    return std::min({kOverviewBytes, request.max_stream_bytes, request.cache_bytes / 4});
}

}  // namespace

StartHint startHint(const RenderRequest& request, std::optional<std::uint32_t> frame) {
    StartHint hint{frame, std::nullopt};
    const Medium& medium = request.scene.medium();
    StartView view;
    view.camera = request.camera;
    if (!view.camera && request.scene.has_camera()) view.camera = request.scene.camera();
    // The server frames the channel as it is stored, and ends a connection whose camera cannot be: in either
    // case the picture finds its overview when it knows the frame.
    const bool moved = std::any_of(medium.sample_offset().begin(), medium.sample_offset().end(),
                                   [](double offset) { return offset != 0; });
    if (view.camera ? !PinholeCamera::create(*view.camera, request.width, request.height) : moved)
        return hint;
    view.width = request.width;
    view.height = request.height;
    view.channels.push_back(medium.density());
    if (medium.has_emission()) view.channels.push_back(medium.emission().channel());
    view.pixels_per_voxel = kOverviewPixelsPerVoxel;
    view.credit_bytes = overviewCredit(request);
    hint.view = std::move(view);
    return hint;
}

Result<void> CpuPicture::open() {
    threads_ = request_.threads ? request_.threads : std::max(1u, std::thread::hardware_concurrency());
    Result<FrameFooter> footer = stream_.open(request_.frame, deadline());
    if (!footer) return tl::unexpected(footer.error());
    Result<SceneSettings> scene = bindScene(request_.scene, *footer);
    if (!scene) return tl::unexpected(scene.error());
    if (request_.density_scale) scene->density_scale = *request_.density_scale;
    if (Result<void> begun = stream_.begin(*footer, request_.cache_bytes); !begun) return begun;
    cache_ = &stream_.cache();
    auto openChannel = [&](std::uint32_t index, PagedChannel*& out) -> Result<void> {
        Result<PagedChannel*> channel = stream_.channel(index);
        if (!channel) return tl::unexpected(channel.error());
        out = *channel;
        return {};
    };
    if (Result<void> opened = openChannel(scene->density_channel, density_); !opened) return opened;
    // One channel twice is two roles for one set of pages.
    const bool glows = scene->emission.has_value();
    if (glows && scene->emission->channel != scene->density_channel)
        if (Result<void> opened = openChannel(scene->emission->channel, emission_); !opened) return opened;

    const double aspect = double(request_.width) / double(request_.height);
    outcome_.camera = request_.camera ? *request_.camera
                      : request_.scene.has_camera()
                          ? request_.scene.camera()
                          : frameChannel(footer->channels(int(scene->density_channel)), aspect);
    Result<PinholeCamera> camera = PinholeCamera::create(outcome_.camera, request_.width, request_.height);
    if (!camera) return tl::unexpected(camera.error());
    camera_ = *camera;

    plan_.camera = &*camera_;
    plan_.density = density_;
    plan_.emission = !glows ? nullptr : emission_ ? emission_ : density_;
    plan_.scene = *scene;
    plan_.quality = request_.quality;
    tracer_.emplace(plan_);
    makeLight();
    outcome_.picture = Picture(request_.width, request_.height);
    if (request_.explain) outcome_.why.resize(outcome_.picture.pixels.size());
    outcome_.background = scene->background;
    makeTiles();
    return {};
}

// The whole picture again with the pages that are there; false where one is missing.
bool CpuPicture::repeat() {
    std::vector<double> seconds;
    for (unsigned i = 0; i < request_.repeats; ++i) {
        makeTiles();
        makeLight();
        outcome_.seconds_render = 0;
        do {
            if (Result<void> drawn = pass(); !drawn) return false;
        } while (wants_.empty() && !allDone());
        if (!allDone()) return false;
        seconds.push_back(outcome_.seconds_render);
    }
    std::nth_element(seconds.begin(), seconds.begin() + std::ptrdiff_t(seconds.size() / 2), seconds.end());
    outcome_.seconds_render = seconds[seconds.size() / 2];
    return true;
}

Result<RenderOutcome> CpuPicture::run() {
    if (Result<void> opened = open(); !opened) return tl::unexpected(opened.error());

    PageWish overview;
    CameraView view{outcome_.camera, request_.width, request_.height, {}, kOverviewPixelsPerVoxel};
    // A channel of which something was kept needs no overview: its own pages are one.
    for (const PagedChannel* channel : {density_, emission_})
        if (channel && !channel->empty() && channel->blockCount() > 0 && !channel->block(0))
            view.channels.push_back(channel->index());
    if (!view.channels.empty()) {
        overview.views.push_back(view);
        overview.credit_bytes = overviewCredit(request_);
        if (Result<void> taken = take(overview); !taken) return tl::unexpected(taken.error());
    }

    const bool limited = request_.deadline || request_.max_stream_bytes != UINT64_MAX;
    if (limited && BeamTile::canTrace(plan_))
        if (Result<void> refined = refineWithinLimits(); !refined) return tl::unexpected(refined.error());

    bool more = true;
    std::uint64_t done = 0;
    while (more && !late()) {
        if (Result<void> drawn = pass(); !drawn) return tl::unexpected(drawn.error());
        if (outcome_.passes == 1) {
            // What waits gets its first look too.
            if (!allDone()) drawProvisional(/*everything=*/false);
            outcome_.seconds_first_image = secondsSince(begin_);
        }
        done = 0;
        for (const PictureTile& tile : tiles_)
            if (tile.begun) done += tile.box.pixels() - tile.waiting();
        if (request_.progress)
            request_.progress(done, outcome_.picture.pixels.size(), source_.counters().bytes_streamed);
        if (allDone()) break;
        Result<bool> streamed = stream();
        if (!streamed) return tl::unexpected(streamed.error());
        // A pass may stop before the last tile with nothing missed: then the next one goes on.
        more = *streamed || (wants_.empty() && !over_budget_);
    }

    const bool all_done = allDone();
    if (!all_done) drawProvisional(/*everything=*/false);
    if (outcome_.passes == 0) outcome_.seconds_first_image = secondsSince(begin_);
    outcome_.final = all_done && stream_.failed().empty();
    outcome_.not_final.failed = stream_.failed().size();
    outcome_.first_failure = stream_.firstFailure();
    outcome_.retried = stream_.retried();
    if (!all_done)
        (over_budget_ ? outcome_.not_final.over_budget : outcome_.not_final.queued) =
            std::max<std::size_t>(1, wants_.size());
    if (over_budget_)
        for (PixelWhy& why : outcome_.why) std::swap(why.queued, why.over_budget);
    outcome_.not_final.no_finer_data = stuck_.load();
    outcome_.streamed = source_.counters();
    outcome_.cache_bytes = cache_->peakBytes();
    outcome_.cache = stream_.counters();
    outcome_.tree_bytes = density_->treeBytes() + (emission_ ? emission_->treeBytes() : 0);
    outcome_.light_bytes = light_ ? light_->bytes() : 0;
    outcome_.method = "beams";
    outcome_.samples = request_.samples;
    outcome_.seconds_total = secondsSince(begin_);
    if (outcome_.final && request_.repeats > 0) {
        const double in_passes = outcome_.seconds_render;
        if (!repeat()) outcome_.seconds_render = in_passes;
    }
    return std::move(outcome_);
}

namespace {

class CpuRenderer final : public Renderer {
public:
    Result<RenderOutcome> render(BrickSource& source, const RenderRequest& request) override {
        if (!drawnByBeams(request)) return TracePicture(source, request).run();
        return CpuPicture(source, request).run();
    }
};

}  // namespace

std::unique_ptr<Renderer> makeCpuRenderer() { return std::make_unique<CpuRenderer>(); }

}  // namespace brickyard

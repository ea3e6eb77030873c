#include "tools/render_sequence.h"

#include <algorithm>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>

#include "client/frame_prefetch.h"
#include "client/world_settings.h"
#include "tools/command.h"
#include "tools/frame_plan.h"
#include "tools/render_picture.h"
#include "tools/render_report.h"
#include "tools/stop_signal.h"

namespace brickyard {

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
            const Result<RenderOutcome> outcome =
                drawPicture(sources.first(), options, std::move(one), files);
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

namespace {

// The frames that were asked for: the first dataset's number, and the scene's.
Result<std::map<std::uint32_t, double>> framesOf(const RenderSources& sources, const RenderOptions& options) {
    const Result<FrameSet> wanted = FrameSet::parse(options.frames);
    if (!wanted) return tl::unexpected(wanted.error());
    std::map<std::uint32_t, double> frames;
    std::set<std::uint32_t> there;
    for (const FrameEntry& entry : sources.first().manifest().frames()) {
        const Result<double> of_scene = sources.sceneFrame(entry.frame());
        if (!of_scene || !wanted->contains(std::uint32_t(*of_scene))) continue;
        frames.emplace(entry.frame(), *of_scene);
        there.insert(std::uint32_t(*of_scene));
    }
    if (const std::optional<std::uint32_t> missing = wanted->firstMissing(there))
        if (Result<void> found = sources.requireFrame(*missing); !found) return tl::unexpected(found.error());
    // Those of the other datasets.
    for (const auto& [frame, of_scene] : frames)
        if (Result<void> found = sources.requireFrame(of_scene); !found) return tl::unexpected(found.error());
    return frames;
}

// What a sequence keeps of the frame that is drawn, and fetches of the next. A scene of several datasets is
// not fetched ahead: none of its frames is bound alone.
class FramesAhead {
public:
    FramesAhead(const RenderSources& sources, const RenderRequest& request) : request_(request) {
        // Under a limit a picture is what had come by then: nothing may come earlier for one than for
        // another.
        const bool limited = request.deadline || request.max_stream_bytes != UINT64_MAX;
        if (limited || request.cache_bytes < 2 * kLeastBytes) return;
        if (auto source = sources.openFirstAgain()) source_ = std::move(*source);
    }

    // Gives the picture what is kept for it, and begins to fetch `next`. Two frames share the cache.
    void begin(RenderRequest& picture, std::optional<std::uint32_t> next) {
        if (!source_) return;
        dataset_ = picture.dataset;
        picture.cache_bytes /= 2;
        picture.kept = kept_.get();
        next_ = std::make_unique<ResidentFrame>();
        // What the first frame will use is not known yet.
        if (!next || use_.channels.empty()) return;
        const std::uint64_t most = 2 * use_.bytes + kPlentyBytes;
        const auto bind = [this](FrameFooter& footer) -> Result<void> {
            const BoundFrame frame{dataset_, &footer};
            const auto bound = bindWorld(request_.scene, std::span(&frame, 1), request_.folder);
            if (!bound) return tl::unexpected(bound.error());
            return {};
        };
        ahead_.emplace(
            PrefetchRequest{source_.get(), *next, use_, picture.cache_bytes, most, bind, next_.get()});
    }

    // After the picture: what was fetched counts as streamed.
    void end(RenderOutcome& outcome) {
        ahead_.reset();
        if (source_) {
            fetched_ = source_->counters();
            use_ = useOf(*kept_);
            kept_ = std::move(next_);
            // Half the cache is too little: it is the picture's alone from here on.
            if (outcome.cache.reloads > 0) source_.reset();
        }
        outcome.streamed.bytes_streamed += fetched_.bytes_streamed;
        outcome.streamed.pages_streamed += fetched_.pages_streamed;
        outcome.streamed.blocks_streamed += fetched_.blocks_streamed;
    }

private:
    static constexpr std::uint64_t kLeastBytes = 64u << 20;
    static constexpr std::uint64_t kPlentyBytes = 1u << 20;
    const RenderRequest& request_;
    std::unique_ptr<BrickSource> source_;  // nullptr: nothing is fetched ahead
    std::unique_ptr<ResidentFrame> kept_ = std::make_unique<ResidentFrame>(), next_;
    std::string dataset_;
    SourceCounters fetched_;
    FrameUse use_;                        // of the picture before
    std::optional<FramePrefetch> ahead_;  // ends before what it works on
};

}  // namespace

Result<int> drawFrames(RenderSources& sources, const RenderOptions& options, const RenderRequest& request) {
    const Result<std::map<std::uint32_t, double>> frames = framesOf(sources, options);
    if (!frames) return tl::unexpected(frames.error());
    const StopSignal stop;
    int status = kExitDone;
    FramesAhead ahead(sources, request);
    for (auto at = frames->begin(); at != frames->end(); ++at) {
        if (StopSignal::received() != 0) return status;
        RenderRequest one = request;
        if (Result<void> chosen = sources.choose(at->second, one); !chosen)
            return tl::unexpected(chosen.error());
        const auto next = std::next(at);
        ahead.begin(one, next == frames->end() ? std::nullopt : std::optional(next->first));
        const PictureFiles files(options, std::uint32_t(at->second));
        Result<RenderOutcome> outcome = drawPicture(sources.first(), options, std::move(one), files);
        if (!outcome) return tl::unexpected(outcome.error());
        ahead.end(*outcome);
        status = std::max(status, reportPicture(*outcome, files.output, options.json));
    }
    return status;
}

}  // namespace brickyard

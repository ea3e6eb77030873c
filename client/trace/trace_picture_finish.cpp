// What a picture is when rays are done, or have to stop; and drawing it again.

#include <algorithm>
#include <limits>

#include "client/trace/trace_picture.h"

namespace brickyard {

void TracePicture::drawRough() {
    constexpr std::uint32_t kStride = 4;
    for (WantList& list : wants_) list.clear();
    std::vector<WantList> ignored(streams_.size());
    std::vector<RayContext> contexts;
    for (std::size_t s = 0; s < streams_.size(); ++s)
        contexts.push_back({&streams_[s].cache(), &streams_[s].failed(), &ignored[s], 0, SIZE_MAX});
    Readers readers(world_, contexts);
    LightReach lights(readers.shadow, readers.hits(), maps_ ? &*maps_ : nullptr);
    RayMarch march(readers.view, lights, readers.hits());
    PathWalk walk(readers.view, march, readers.hits(), request_.most_bounces);
    for (const Tile& tile : tiles_) {
        const std::size_t first = std::size_t(tile.y0) * request_.width + tile.x0;
        if (tile.done || tile.round_samples > 0 || sums_[first].samples > 0) continue;
        for (std::uint32_t y = tile.y0; y < tile.y1; y += kStride)
            for (std::uint32_t x = tile.x0; x < tile.x1; x += kStride) {
                const RaySample sample = traceSample(x, y, 0, march, walk);
                for (std::uint32_t v = y; v < std::min(y + kStride, tile.y1); ++v)
                    for (std::uint32_t u = x; u < std::min(x + kStride, tile.x1); ++u)
                        writeStandIn(sample, v * request_.width + u);
            }
    }
}

void TracePicture::writeStandIn(const RaySample& sample, std::uint32_t at) {
    Pixel& pixel = outcome_.picture.pixels[at];
    for (int c = 0; c < 3; ++c) pixel.radiance[std::size_t(c)] = float(sample.radiance[c]);
    pixel.alpha = float(sample.alpha);
    pixel.depth = float(sample.depth);
}

bool TracePicture::repeat() {
    std::vector<double> seconds;
    for (unsigned i = 0; i < request_.repeats; ++i) {
        makeTiles();
        outcome_.seconds_render = 0;
        if (const Result<bool> built = buildShadowMaps(); !built || !*built) return false;
        if (!draw()) return false;
        if (!std::all_of(tiles_.begin(), tiles_.end(), [](const Tile& tile) { return tile.done; }))
            return false;
        seconds.push_back(outcome_.seconds_render);
    }
    std::nth_element(seconds.begin(), seconds.begin() + std::ptrdiff_t(seconds.size() / 2), seconds.end());
    outcome_.seconds_render = seconds[seconds.size() / 2];
    return true;
}

void TracePicture::finish() {
    // What was begun and misses pages is shown with what stood in for them.
    for (const Tile& tile : tiles_) {
        if (tile.done || tile.round_samples == 0) continue;
        const std::uint32_t width = tile.x1 - tile.x0;
        for (std::size_t i = 0; i * tile.round_samples < tile.round.size(); ++i) {
            const std::uint32_t at =
                (tile.y0 + std::uint32_t(i) / width) * request_.width + tile.x0 + std::uint32_t(i) % width;
            if (sums_[at].samples > 0) continue;
            writeStandIn(tile.round[i * tile.round_samples], at);
            if (!outcome_.why.empty())
                (over_budget_ ? outcome_.why[at].over_budget : outcome_.why[at].queued) = 1;
        }
    }
    const bool all_done =
        std::all_of(tiles_.begin(), tiles_.end(), [](const Tile& tile) { return tile.done; });
    for (Pixel& pixel : outcome_.picture.pixels)
        if (pixel.bound_radiance == 0) {
            // Not one sample: nothing is known.
            pixel.bound_radiance = std::numeric_limits<float>::infinity();
            pixel.bound_alpha = 1;
            pixel.estimate_alpha = pixel.estimate_radiance = 1;
        }
    std::uint64_t waiting = 0;
    for (const WantList& list : wants_) waiting += list.size();
    outcome_.not_final.no_finer_data = stuck_.load();
    if (!all_done)
        (over_budget_ ? outcome_.not_final.over_budget : outcome_.not_final.queued) =
            std::max<std::uint64_t>(1, waiting);
    for (FrameStream& stream : streams_) {
        outcome_.not_final.failed += stream.failed().size();
        outcome_.retried += stream.retried();
        if (outcome_.first_failure.empty()) outcome_.first_failure = stream.firstFailure();
        const SourceCounters counters = stream.source().counters();
        outcome_.streamed.bytes_streamed += counters.bytes_streamed;
        outcome_.streamed.pages_streamed += counters.pages_streamed;
        outcome_.streamed.blocks_streamed += counters.blocks_streamed;
        outcome_.streamed.round_trips += counters.round_trips;
        outcome_.streamed.reconnects += counters.reconnects;
        outcome_.cache_bytes += stream.cache().peakBytes();
        const PageCacheCounters cache = stream.counters();
        outcome_.cache.hits += cache.hits;
        outcome_.cache.loads += cache.loads;
        outcome_.cache.evictions += cache.evictions;
        outcome_.cache.reloads += cache.reloads;
        outcome_.tree_bytes += stream.treeBytes();
    }
    if (maps_) outcome_.light_bytes = maps_->bytes();
    outcome_.final = all_done && outcome_.not_final.failed == 0;
    outcome_.method = request_.path ? "path" : "march";
    outcome_.samples = 0;
    for (const PixelSum& sum : sums_)
        outcome_.samples = std::max<std::uint64_t>(outcome_.samples, sum.samples);
    if (outcome_.seconds_first_image == 0) outcome_.seconds_first_image = secondsSince(begin_);
    outcome_.seconds_total = secondsSince(begin_);
}

}  // namespace brickyard

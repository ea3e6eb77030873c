// Drawing a scene: passes of rays, and the pages that come in between.

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <thread>

#include "client/trace/sample_place.h"
#include "client/trace/trace_picture.h"

namespace brickyard {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// The first round is one sample everywhere, so that something is to be seen soon.
constexpr std::uint32_t kRoundSamples = 8;
// Rounds that wait for pages keep their samples; tiles beyond this are taken up later.
constexpr std::uint64_t kMostWaitingSamples = 1u << 20;
// Where as many samples are drawn as the error asks for.
constexpr std::uint32_t kLeastSamples = 32;
// Passes without a finished sample after which samples are no longer drawn together, and after which the
// cache is taken for too small.
constexpr int kIdlePassesTogether = 8;
constexpr int kMostIdlePasses = 64;
// The first wish of a cold client: an overview, chosen by the source.
constexpr std::uint64_t kOverviewBytes = 256u << 10;
constexpr float kOverviewPixelsPerVoxel = 16;

constexpr const char* kSmallCache = "--cache holds too few bricks for a few rays of this scene; give it more";

}  // namespace

Result<void> TracePicture::overview() {
    CameraView view{outcome_.camera, request_.width, request_.height, {}, kOverviewPixelsPerVoxel};
    for (const TracedMedium& medium : world_.media)
        for (const TracedChannel* channel : {&medium.now.density, &medium.now.emission})
            if (*channel && channel->frame == 0 && !channel->channel->empty() &&
                channel->channel->blockCount() > 0 && !channel->channel->block(0) &&
                std::find(view.channels.begin(), view.channels.end(), channel->channel->index()) ==
                    view.channels.end())
                view.channels.push_back(channel->channel->index());
    if (view.channels.empty()) return {};
    PageWish wish;
    wish.views.push_back(view);
    wish.credit_bytes = std::min({kOverviewBytes, request_.max_stream_bytes, request_.cache_bytes / 4});
    return streams_[0].take(wish, deadline());
}

void TracePicture::pass(std::size_t items, const std::function<void(std::size_t, Worker&)>& body) {
    const auto begin = std::chrono::steady_clock::now();
    std::size_t room = SIZE_MAX;
    for (std::size_t s = 0; s < streams_.size(); ++s) {
        streams_[s].cache().beginPass();
        room = std::min(room, std::max<std::size_t>(1, streams_[s].cache().room()));
        wants_[s].clear();
    }
    std::vector<Worker> workers(threads_);
    for (Worker& worker : workers) {
        worker.wants.resize(streams_.size());
        for (std::size_t s = 0; s < streams_.size(); ++s)
            worker.contexts.push_back({&streams_[s].cache(), &streams_[s].failed(), &worker.wants[s], 0,
                                       std::max<std::size_t>(1, streams_[s].cache().room() / threads_)});
    }
    std::atomic<std::size_t> next{0}, missed{0};
    auto run = [&](Worker& worker) {
        for (;;) {
            if (missed.load(std::memory_order_relaxed) > room) return;
            const std::size_t item = next.fetch_add(1);
            if (item >= items || late()) return;
            std::size_t before = 0, behind = 0;
            for (const WantList& list : worker.wants) before += list.size();
            for (RayContext& context : worker.contexts) context.tile = std::uint32_t(item);
            body(item, worker);
            for (const WantList& list : worker.wants) behind += list.size();
            missed.fetch_add(behind - before, std::memory_order_relaxed);
        }
    };
    {
        std::vector<std::jthread> threads;
        for (unsigned t = 1; t < threads_; ++t) threads.emplace_back([&, t] { run(workers[t]); });
        run(workers[0]);
    }
    for (const Worker& worker : workers)
        for (std::size_t s = 0; s < streams_.size(); ++s) wants_[s].merge(worker.wants[s]);
    outcome_.seconds_render += secondsSince(begin);
    ++outcome_.passes;
}

bool TracePicture::missedAnything() const {
    return std::any_of(wants_.begin(), wants_.end(), [](const WantList& list) { return !list.empty(); });
}

Result<bool> TracePicture::stream() {
    bool any = false;
    std::uint64_t streamed = 0;
    for (FrameStream& stream : streams_) streamed += stream.source().counters().bytes_streamed;
    for (std::size_t s = 0; s < streams_.size(); ++s) {
        const std::uint64_t allowed =
            request_.max_stream_bytes > streamed ? request_.max_stream_bytes - streamed : 0;
        const PageWish wish = streams_[s].wishFor(wants_[s], allowed, over_budget_);
        if (wish.pages.empty()) continue;
        if (Result<void> taken = streams_[s].take(wish, deadline()); !taken)
            return tl::unexpected(taken.error());
        streamed += wish.credit_bytes;
        any = true;
    }
    return any;
}

Result<bool> TracePicture::prepare() {
    // The farthest point of the box decides how coarse the levels get.
    std::vector<int> coarsest(world_.media.size(), 0);
    for (std::size_t m = 0; m < world_.media.size(); ++m)
        for (int corner = 0; corner < 8; ++corner) {
            const glm::dvec3 at(corner & 1 ? world_.box_high.x : world_.box_low.x,
                                corner & 2 ? world_.box_high.y : world_.box_low.y,
                                corner & 4 ? world_.box_high.z : world_.box_low.z);
            coarsest[m] = std::max(coarsest[m], int(std::ceil(world_.lodAt(world_.media[m], at))));
        }
    const double coarser = request_.path ? 0 : ShadowMaps::coarserBy(world_);
    if (coarser > 0)
        for (TracedMedium& medium : world_.media) {
            const glm::dvec3 nearest = glm::clamp(camera_->eye(), world_.box_low, world_.box_high);
            medium.shadow_spread = std::exp2(std::ceil(world_.lodAt(medium, nearest) + coarser));
        }
    std::vector<std::uint8_t> made(world_.media.size(), 0);
    while (!late()) {
        pass(world_.media.size(), [&](std::size_t m, Worker& worker) {
            if (!made[m]) made[m] = makeMajorants(world_.media[m], coarsest[m], worker.contexts);
        });
        if (std::all_of(made.begin(), made.end(), [](std::uint8_t done) { return done != 0; })) {
            // What moves may leave the box that it has in its frame; shadows are looked for there, too.
            for (const TracedMedium& medium : world_.media)
                for (int corner = 0; corner < 8; ++corner) {
                    const glm::dvec3 &low = medium.box_low, &high = medium.box_high;
                    const glm::dvec3 at =
                        medium.transform().point({corner & 1 ? high.x : low.x, corner & 2 ? high.y : low.y,
                                                  corner & 4 ? high.z : low.z});
                    world_.box_low = glm::min(world_.box_low, at);
                    world_.box_high = glm::max(world_.box_high, at);
                }
            return true;
        }
        const Result<bool> more = stream();
        if (!more) return tl::unexpected(more.error());
        if (!*more) return false;
    }
    return false;
}

double TracePicture::rayEnd(std::uint32_t x, std::uint32_t y) const {
    if (!request_.behind) return kInfinity;
    const float depth = request_.behind->pixels[std::size_t(y) * request_.behind->width + x].depth;
    return depth > 0 && std::isfinite(depth) ? double(depth) : kInfinity;
}

RaySample TracePicture::traceSample(std::uint32_t x, std::uint32_t y, std::uint32_t sample, RayMarch& march,
                                    PathWalk& walk) const {
    const std::uint64_t pixel = std::uint64_t(y) * request_.width + x;
    const double open = world_.settings.shutter_open, close = world_.settings.shutter_close;
    PathRandom random(request_.seed, pixel, sample);
    double px = 0.5, py = 0.5, moment = 0.5;
    if (most_samples_ > 1) {
        if (request_.path) {
            px = random.uniform();
            py = random.uniform();
            moment = random.uniform();
        } else {
            const SamplePlace place =
                samplePlace(sample, most_samples_, mixBits(request_.seed ^ mixBits(pixel)));
            px = place.x;
            py = place.y;
            moment = place.time;
        }
    }
    WorldRay ray = camera_->rayThrough(double(x) + px, double(y) + py);
    const double time = open + (close - open) * moment;
    double end = rayEnd(x, y);
    // Distances count from where there is something: from a far eye they would have no digits left.
    const RaySpan met = IndexRay(ray, Affine()).clip(world_.box_low, world_.box_high, {0, end});
    const double begin = met.empty() ? 0 : met.begin;
    ray.origin += begin * ray.direction;
    end -= begin;
    RaySample out =
        request_.path
            ? walk.sample(ray, end, time, random)
            : march.march(ray, end, time, mixBits(request_.seed + pixel * 0x9e3779b97f4a7c15ull + sample));
    if (out.depth > 0) out.depth += begin;
    return out;
}

void TracePicture::traceTile(std::size_t index, Worker& worker) {
    Tile& tile = tiles_[index];
    const std::uint32_t width = tile.x1 - tile.x0, pixels = width * (tile.y1 - tile.y0);
    if (tile.round_samples == 0) {
        if (rounds_.load(std::memory_order_relaxed) > kMostWaitingSamples) return;
        std::uint32_t drawn = most_samples_;
        for (std::uint32_t i = 0; i < pixels; ++i) {
            const PixelSum& sum =
                sums_[std::size_t(tile.y0 + i / width) * request_.width + tile.x0 + i % width];
            if (!sum.done) drawn = std::min(drawn, sum.samples);
        }
        tile.round_samples = drawn == 0 ? 1 : std::min(kRoundSamples, most_samples_ - drawn);
        tile.round.assign(std::size_t(pixels) * tile.round_samples, {});
        tile.have.assign(tile.round.size(), 0);
        rounds_.fetch_add(tile.round.size(), std::memory_order_relaxed);
    }
    Readers readers(world_, worker.contexts);
    LightReach lights(readers.shadow, readers.hits(), maps_ ? &*maps_ : nullptr);
    RayMarch march(readers.view, lights, readers.hits());
    PathWalk walk(readers.view, march, readers.hits(), request_.most_bounces);
    std::uint64_t finished = 0;
    bool complete = true;
    for (std::uint32_t i = 0; i < pixels; ++i) {
        const std::uint32_t x = tile.x0 + i % width, y = tile.y0 + i / width;
        const PixelSum& sum = sums_[std::size_t(y) * request_.width + x];
        if (sum.done) continue;
        for (std::uint32_t k = 0; k < tile.round_samples; ++k) {
            const std::size_t at = std::size_t(i) * tile.round_samples + k;
            if (tile.have[at]) continue;
            if (late()) {
                complete = false;
                continue;
            }
            // Where the cache is full of wants already, a sample would only want more.
            bool full = false;
            for (const RayContext& context : worker.contexts) full |= context.full();
            if (full && outcome_.passes > 2) {
                complete = false;
                continue;
            }
            tile.round[at] = traceSample(x, y, sum.samples + k, march, walk);
            const bool missed = readers.takeMissed();
            tile.have[at] = !missed;
            complete = complete && !missed;
            finished += !missed;
            if (missed && one_by_one_) break;
        }
        if (!complete && one_by_one_) break;
    }
    finished_samples_.fetch_add(finished, std::memory_order_relaxed);
    if (complete) finishRound(tile);
}

// In the order of samples, so that the sums do not depend on when pages came.
void TracePicture::finishRound(Tile& tile) {
    const std::uint32_t width = tile.x1 - tile.x0, pixels = width * (tile.y1 - tile.y0);
    const double target = request_.quality.max_error / 3;
    bool all_done = true;
    for (std::uint32_t i = 0; i < pixels; ++i) {
        const std::uint32_t at = (tile.y0 + i / width) * request_.width + tile.x0 + i % width;
        PixelSum& sum = sums_[at];
        if (sum.done) continue;
        for (std::uint32_t k = 0; k < tile.round_samples; ++k) {
            const RaySample& sample = tile.round[std::size_t(i) * tile.round_samples + k];
            const double most = std::max({sample.radiance.x, sample.radiance.y, sample.radiance.z});
            sum.radiance += sample.radiance;
            sum.greatest += most;
            sum.radiance_square += most * most;
            sum.alpha += sample.alpha;
            sum.alpha_square += sample.alpha * sample.alpha;
            sum.depth += sample.alpha * sample.depth;
            sum.depth_weight += sample.depth > 0 ? sample.alpha : 0;
            sum.alpha_deviation += std::sqrt(sample.alpha_variance);
            sum.radiance_deviation += std::sqrt(sample.radiance_variance);
            ++sum.samples;
        }
        writePixel(at);
        const Pixel& pixel = outcome_.picture.pixels[at];
        const double estimate = double(std::max(pixel.estimate_radiance, pixel.estimate_alpha));
        sum.done = sum.samples >= most_samples_ ||
                   (samples_ == 0 && sum.samples >= kLeastSamples && estimate <= target);
        if (sum.done && samples_ == 0 && estimate > target) stuck_.fetch_add(1, std::memory_order_relaxed);
        all_done = all_done && sum.done;
    }
    rounds_.fetch_sub(tile.round.size(), std::memory_order_relaxed);
    tile.round_samples = 0;
    tile.done = all_done;
    if (tile.done) {
        tile.round = {};
        tile.have = {};
    }
}

void TracePicture::writePixel(std::uint32_t at) {
    const PixelSum& sum = sums_[at];
    Pixel& pixel = outcome_.picture.pixels[at];
    const double count = std::max(1u, sum.samples);
    // Standard error of a mean. Of one sample of many it is not known, nor that of a path; but what a ray
    // meets through a pixel's centre is what is to be drawn.
    auto deviation = [&](double total, double squares, bool random) {
        // So that three of them hold what three of a normal distribution do: Student's, about.
        const double few = 1 + 3.6 / (count - 1) + 8 / ((count - 1) * (count - 1) * (count - 1));
        if (sum.samples < 2) return random || most_samples_ > 1 ? 1.0 : 0.0;
        const double variance = std::max(0.0, squares - total * total / count) / (count - 1);
        return few * std::sqrt(variance / count);
    };
    constexpr double kMost = std::numeric_limits<float>::max();
    for (int c = 0; c < 3; ++c)
        pixel.radiance[std::size_t(c)] = float(std::clamp(sum.radiance[c] / count, -kMost, kMost));
    pixel.alpha = float(sum.alpha / count);
    pixel.depth = sum.depth_weight > 0 ? float(sum.depth / sum.depth_weight) : 0;
    pixel.bound_alpha = std::max(pixel.alpha, 1 - pixel.alpha);
    pixel.bound_radiance = std::numeric_limits<float>::infinity();
    pixel.estimate_alpha =
        float(std::hypot(sum.alpha_deviation / count, deviation(sum.alpha, sum.alpha_square, false)));
    pixel.estimate_radiance = float(std::hypot(sum.radiance_deviation / count,
                                               deviation(sum.greatest, sum.radiance_square, request_.path)));
}

Result<void> TracePicture::draw() {
    int idle = 0;
    for (;;) {
        std::vector<std::uint32_t> open_tiles;
        for (std::uint32_t i = 0; i < tiles_.size(); ++i)
            if (!tiles_[i].done) open_tiles.push_back(i);
        if (open_tiles.empty() || late()) return {};
        finished_samples_ = 0;
        // Rays that drive each other's pages out of a small cache are drawn one after the other.
        one_by_one_ = one_by_one_ || idle >= kIdlePassesTogether;
        pass(one_by_one_ ? 1 : open_tiles.size(),
             [&](std::size_t i, Worker& worker) { traceTile(open_tiles[i], worker); });
        if (outcome_.seconds_first_image == 0) outcome_.seconds_first_image = secondsSince(begin_);
        if (request_.progress) {
            std::uint64_t done = 0;
            for (const PixelSum& sum : sums_) done += sum.done ? most_samples_ : sum.samples;
            request_.progress(done / most_samples_, sums_.size(),
                              streams_[0].source().counters().bytes_streamed);
        }
        if (!missedAnything()) continue;
        idle = finished_samples_.load() == 0 ? idle + 1 : 0;
        if (idle > kMostIdlePasses) return fail(ErrorCode::kInvalid, kSmallCache);
        const Result<bool> more = stream();
        if (!more) return tl::unexpected(more.error());
        if (!*more) return {};
    }
}

Result<bool> TracePicture::buildShadowMaps() {
    if (request_.path) return true;  // paths find their own way to the lights
    maps_.emplace(world_);
    std::vector<std::uint32_t> open_blocks(maps_->blockCount());
    std::iota(open_blocks.begin(), open_blocks.end(), 0u);
    int idle = 0;
    bool alone = false;
    while (!open_blocks.empty()) {
        if (late()) return false;
        std::atomic<std::uint64_t> pixels{0};
        alone = alone || idle >= kIdlePassesTogether;
        pass(alone ? 1 : open_blocks.size(), [&](std::size_t i, Worker& worker) {
            for (const RayContext& context : worker.contexts)
                if (!alone && context.full()) return;
            if (late()) return;
            Readers readers(world_, worker.contexts);
            pixels += maps_->fill(open_blocks[i], alone, readers.view, readers.hits());
        });
        std::erase_if(open_blocks, [&](std::uint32_t block) { return maps_->filled(block); });
        if (open_blocks.empty()) break;
        idle = pixels.load() == 0 ? idle + 1 : 0;
        if (idle > kMostIdlePasses) return fail(ErrorCode::kInvalid, kSmallCache);
        const Result<bool> more = stream();
        if (!more) return tl::unexpected(more.error());
        if (!*more && missedAnything()) return false;
    }
    maps_->calibrate();
    return true;
}

Result<RenderOutcome> TracePicture::run() {
    if (Result<void> opened = open(); !opened) return tl::unexpected(opened.error());
    if (Result<void> taken = overview(); !taken) return tl::unexpected(taken.error());
    const Result<bool> ready = prepare();
    if (!ready) return tl::unexpected(ready.error());
    if (*ready) {
        // Maps that limits left unfinished are better than none.
        if (const Result<bool> built = buildShadowMaps(); !built) return tl::unexpected(built.error());
        if (Result<void> drawn = draw(); !drawn) return tl::unexpected(drawn.error());
        if (late()) drawRough();
    }
    finish();
    if (outcome_.final && request_.repeats > 0) {
        const double in_passes = outcome_.seconds_render;
        if (!repeat()) outcome_.seconds_render = in_passes;
    }
    return std::move(outcome_);
}

}  // namespace brickyard

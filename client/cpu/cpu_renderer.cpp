// The renderer on the CPU: tiles of rays over all cores, pass by pass.

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <thread>
#include <unordered_set>

#include "client/brick_page.h"
#include "client/cpu/beam_tile.h"
#include "client/cpu/page_order.h"
#include "client/cpu/ray_tracer.h"
#include "client/renderer.h"
#include "core/brick_codec.h"
#include "core/brick_store.h"

namespace brickyard {

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::uint32_t kTileEdge = 32;
// A wish is answered in pieces; what arrives is drawn with after each wish, not after each piece.
constexpr std::size_t kMaxWishPages = 16384;
// With limits: a batch is a share of what came before, so that the order stays current and round trips stay
// few.
constexpr std::uint64_t kLeastBatchBytes = 16u << 10, kBatchShare = 6;
// The first wish of a cold client: an overview, chosen by the source.
constexpr std::uint64_t kOverviewBytes = 256u << 10;
constexpr float kOverviewPixelsPerVoxel = 16;
// Segments kept of rays that wait, over all tiles; tiles beyond it are taken up later.
constexpr std::uint64_t kMaxWaitingRays = 4u << 20;

double secondsSince(Clock::time_point begin) {
    return std::chrono::duration<double>(Clock::now() - begin).count();
}

struct Tile {
    PixelBox box;
    std::optional<BeamTile> beam;      // while its packets are under way
    std::vector<PixelRay> rays;        // of pixels that are not final and that no packet took
    std::vector<std::uint32_t> where;  // their places in the picture
    bool begun = false;
    bool done() const { return begun && !beam && rays.empty(); }
    std::uint64_t waiting() const { return beam ? box.pixels() : rays.size(); }
};

class CpuPicture {
public:
    CpuPicture(BrickSource& source, const RenderRequest& request)
        : source_(source), request_(request), held_(request.kept ? *request.kept : own_) {}

    Result<RenderOutcome> run();

private:
    Result<void> open();
    Result<void> pass();
    void makeTiles();
    void makeLight();
    bool allDone() const {
        return std::all_of(tiles_.begin(), tiles_.end(), [](const Tile& tile) { return tile.done(); });
    }
    bool repeat();
    void traceTile(std::uint32_t index, WantList& wants);
    void drawResident(const Tile& tile, const ResidentTree& tree, LightField* light,
                      const RayContext& context);
    void drawProvisional(bool everything);
    void takePixels(const BeamTile& beam);
    void explain(std::uint32_t at, float level, float waiting, float failed, bool stuck);
    void explainRay(const PixelRay& ray, std::uint32_t at);
    ResidentTree residentTree() const;
    Result<void> refineWithinLimits();
    double lightDeviation() const;
    // Sends the wants of the last pass and takes in what comes. False when nothing more may come.
    Result<bool> stream();
    Result<void> take(const PageWish& wish);
    void arrive(const Arrival& arrival);
    PagedChannel* channelOf(std::uint32_t index) {
        if (density_ && density_->index() == index) return density_;
        return emission_ && emission_->index() == index ? emission_ : nullptr;
    }
    bool late() const { return request_.deadline && Clock::now() - begin_ >= *request_.deadline; }
    void forEachThread(const std::function<void(unsigned)>& body) const;
    RayContext context(WantList& wants, std::uint32_t tile) const {
        return {cache_, &failed_, &wants, tile, std::max<std::size_t>(1, cache_->room() / threads_)};
    }

    BrickSource& source_;
    const RenderRequest& request_;
    Clock::time_point begin_ = Clock::now();
    RenderOutcome outcome_;
    std::optional<PinholeCamera> camera_;
    ResidentFrame own_;    // where nothing is kept
    ResidentFrame& held_;  // owns the next three
    PagedChannel *density_ = nullptr, *emission_ = nullptr;
    PageCache* cache_ = nullptr;
    PageCacheCounters counted_before_;
    RenderPlan plan_;
    std::optional<RayTracer> tracer_;
    std::optional<LightField> light_;
    std::vector<Tile> tiles_;
    WantList wants_;
    std::unordered_set<WantedPage, WantedPageHash> failed_;
    std::unordered_set<WantedPage, WantedPageHash> retried_;
    unsigned threads_ = 1;
    std::atomic<std::uint64_t> stuck_{0};
    bool over_budget_ = false;
};

void CpuPicture::forEachThread(const std::function<void(unsigned)>& body) const {
    std::vector<std::jthread> threads;
    for (unsigned t = 1; t < threads_; ++t) threads.emplace_back([&body, t] { body(t); });
    body(0);
}

Result<void> CpuPicture::open() {
    threads_ = request_.threads ? request_.threads : std::max(1u, std::thread::hardware_concurrency());
    Result<FrameFooter> footer = source_.openFrame(request_.frame);
    if (!footer) return tl::unexpected(footer.error());
    std::uint64_t file_bytes = UINT64_MAX;
    for (const FrameEntry& entry : source_.manifest().frames())
        if (entry.frame() == request_.frame) file_bytes = entry.file_bytes();

    Result<SceneSettings> scene = bindScene(request_.scene, *footer);
    if (!scene) return tl::unexpected(scene.error());
    if (request_.density_scale) scene->density_scale = *request_.density_scale;
    if (Result<void> begun = held_.begin(*footer, file_bytes, request_.cache_bytes); !begun) return begun;
    cache_ = &held_.cache();
    counted_before_ = cache_->counters();
    auto openChannel = [&](std::uint32_t index, PagedChannel*& out) -> Result<void> {
        Result<PagedChannel*> channel = held_.channel(index);
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

// Of a pixel's standard deviation, what its shadows may make; levels of the view use the rest. 0: exact.
double CpuPicture::lightDeviation() const {
    if (plan_.quality.reference) return 0;
    constexpr double kShadowShare = 0.4;
    const glm::dvec3 scattered = plan_.scattered();
    const double most = std::max({scattered.x, scattered.y, scattered.z}) *
                        henyeyGreenstein(std::abs(plan_.scene.anisotropy), 1);
    return std::min(kShadowShare * plan_.quality.max_error / 3 / std::max(most, 1e-30), 0.3);
}

void CpuPicture::makeLight() {
    light_.reset();
    if (plan_.scene.light) light_.emplace(plan_, lightDeviation());
}

void CpuPicture::makeTiles() {
    tiles_.clear();
    for (std::uint32_t y = 0; y < request_.height; y += kTileEdge)
        for (std::uint32_t x = 0; x < request_.width; x += kTileEdge)
            tiles_.emplace_back().box = {x, y, std::min(x + kTileEdge, request_.width),
                                         std::min(y + kTileEdge, request_.height)};
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

// A first wish that needs no knowledge: the top of each tree, and an overview of what the camera sees.
Result<void> CpuPicture::take(const PageWish& wish) {
    if (Result<void> sent = source_.wish(wish); !sent) return sent;
    Clock::time_point deadline = Clock::time_point::max();
    if (request_.deadline)
        deadline = begin_ + std::chrono::duration_cast<Clock::duration>(*request_.deadline);
    cache_->beginPass();
    while (!late()) {
        Result<std::vector<Arrival>> arrivals = source_.take(deadline);
        if (!arrivals) return tl::unexpected(arrivals.error());
        if (arrivals->empty()) break;
        for (const Arrival& arrival : *arrivals) arrive(arrival);
    }
    return {};
}

void CpuPicture::arrive(const Arrival& arrival) {
    const PageAddress& address = arrival.page.address;
    const WantedPage key{arrival.page.is_block, address};
    auto failed = [&](const std::string& why) {
        // Once more: a flipped bit on the way is not one on the disk.
        if (arrival.bytes && retried_.insert(key).second) return;
        if (failed_.insert(key).second && outcome_.first_failure.empty()) outcome_.first_failure = why;
    };
    if (!arrival.bytes) return failed(arrival.bytes.error().message);
    PagedChannel* channel = channelOf(address.channel);
    if (!channel) return;  // not asked for
    if (arrival.page.is_block) {
        if (Result<void> added = channel->addBlock(address.block, *arrival.bytes); !added)
            failed(added.error().message);
        return;
    }
    const TreeBlock* block = address.block < channel->blockCount() ? channel->block(address.block) : nullptr;
    if (!block || address.node >= block->nodeCount() || !block->record(address.node).hasBrick()) return;
    if (cache_->contains(address)) return;
    const NodeRecord& record = block->record(address.node);
    const std::string where =
        fmt::format("channel '{}': brick {} of tree block {}", channel->name(), address.node, address.block);
    if (address.draft && !record.hasDraft()) return;
    if (arrival.bytes->size() != (address.draft ? record.draft_bytes : record.payload_bytes) ||
        checksum(*arrival.bytes) != (address.draft ? record.draft_checksum : record.payload_checksum))
        return failed(where + " fails its checksum; run `brickyard verify` on the dataset");
    // Decoded aside: a payload that is refused half-way must not leave half a brick in the cache.
    std::vector<float> samples(channel->shape().samples());
    const SampleType type = levelType(channel->type(), channel->levelOf({address.block, address.node}));
    const Result<void> decoded = address.draft
                                     ? decodeDraftToFloat(*arrival.bytes, channel->shape(), type, 1, samples)
                                     : decodeBrickToFloat(*arrival.bytes, channel->shape(), type, 1, samples);
    if (!decoded) return failed(where + ": " + decoded.error().message);
    float* slot = cache_->insert(address);
    if (!slot) return;  // no room now: it is wanted again
    *std::copy(samples.begin(), samples.end(), slot) = steepnessOf(samples, channel->shape());
    if (address.block == 0 && address.node < channel->roots().size()) cache_->pin(address);
}

void CpuPicture::traceTile(std::uint32_t index, WantList& wants) {
    Tile& tile = tiles_[index];
    const RayContext ray_context = context(wants, index);
    Picture& picture = outcome_.picture;
    RayComposite composite;
    // True when the pixel is final.
    auto advance = [&](PixelRay& ray, std::uint32_t at) {
        // Where the cache is full of wants already, a ray waits its turn: it would only want more.
        if (outcome_.passes > 0 && ray_context.full()) return false;
        const RayTracer::Progress progress =
            tracer_->advance(at % picture.width, at / picture.width, ray, ray_context, composite);
        if (progress != RayTracer::Progress::kMissing) {
            picture.pixels[at] = composite.pixel();
            explainRay(ray, at);
        } else if (outcome_.passes == 0) {
            // The first picture shows something everywhere: what is resident stands in for what is not.
            picture.pixels[at] = tracer_->provisional(ray, ray_context).pixel();
        }
        return progress == RayTracer::Progress::kFinal;
    };
    auto take = [&](std::uint32_t x, std::uint32_t y) {
        const std::uint32_t at = y * picture.width + x;
        PixelRay ray;
        if (advance(ray, at)) return;
        tile.rays.push_back(std::move(ray));
        tile.where.push_back(at);
    };
    auto takeAll = [&] {
        for (std::uint32_t y = tile.box.y0; y < tile.box.y1; ++y)
            for (std::uint32_t x = tile.box.x0; x < tile.box.x1; ++x) take(x, y);
    };
    if (!tile.begun) {
        tile.begun = true;
        if (!BeamTile::canTrace(plan_)) return takeAll();
        tile.beam.emplace(plan_, light_ ? &*light_ : nullptr, tile.box);
    }
    if (tile.beam) {
        const BeamTile::Progress progress = tile.beam->advance(ray_context);
        if (progress == BeamTile::Progress::kWaiting) return;
        if (progress == BeamTile::Progress::kFailed) {
            tile.beam.reset();
            return takeAll();
        }
        takePixels(*tile.beam);
        stuck_.fetch_add(tile.beam->stuckRays(), std::memory_order_relaxed);
        const std::vector<PixelPlace> others = tile.beam->others();
        tile.beam.reset();
        for (const PixelPlace& place : others) take(place.x, place.y);
        return;
    }
    std::size_t kept = 0;
    for (std::size_t i = 0; i < tile.rays.size(); ++i) {
        const std::uint32_t at = tile.where[i];
        if (advance(tile.rays[i], at)) continue;
        if (kept != i) {
            tile.rays[kept] = std::move(tile.rays[i]);
            tile.where[kept] = at;
        }
        ++kept;
    }
    tile.rays.resize(kept);
    tile.where.resize(kept);
    if (kept == 0) tile.rays.shrink_to_fit(), tile.where.shrink_to_fit();
}

// Every tile that is not done, in order, until what they miss would not fit into the cache.
Result<void> CpuPicture::pass() {
    const Clock::time_point begin = Clock::now();
    cache_->beginPass();
    wants_.clear();
    std::vector<std::uint32_t> open_tiles;
    for (std::uint32_t i = 0; i < tiles_.size(); ++i)
        if (!tiles_[i].done()) open_tiles.push_back(i);

    std::atomic<std::size_t> next{0}, missed{0};
    std::atomic<std::uint64_t> waiting{0};
    const std::size_t room = std::max<std::size_t>(1, cache_->room());
    std::vector<WantList> wants(threads_);
    forEachThread([&](unsigned thread) {
        for (;;) {
            if (missed.load(std::memory_order_relaxed) > room ||
                waiting.load(std::memory_order_relaxed) > kMaxWaitingRays)
                return;
            const std::size_t i = next.fetch_add(1);
            if (i >= open_tiles.size() || late()) return;
            const std::size_t before = wants[thread].size();
            traceTile(open_tiles[i], wants[thread]);
            missed.fetch_add(wants[thread].size() - before, std::memory_order_relaxed);
            waiting.fetch_add(tiles_[open_tiles[i]].waiting(), std::memory_order_relaxed);
        }
    });
    for (const WantList& list : wants) wants_.merge(list);
    outcome_.seconds_render += secondsSince(begin);
    ++outcome_.passes;
    return {};
}

Result<bool> CpuPicture::stream() {
    struct Ranked {
        WantedPage page;
        Want want;
    };
    std::vector<Ranked> ranked;
    for (const auto& [page, want] : wants_.all()) ranked.push_back({page, want});
    if (ranked.empty()) return false;
    // Where not all fits, the first tiles come first: they get done, and their pages may go. Else: most error
    // per byte.
    const std::size_t room = std::max<std::size_t>(1, cache_->room());
    const bool all_fit = ranked.size() <= std::min(room, kMaxWishPages);
    std::sort(ranked.begin(), ranked.end(), [&](const Ranked& a, const Ranked& b) {
        if (a.page.is_block != b.page.is_block) return a.page.is_block;
        if (!all_fit && a.want.tile != b.want.tile) return a.want.tile < b.want.tile;
        const double worth_a = a.want.worth / double(a.want.bytes + 1),
                     worth_b = b.want.worth / double(b.want.bytes + 1);
        if (worth_a != worth_b) return worth_a > worth_b;
        const PageAddress &pa = a.page.address, &pb = b.page.address;
        return std::tie(pa.channel, pa.block, pa.node) < std::tie(pb.channel, pb.block, pb.node);
    });

    PageWish wish;
    std::size_t pages = 0;
    const std::uint64_t streamed = source_.counters().bytes_streamed;
    const std::uint64_t allowed =
        request_.max_stream_bytes > streamed ? request_.max_stream_bytes - streamed : 0;
    for (const Ranked& r : ranked) {
        if (!r.page.is_block && ++pages > room) break;
        if (wish.pages.size() >= kMaxWishPages) break;
        if (wish.credit_bytes + r.want.bytes > allowed) {
            over_budget_ = true;
            break;
        }
        wish.pages.push_back({r.page.is_block, r.page.address});
        wish.credit_bytes += r.want.bytes;
    }
    if (wish.pages.empty()) return false;
    if (Result<void> taken = take(wish); !taken) return tl::unexpected(taken.error());
    return true;
}

// A tile from the pages that are there.
void CpuPicture::drawResident(const Tile& tile, const ResidentTree& tree, LightField* light,
                              const RayContext& ray_context) {
    BeamTile beam(plan_, light, tile.box, &tree);
    beam.advance(ray_context);
    takePixels(beam);
    for (const PixelPlace& place : beam.others()) {
        PixelRay ray;
        tracer_->begin(place.x, place.y, ray);
        const std::uint32_t at = place.y * outcome_.picture.width + place.x;
        outcome_.picture.pixels[at] = tracer_->provisional(ray, ray_context).pixel();
        explainRay(ray, at);
    }
}

void CpuPicture::takePixels(const BeamTile& beam) {
    beam.forEachPixel([&](PixelPlace place, const Pixel& pixel, const BeamTile::Why& why) {
        const std::uint32_t at = place.y * outcome_.picture.width + place.x;
        outcome_.picture.pixels[at] = pixel;
        if (request_.explain) explain(at, why.level, why.waiting, 0, why.stuck);
    });
}

// What a pixel waits for is queued or over budget; which of them is known when the picture ends.
void CpuPicture::explain(std::uint32_t at, float level, float waiting, float failed, bool stuck) {
    outcome_.why[at] = {level, waiting, 0, failed, stuck ? 1.0f : 0.0f};
}

void CpuPicture::explainRay(const PixelRay& ray, std::uint32_t at) {
    if (!request_.explain) return;
    double level = 0, depth = 0;
    float waiting = 0, failed = 0;
    for (const RaySegment& segment : ray.density.segments()) {
        waiting += segment.state != SegmentState::kDone;
        failed += segment.failed;
        level += segment.integral * segment.node.key.level;
        depth += segment.integral;
    }
    explain(at, depth > 0 ? float(level / depth) : 0, waiting, failed, false);
}

ResidentTree CpuPicture::residentTree() const {
    return ResidentTree(*density_, [&](const PageAddress& page) { return cache_->contains(page); });
}

// All that waits, from what is there: tiles of rays, or with `everything` the whole picture, which nothing is
// lit in.
void CpuPicture::drawProvisional(bool everything) {
    const ResidentTree tree = residentTree();
    std::optional<LightField> light;
    if (plan_.scene.light && !everything) light.emplace(plan_, lightDeviation(), &tree);
    const bool in_beams = BeamTile::canTrace(plan_);
    std::atomic<std::size_t> next{0};
    std::vector<WantList> ignored(threads_);
    forEachThread([&](unsigned thread) {
        for (std::size_t i = next.fetch_add(1); i < tiles_.size(); i = next.fetch_add(1)) {
            Tile& tile = tiles_[i];
            const RayContext ray_context = context(ignored[thread], std::uint32_t(i));
            if (in_beams && (everything || tile.beam || !tile.begun)) {
                drawResident(tile, tree, light ? &*light : nullptr, ray_context);
                continue;
            }
            if (!tile.begun) traceTile(std::uint32_t(i), ignored[thread]);
            for (std::size_t r = 0; r < tile.rays.size(); ++r) {
                outcome_.picture.pixels[tile.where[r]] =
                    tracer_->provisional(tile.rays[r], ray_context).pixel();
                explainRay(tile.rays[r], tile.where[r]);
            }
        }
    });
}

// With a limit of bytes or time: coarse first, and then always what takes off most expected error per byte, a
// batch at a time, until the limit, the quality or the data end it.
Result<void> CpuPicture::refineWithinLimits() {
    const double target = plan_.quality.max_error / 3;
    while (!late()) {
        const Clock::time_point begin = Clock::now();
        drawProvisional(/*everything=*/true);
        outcome_.seconds_render += secondsSince(begin);
        ++outcome_.passes;
        if (outcome_.passes == 1) outcome_.seconds_first_image = secondsSince(begin_);
        const std::vector<Pixel>& pixels = outcome_.picture.pixels;
        const bool content = !plan_.quality.reference && !plan_.quality.strict &&
                             std::all_of(pixels.begin(), pixels.end(), [&](const Pixel& pixel) {
                                 return double(pixel.estimate_alpha) <= target;
                             });
        const std::size_t room = cache_->capacity() - std::min(cache_->capacity(), cache_->size());
        if (content || room == 0) return {};

        std::vector<float> transmittance;
        transmittance.reserve(pixels.size());
        for (const Pixel& pixel : pixels) transmittance.push_back(1 - pixel.alpha);
        const std::uint64_t streamed = source_.counters().bytes_streamed;
        PlanRequest asked;
        asked.scale = plan_.scene.density_scale;
        asked.transmittance = transmittance;
        asked.failed = [&](const WantedPage& page) { return failed_.contains(page); };
        asked.batch_bytes = std::max<std::uint64_t>(kLeastBatchBytes, streamed / kBatchShare);
        asked.max_bytes = request_.max_stream_bytes - std::min(streamed, request_.max_stream_bytes);
        const PagePlan plan = planPages(*density_, *plan_.camera, residentTree(), asked);
        over_budget_ |= plan.over_budget;
        PageWish wish;
        for (const PlannedPage& page : plan.pages) {
            if (wish.pages.size() >= room) break;
            wish.pages.push_back({page.page.is_block, page.page.address});
            wish.credit_bytes += page.bytes;
        }
        if (wish.pages.empty()) return {};
        if (Result<void> taken = take(wish); !taken) return taken;
        if (request_.progress) request_.progress(0, pixels.size(), source_.counters().bytes_streamed);
    }
    return {};
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
        overview.credit_bytes =
            std::min({kOverviewBytes, request_.max_stream_bytes, request_.cache_bytes / 4});
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
        for (const Tile& tile : tiles_)
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
    outcome_.final = all_done && failed_.empty();
    outcome_.not_final.failed = failed_.size();
    if (!all_done)
        (over_budget_ ? outcome_.not_final.over_budget : outcome_.not_final.queued) =
            std::max<std::size_t>(1, wants_.size());
    if (over_budget_)
        for (PixelWhy& why : outcome_.why) std::swap(why.queued, why.over_budget);
    outcome_.not_final.no_finer_data = stuck_.load();
    outcome_.streamed = source_.counters();
    outcome_.cache_bytes = cache_->peakBytes();
    outcome_.cache = cache_->counters() - counted_before_;
    outcome_.tree_bytes = density_->treeBytes() + (emission_ ? emission_->treeBytes() : 0);
    outcome_.seconds_total = secondsSince(begin_);
    if (outcome_.final && request_.repeats > 0) {
        const double in_passes = outcome_.seconds_render;
        if (!repeat()) outcome_.seconds_render = in_passes;
    }
    return std::move(outcome_);
}

class CpuRenderer final : public Renderer {
public:
    Result<RenderOutcome> render(BrickSource& source, const RenderRequest& request) override {
        return CpuPicture(source, request).run();
    }
};

}  // namespace

std::unique_ptr<Renderer> makeCpuRenderer() { return std::make_unique<CpuRenderer>(); }

}  // namespace brickyard

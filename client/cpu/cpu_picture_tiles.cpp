// The rays of a picture: passes over its tiles, and what can be drawn with the pages at hand.

#include <cmath>
#include <thread>

#include "client/cpu/cpu_picture.h"

namespace brickyard {

namespace {

constexpr std::uint32_t kTileEdge = 32;
// Rays that wait keep what they have found, some hundreds of bytes each; tiles beyond this are taken up
// later.
constexpr std::uint64_t kMaxWaitingRays = 512u << 10;

}  // namespace

void CpuPicture::forEachThread(const std::function<void(unsigned)>& body) const {
    std::vector<std::jthread> threads;
    for (unsigned t = 1; t < threads_; ++t) threads.emplace_back([&body, t] { body(t); });
    body(0);
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

void CpuPicture::traceTile(std::uint32_t index, WantList& wants) {
    PictureTile& tile = tiles_[index];
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
        stuck_.fetch_add(takePixels(*tile.beam), std::memory_order_relaxed);
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
    const std::chrono::steady_clock::time_point begin = std::chrono::steady_clock::now();
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

// A tile from the pages that are there.
void CpuPicture::drawResident(const PictureTile& tile, const ResidentTree& tree, LightField* light,
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

// Gives how many pixels the finest data leave above the error asked for.
std::uint64_t CpuPicture::takePixels(const BeamTile& beam) {
    std::uint64_t stuck = 0;
    beam.forEachPixel([&](PixelPlace place, const Pixel& pixel, const BeamTile::Why& why) {
        const std::uint32_t at = place.y * outcome_.picture.width + place.x;
        outcome_.picture.pixels[at] = pixel;
        stuck += why.stuck;
        if (request_.explain) explain(at, why.level, why.waiting, 0, why.stuck);
    });
    return stuck;
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
            PictureTile& tile = tiles_[i];
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

}  // namespace brickyard

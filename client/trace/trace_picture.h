// One picture of a scene that the beams do not draw: whole scenes, marched or traced by random paths. The
// loop is the same: rays, misses, wishes, arrivals, until every sample of every pixel is done. A sample is a
// pure function of the scene and its number: one that misses a page is drawn again when the page is there, so
// the picture does not depend on threads, cache or network. Drawn once, by one thread, which brings others.
#pragma once

#include <atomic>
#include <chrono>
#include <deque>
#include <functional>
#include <optional>
#include <vector>

#include "client/elapsed.h"
#include "client/frame_stream.h"
#include "client/renderer.h"
#include "client/trace/path_walk.h"
#include "client/trace/shadow_maps.h"
#include "client/trace/traced_world.h"

namespace brickyard {

// Whether a request asks for nothing but what the beams draw (client/cpu/beam_tile.h), and faster.
bool drawnByBeams(const RenderRequest& request);

class TracePicture {
public:
    TracePicture(BrickSource& source, const RenderRequest& request);
    Result<RenderOutcome> run();

private:
    // What a thread holds during a pass.
    struct Worker {
        std::vector<WantList> wants;       // by stream
        std::vector<RayContext> contexts;  // by stream
    };
    // What it reads a tile or a block with.
    struct Readers {
        Readers(const TracedWorld& world, std::span<const RayContext> contexts)
            : view(world, contexts), shadow(world, contexts) {
            if (!world.surfaces.empty()) surfaces.emplace(world, contexts);
        }
        SurfaceHits* hits() { return surfaces ? &*surfaces : nullptr; }
        bool takeMissed() {
            bool missed = view.takeMissed();
            missed |= shadow.takeMissed();
            if (surfaces) missed |= surfaces->takeMissed();
            return missed;
        }
        WorldReader view, shadow;
        std::optional<SurfaceHits> surfaces;
    };
    // What has been summed up of a pixel's samples.
    struct PixelSum {
        glm::dvec3 radiance{0};
        double radiance_square = 0;  // of the greatest component
        double greatest = 0;
        double alpha = 0, alpha_square = 0, depth = 0, depth_weight = 0;
        double alpha_deviation = 0, radiance_deviation = 0;
        std::uint32_t samples = 0;
        bool done = false;
    };
    struct Tile {
        std::uint32_t x0 = 0, y0 = 0, x1 = 0, y1 = 0;
        // Of the round under way: samples by pixel of the tile, and which of them are there.
        std::vector<RaySample> round;
        std::vector<std::uint8_t> have;
        std::uint32_t round_samples = 0;  // 0: none is under way
        bool done = false;
    };

    Result<void> open();
    Result<void> openFrames();
    Result<void> openChannels();
    void moveToOrigin();
    void makeLights();
    // Levels of detail that the error allows, and how coarse they get.
    void setAccuracy();
    Result<void> overview();
    // Steps until nothing is missing: topology, shadow maps, pixels. False where the limits ended it.
    Result<bool> prepare();
    Result<bool> buildShadowMaps();
    Result<void> draw();
    // Where time was up before anything was drawn: every few pixels, whatever it takes.
    void drawRough();
    // The whole picture again with the pages that are there; false where one is missing.
    bool repeat();
    void makeTiles();
    void traceTile(std::size_t index, Worker& worker);
    RaySample traceSample(std::uint32_t x, std::uint32_t y, std::uint32_t sample, RayMarch& march,
                          PathWalk& walk) const;
    void finishRound(Tile& tile);
    void writePixel(std::uint32_t at);
    void writeStandIn(const RaySample& sample, std::uint32_t at);
    double rayEnd(std::uint32_t x, std::uint32_t y) const;
    // Runs `body(worker, next)` on all threads; `next()` gives items until they are out, the cache is full of
    // wants, or time is up. Merges what was missed.
    void pass(std::size_t items, const std::function<void(std::size_t, Worker&)>& body);
    // Sends what the last pass missed and takes in what comes. False where nothing may come.
    Result<bool> stream();
    bool missedAnything() const;
    void finish();

    SourceDeadline deadline() const {
        if (!request_.deadline) return SourceDeadline::max();
        return begin_ + std::chrono::duration_cast<std::chrono::steady_clock::duration>(*request_.deadline);
    }
    bool late() const { return std::chrono::steady_clock::now() >= deadline(); }

    const RenderRequest& request_;
    std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
    std::deque<FrameStream>
        streams_;  // the request's own, others, and those of the frames after, in that order
    std::vector<std::uint32_t> frames_;
    std::size_t bound_count_ = 0;  // of them, those that the scene is bound to; behind them the frames after
    std::vector<FrameFooter> footers_;
    std::vector<std::string> names_;
    TracedWorld world_;
    WorldSettings next_settings_;
    std::optional<PinholeCamera> camera_;
    glm::dvec3 origin_{0};
    std::optional<ShadowMaps> maps_;
    std::vector<Tile> tiles_;
    std::vector<PixelSum> sums_;
    std::vector<WantList> wants_;  // by stream, of the last pass
    std::atomic<std::uint64_t> finished_samples_{0}, rounds_{0}, stuck_{0};
    std::uint32_t samples_ = 1;  // a pixel; 0: as the error asks
    std::uint32_t most_samples_ = 1;
    bool over_budget_ = false;
    bool one_by_one_ = false;  // the cache is too small for many rays at a time
    unsigned threads_ = 1;
    RenderOutcome outcome_;
};

}  // namespace brickyard

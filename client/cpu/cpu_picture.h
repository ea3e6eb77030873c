// One picture under way on the CPU: tiles of rays over all cores, pass by pass, and the pages that come in
// between. Drawn once, by one thread, which brings others for the rays. cpu_renderer.cpp: the loop;
// cpu_picture_tiles.cpp: rays; cpu_picture_pages.cpp: what is asked for and what comes.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <functional>
#include <optional>
#include <vector>

#include "client/cpu/beam_tile.h"
#include "client/cpu/ray_tracer.h"
#include "client/elapsed.h"
#include "client/frame_stream.h"
#include "client/renderer.h"

namespace brickyard {

struct PictureTile {
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
        : source_(source), request_(request), stream_(source, request.kept) {}

    Result<RenderOutcome> run();

private:
    Result<void> open();
    Result<void> pass();
    void makeTiles();
    void makeLight();
    bool allDone() const {
        return std::all_of(tiles_.begin(), tiles_.end(), [](const PictureTile& tile) { return tile.done(); });
    }
    bool repeat();
    void traceTile(std::uint32_t index, WantList& wants);
    void drawResident(const PictureTile& tile, const ResidentTree& tree, LightField* light,
                      const RayContext& context);
    void drawProvisional(bool everything);
    std::uint64_t takePixels(const BeamTile& beam);
    void explain(std::uint32_t at, float level, float waiting, float failed, bool stuck);
    void explainRay(const PixelRay& ray, std::uint32_t at);
    ResidentTree residentTree() const;
    Result<void> refineWithinLimits();
    double lightDeviation() const;
    // Sends the wants of the last pass and takes in what comes. False when nothing more may come.
    Result<bool> stream();
    Result<void> take(const PageWish& wish) { return stream_.take(wish, deadline()); }
    SourceDeadline deadline() const {
        if (!request_.deadline) return SourceDeadline::max();
        return begin_ + std::chrono::duration_cast<std::chrono::steady_clock::duration>(*request_.deadline);
    }
    bool late() const {
        return request_.deadline && std::chrono::steady_clock::now() - begin_ >= *request_.deadline;
    }
    void forEachThread(const std::function<void(unsigned)>& body) const;
    RayContext context(WantList& wants, std::uint32_t tile) const {
        return {cache_, &stream_.failed(), &wants, tile, std::max<std::size_t>(1, cache_->room() / threads_)};
    }

    BrickSource& source_;
    const RenderRequest& request_;
    std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
    RenderOutcome outcome_;
    std::optional<PinholeCamera> camera_;
    FrameStream stream_;  // owns the next three
    PagedChannel *density_ = nullptr, *emission_ = nullptr;
    PageCache* cache_ = nullptr;
    RenderPlan plan_;
    std::optional<RayTracer> tracer_;
    std::optional<LightField> light_;
    std::vector<PictureTile> tiles_;
    WantList wants_;
    unsigned threads_ = 1;
    std::atomic<std::uint64_t> stuck_{0};
    bool over_budget_ = false;
};

}  // namespace brickyard

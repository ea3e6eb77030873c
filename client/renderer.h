// A picture from a source of bricks: the loop of draw, miss, wish, arrive (Crassin et al., GigaVoxels, 2009)
// until nothing that matters is missing. One Renderer draws one picture at a time; it brings its own threads
// for the rays.
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "client/brick_source.h"
#include "client/cpu/render_plan.h"
#include "client/picture.h"
#include "client/resident_frame.h"
#include "client/world_settings.h"
#include "core/result.h"

namespace brickyard {

// A further frame that a picture reads: of another dataset of the scene, or the next one of the same.
struct RenderInput {
    std::string dataset;  // its name in the scene; "" for the command line's
    BrickSource* source =
        nullptr;  // drives one frame: another one than the request's own. Outlives the picture
    std::uint32_t frame = 0;
    ResidentFrame* kept = nullptr;  // as RenderRequest::kept
};

// What lies between two frames.
enum class BetweenFrames : std::uint8_t { kAdvect, kBlend };

struct RenderRequest {
    std::uint32_t frame = 0;
    // Of the way to the next frame, in [0, 1); above 0 `next` is there. Advection needs a velocity channel; a
    // medium without one is blended.
    double between = 0;
    BetweenFrames between_by = BetweenFrames::kAdvect;
    std::vector<RenderInput> next;    // of the frame after, one for each dataset that the scene reads
    std::vector<RenderInput> others;  // the scene's other datasets
    std::string dataset;              // name of the request's own source in the scene; "" where it has none
    std::filesystem::path folder;     // where relative names in the scene begin
    std::uint32_t width = 640, height = 480;
    std::optional<Camera> camera;  // absent: the dataset is framed
    Scene scene;
    std::optional<double> density_scale;  // wins over the scene's
    QualitySettings quality;
    // Multiple scattering by unbiased tracking, `samples` paths a pixel; 0: as many as the error asks for.
    bool path = false;
    // Rays a pixel, stratified; 1: its centre. A picture that can be drawn the fast way is, where this is 1.
    std::uint32_t samples = 1;
    std::uint64_t seed = 0;
    std::uint32_t most_bounces = 64;      // of a path
    std::optional<FieldFilter> filter;    // wins over the scene's
    std::optional<ShadowMethod> shadows;  // of lights that leave it open
    // Of the picture's size: rays end at its depth (Z, where above 0). Outlives the picture.
    const Picture* behind = nullptr;
    std::uint64_t cache_bytes = 1u << 30;
    // What earlier pictures of the frame left, and what this one leaves; begins anew where it is of another
    // frame or budget. nullptr: the picture starts from nothing and keeps nothing. Outlives the picture.
    ResidentFrame* kept = nullptr;
    std::uint64_t max_stream_bytes = UINT64_MAX;
    std::optional<std::chrono::duration<double>> deadline;
    unsigned threads = 0;  // 0: one per processor
    // A final picture is traced this many times more with all of its pages resident, for the time that takes.
    unsigned repeats = 0;
    bool explain = false;  // fill in RenderOutcome::why
    // Told after each pass: pixels final, of how many, and bytes streamed. May be empty.
    std::function<void(std::uint64_t done, std::uint64_t pixels, std::uint64_t bytes)> progress;
};

// Why a picture is not final: pages by reason.
struct NotFinal {
    std::uint64_t queued = 0;         // the deadline came first
    std::uint64_t over_budget = 0;    // --max-bytes came first
    std::uint64_t failed = 0;         // cannot be had; first_failure says why
    std::uint64_t no_finer_data = 0;  // pixels that the finest level leaves above the error asked for
};

struct RenderOutcome {
    Picture picture;
    std::vector<PixelWhy> why;  // by pixel, where it was asked for
    std::array<float, 3> background{};
    Camera camera;  // as used
    bool final = false;
    NotFinal not_final;
    std::string first_failure;  // names dataset, frame, channel and brick
    std::uint64_t retried = 0;  // pages and tree blocks that came damaged and were asked for once more
    double seconds_total = 0, seconds_first_image = 0;
    // Rays only: of all passes, or with RenderRequest::repeats the median of those (all pages resident).
    double seconds_render = 0;
    SourceCounters streamed;        // since the source was opened
    std::uint64_t cache_bytes = 0;  // most that the page cache held
    std::uint64_t light_bytes = 0;  // lattices of the light, beside the cache
    std::uint64_t tree_bytes = 0;   // octree topology in memory
    PageCacheCounters cache;        // of this picture
    std::uint64_t passes = 0;
    std::string method;         // how it was drawn: "beams", "march" or "path"
    std::uint64_t samples = 1;  // most rays of a pixel
};

class Renderer {
public:
    virtual ~Renderer() = default;
    // Errors: those of the source; kNotFound and kInvalid (frame, channel, camera); kInvalid where the cache
    // cannot hold a single brick. A page that cannot be had is no error: see RenderOutcome::not_final.
    virtual Result<RenderOutcome> render(BrickSource& source, const RenderRequest& request) = 0;
};

std::unique_ptr<Renderer> makeCpuRenderer();

// What a picture that starts from nothing asks for first, for openSource(): it then begins with the server's
// first answer. `frame` absent: the first there is.
StartHint startHint(const RenderRequest& request, std::optional<std::uint32_t> frame);

}  // namespace brickyard

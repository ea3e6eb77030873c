// `brickyard bench fly`: a camera flies through a medium with a page cache that holds a part of what it sees:
// whether the budget and the memory hold, and how often a page is there already.
#include <fmt/format.h>
#include <malloc.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>

#include "core/camera_framing.h"
#include "tools/bench/bench_cache.h"
#include "tools/bench/benchmark.h"
#include "tools/bench/fly_path.h"
#include "tools/bench/plot.h"
#include "tools/bench/synthetic_cloud.h"
#include "tools/bench/text_table.h"
#include "tools/bench/timing.h"

namespace brickyard {
namespace {

constexpr int kFrames = 300;
constexpr std::uint32_t kLargestPicture = 192;
constexpr double kMaxError = 0.02;
// The budget, of all the pages that the flight needs.
constexpr double kBudgetShare = 1.0 / 3;
// Optical depth of half of the framing view's rays that meet anything.
constexpr double kMedianDepth = 1.5;
// Most memory of the last third of the flight over the middle third's: what counts as flat. What the
// allocator keeps for itself, an arena a thread, goes up by steps for a while.
constexpr double kFlatHeap = 1.005, kFlatResident = 1.05;
// A cloud for pictures of some size, and one for a quick run.
constexpr int kCloudEdge = 512, kQuickCloudEdge = 128;
constexpr std::uint32_t kQuickPicture = 96;

struct FlyScene {
    std::string name;
    std::filesystem::path folder;
    std::string channel;
    std::uint32_t frame = 0;
    Camera framing;
    double density_scale = 1;
};

struct FlyFrame {
    double seconds = 0;
    std::uint64_t bytes = 0;  // streamed
    std::uint64_t cache_bytes = 0, tree_bytes = 0, resident_bytes = 0, heap_bytes = 0;
    PageCacheCounters cache;
    bool final = false;
};

struct Flight {
    std::vector<FlyFrame> frames;
    Picture last;
    std::uint64_t bytes() const {
        std::uint64_t sum = 0;
        for (const FlyFrame& frame : frames) sum += frame.bytes;
        return sum;
    }
    PageCacheCounters cache() const {
        PageCacheCounters sum;
        for (const FlyFrame& frame : frames) {
            sum.hits += frame.cache.hits, sum.loads += frame.cache.loads;
            sum.evictions += frame.cache.evictions, sum.reloads += frame.cache.reloads;
        }
        return sum;
    }
    using FrameBytes = std::uint64_t FlyFrame::*;
    // The most in the last third of the frames over the most in the middle third.
    double growth(FrameBytes bytes) const {
        const std::size_t third = frames.size() / 3;
        std::uint64_t before = 1, after = 0;
        for (std::size_t i = third; i < 2 * third; ++i) before = std::max(before, frames[i].*bytes);
        for (std::size_t i = 2 * third; i < 3 * third; ++i) after = std::max(after, frames[i].*bytes);
        return double(after) / double(before);
    }
};

// What this process has allocated and not freed, without the allocator's own reserves.
std::uint64_t heapBytes() {
    const struct mallinfo2 info = ::mallinfo2();
    return std::uint64_t(info.uordblks) + std::uint64_t(info.hblkhd);
}

// Of this process, as the system counts it; 0 where it does not say.
std::uint64_t residentBytes() {
    std::ifstream file("/proc/self/statm");
    std::uint64_t total = 0, resident = 0;
    file >> total >> resident;
    return resident * std::uint64_t(::sysconf(_SC_PAGESIZE));
}

class FlyBench {
public:
    explicit FlyBench(const BenchOptions& options)
        : options_(options), edge_(std::min(options.size, kLargestPicture)) {}

    Result<nlohmann::json> run() {
        auto scenes = makeScenes();
        if (!scenes) return tl::unexpected(scenes.error());
        csv_ =
            "scene,frame,seconds,final,hit_rate,hits,loads,reloads,evictions,bytes_streamed,cache_bytes,"
            "tree_bytes,resident_bytes,heap_bytes\n";
        for (const FlyScene& scene : *scenes)
            if (Result<void> done = runScene(scene); !done)
                return fail(done.error().code, fmt::format("{}: {}", scene.name, done.error().message));
        std::ofstream file(options_.output / "fly.csv");
        if (!(file << csv_ << std::flush))
            return fail(ErrorCode::kIo, fmt::format("{}: cannot be written; is the disk full?",
                                                    (options_.output / "fly.csv").string()));
        report();
        return nlohmann::json{{"size", edge_}, {"frames", kFrames}, {"flights", figures_}};
    }

private:
    Result<std::vector<FlyScene>> makeScenes() {
        const Result<std::vector<BenchCache>> caches = findCaches(options_.data);
        if (!caches) return tl::unexpected(caches.error());
        const BenchCache& cache = caches->front();
        options_.progress(fmt::format("converting {}", cache.name));
        std::vector<FlyScene> scenes{
            {cache.name, options_.scratch / "cache.bricks", cache.channel, 0, {}, 1}};
        const Result<BenchDataset> dataset = convertCache(cache, scenes[0].folder, 0, {cache.channel});
        if (!dataset) return tl::unexpected(dataset.error());

        options_.progress("making a cloud");
        const int cloud = edge_ < kQuickPicture ? kQuickCloudEdge : kCloudEdge;
        scenes.push_back(
            {fmt::format("cloud {}", cloud), options_.scratch / "cloud.bricks", "density", 0, {}, 1});
        if (Result<void> stored = storeSyntheticCloud(cloud, scenes[1].folder); !stored)
            return tl::unexpected(stored.error());
        for (FlyScene& scene : scenes)
            if (Result<void> looked = look(scene); !looked) return tl::unexpected(looked.error());
        return scenes;
    }

    // Finds the scene's frame, camera and density scale.
    Result<void> look(FlyScene& scene) const {
        const auto source = openSource(scene.folder.string(), /*token=*/"");
        if (!source) return tl::unexpected(source.error());
        scene.frame = (*source)->manifest().frames(0).frame();
        const Result<FrameFooter> footer = (*source)->openFrame(scene.frame);
        if (!footer) return tl::unexpected(footer.error());
        for (const ChannelFooter& channel : footer->channels())
            if (channel.name() == scene.channel) scene.framing = frameChannel(channel, /*aspect=*/1);

        // So thin that alpha is proportional to the optical depth.
        constexpr double kThin = 1e-9;
        RenderRequest request = requestOf(scene, scene.framing);
        request.density_scale = kThin;
        request.quality = {.reference = true};
        const Result<RenderOutcome> thin = makeCpuRenderer()->render(**source, request);
        if (!thin) return tl::unexpected(thin.error());
        std::vector<double> depths;
        for (const Pixel& pixel : thin->picture.pixels)
            if (pixel.alpha > 0) depths.push_back(double(pixel.alpha) / kThin);
        if (depths.empty()) return fail(ErrorCode::kNotFound, "nothing in it can be seen");
        std::nth_element(depths.begin(), depths.begin() + std::ptrdiff_t(depths.size() / 2), depths.end());
        scene.density_scale = kMedianDepth / depths[depths.size() / 2];
        return {};
    }

    RenderRequest requestOf(const FlyScene& scene, const Camera& camera) const {
        RenderRequest request;
        request.frame = scene.frame;
        request.width = request.height = edge_;
        request.camera = camera;
        request.scene.mutable_medium()->set_density(scene.channel);
        request.density_scale = scene.density_scale;
        request.quality.max_error = kMaxError;
        return request;
    }
    static Camera cameraOf(const FlyScene& scene, int frame) {
        return flyCamera(scene.framing, double(frame) / (kFrames - 1));
    }

    Result<Flight> fly(const FlyScene& scene, std::uint64_t budget_bytes, const std::string& what) const {
        const auto source = openSource(scene.folder.string(), /*token=*/"");
        if (!source) return tl::unexpected(source.error());
        const std::unique_ptr<Renderer> renderer = makeCpuRenderer();
        ResidentFrame kept;
        Flight flight;
        flight.frames.reserve(kFrames);
        std::uint64_t streamed = 0;
        for (int i = 0; i < kFrames; ++i) {
            options_.progress(fmt::format("{}, {}: frame {} of {}", scene.name, what, i + 1, kFrames));
            RenderRequest request = requestOf(scene, cameraOf(scene, i));
            request.cache_bytes = budget_bytes;
            request.kept = &kept;
            Result<RenderOutcome> outcome = renderer->render(**source, request);
            if (!outcome) return tl::unexpected(outcome.error());
            FlyFrame& frame = flight.frames.emplace_back();
            frame.seconds = outcome->seconds_total;
            frame.bytes = outcome->streamed.bytes_streamed - streamed;
            streamed = outcome->streamed.bytes_streamed;
            frame.cache_bytes = outcome->cache_bytes;
            frame.tree_bytes = outcome->tree_bytes;
            frame.cache = outcome->cache;
            frame.final = outcome->final;
            if (i + 1 == kFrames) flight.last = std::move(outcome->picture);
            frame.resident_bytes = residentBytes();
            frame.heap_bytes = heapBytes();
        }
        return flight;
    }

    Result<void> runScene(const FlyScene& scene) {
        // First with room for all: what the flight needs at least, and how much that is.
        const Result<Flight> roomy = fly(scene, std::uint64_t(1) << 40, "room for all");
        if (!roomy) return tl::unexpected(roomy.error());
        const std::uint64_t working_set = roomy->frames.back().cache_bytes;
        const auto budget = std::uint64_t(kBudgetShare * double(working_set));
        // What the allocator still holds of it would hide that memory grows.
        ::malloc_trim(0);
        const Result<Flight> tight = fly(scene, budget, "a third of it");
        if (!tight) return tl::unexpected(tight.error());

        const auto source = openSource(scene.folder.string(), /*token=*/"");
        if (!source) return tl::unexpected(source.error());
        const Result<RenderOutcome> fresh =
            makeCpuRenderer()->render(**source, requestOf(scene, cameraOf(scene, kFrames - 1)));
        if (!fresh) return tl::unexpected(fresh.error());
        std::size_t differ = 0;
        for (std::size_t i = 0; i < fresh->picture.pixels.size(); ++i)
            differ += std::memcmp(&fresh->picture.pixels[i], &tight->last.pixels[i], sizeof(Pixel)) != 0;
        note(scene, *roomy, *tight, working_set, budget, differ);
        return plot(scene, *roomy, *tight, budget);
    }

    void note(const FlyScene& scene, const Flight& roomy, const Flight& tight, std::uint64_t working_set,
              std::uint64_t budget, std::size_t differ) {
        std::uint64_t most = 0, largest_view = 0, tree = 0;
        bool final = true;
        Timing seconds;
        for (std::size_t i = 0; i < tight.frames.size(); ++i) {
            const FlyFrame& frame = tight.frames[i];
            csv_ += fmt::format("{},{},{:.5f},{:d},{:.4f},{},{},{},{},{},{},{},{},{}\n", scene.name, i + 1,
                                frame.seconds, frame.final, frame.cache.hitRate(), frame.cache.hits,
                                frame.cache.loads, frame.cache.reloads, frame.cache.evictions, frame.bytes,
                                frame.cache_bytes, frame.tree_bytes, frame.resident_bytes, frame.heap_bytes);
            most = std::max(most, frame.cache_bytes);
            tree = std::max(tree, frame.tree_bytes);
            const PageCacheCounters& all = roomy.frames[i].cache;
            largest_view = std::max(largest_view, all.hits + all.loads);
            final &= frame.final;
            seconds.add(frame.seconds);
        }
        const PageCacheCounters sum = tight.cache(), least = roomy.cache();
        const std::uint64_t page_bytes = least.loads > 0 ? working_set / least.loads : 0;
        const double heap = tight.growth(&FlyFrame::heap_bytes);
        const double resident = tight.growth(&FlyFrame::resident_bytes);
        const bool flat = heap <= kFlatHeap && resident <= kFlatResident;
        figures_.push_back({{"scene", scene.name},
                            {"working_set_bytes", working_set},
                            {"largest_view_bytes", largest_view * page_bytes},
                            {"budget_bytes", budget},
                            {"most_cache_bytes", most},
                            {"tree_bytes", tree},
                            {"budget_holds", most <= budget},
                            {"all_final", final},
                            {"hit_rate", sum.hitRate()},
                            {"hit_rate_with_room_for_all", least.hitRate()},
                            {"bytes_streamed", tight.bytes()},
                            {"bytes_streamed_with_room_for_all", roomy.bytes()},
                            {"loads", sum.loads},
                            {"reloads", sum.reloads},
                            {"evictions", sum.evictions},
                            {"heap_last_over_middle_third", heap},
                            {"resident_last_over_middle_third", resident},
                            {"memory_is_flat", flat},
                            {"seconds_a_frame", seconds.median()},
                            {"pixels_unlike_a_fresh_picture", differ}});
        rows_.push_back(
            {scene.name, fmt::format("{:.1f}", double(working_set) / 1e6),
             fmt::format("{:.1f}", double(largest_view * page_bytes) / 1e6),
             fmt::format("{:.1f}", double(budget) / 1e6), fmt::format("{:.1f}", double(most) / 1e6),
             fmt::format("{:.1f} %", 100 * sum.hitRate()), fmt::format("{:.1f} %", 100 * least.hitRate()),
             fmt::format("{:.1f}", double(tight.bytes()) / 1e6),
             fmt::format("{:.1f}", double(roomy.bytes()) / 1e6), fmt::format("{}", sum.reloads),
             cell(seconds.median())});
        verdicts_.push_back(fmt::format(
            "{}: the budget {}; {} final; of the last third of the flight over the middle third the heap is "
            "{:.4f} "
            "and the resident set {:.4f} ({}); {} pixels of frame {} unlike a fresh picture's.",
            scene.name, most <= budget ? "is never exceeded" : "IS EXCEEDED",
            final ? "all frames" : "NOT ALL", heap, resident, flat ? "flat" : "IT GROWS", differ, kFrames));
    }

    Result<void> plot(const FlyScene& scene, const Flight& roomy, const Flight& tight,
                      std::uint64_t budget) const {
        auto series = [](const char* name, const Flight& flight, auto value) {
            PlotSeries out{name, {}, true, false};
            for (std::size_t i = 0; i < flight.frames.size(); ++i)
                out.points.push_back({double(i + 1), value(flight.frames[i]), std::string(), false});
            return out;
        };
        auto hit_rate = [](const FlyFrame& frame) { return frame.cache.hitRate(); };
        auto streamed = [](const FlyFrame& frame) { return double(frame.bytes) / 1e3; };
        const PlotPanel panels[] = {
            {scene.name + ": hit rate",
             "frame",
             "pages that were there",
             false,
             false,
             {series("a third of the working set", tight, hit_rate),
              series("room for all", roomy, hit_rate)}},
            {"Streamed",
             "frame",
             "kB",
             false,
             false,
             {series("a third of the working set", tight, streamed),
              series("room for all", roomy, streamed)}},
            {"Memory",
             "frame",
             "MB",
             false,
             false,
             {series("cache", tight, [](const FlyFrame& frame) { return double(frame.cache_bytes) / 1e6; }),
              series("budget", tight, [&](const FlyFrame&) { return double(budget) / 1e6; }),
              series("heap in use", tight,
                     [](const FlyFrame& frame) { return double(frame.heap_bytes) / 1e6; }),
              series("resident set of the process", tight,
                     [](const FlyFrame& frame) { return double(frame.resident_bytes) / 1e6; })}}};
        std::string file = "fly_" + scene.name;
        std::replace(file.begin(), file.end(), ' ', '_');
        return writePlot(panels, options_.output / file);
    }

    void report() {
        TextTable table({"MB", "all pages", "largest view", "budget", "most held", "hits",
                         "hits, room for all", "streamed", "streamed, room for all", "reloads", "s a frame"});
        for (std::vector<std::string>& row : rows_) table.add(std::move(row));
        options_.print(table.text());
        for (const std::string& verdict : verdicts_) options_.print(verdict);
    }

    const BenchOptions& options_;
    const std::uint32_t edge_;
    std::string csv_;
    std::vector<std::vector<std::string>> rows_;
    std::vector<std::string> verdicts_;
    nlohmann::json figures_ = nlohmann::json::array();
};

}  // namespace

Result<nlohmann::json> benchFly(const BenchOptions& options) { return FlyBench(options).run(); }

}  // namespace brickyard

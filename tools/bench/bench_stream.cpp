// `brickyard bench stream`: how good a picture is by the bytes that were streamed for it, for our order of
// pages and others, beside an oracle.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <fstream>

#include "core/dataset.h"
#include "tools/bench/bench_cache.h"
#include "tools/bench/benchmark.h"
#include "tools/bench/plot.h"
#include "tools/bench/stream_run.h"
#include "tools/bench/stream_views.h"
#include "tools/bench/synthetic_cloud.h"
#include "tools/bench/text_table.h"

namespace brickyard {
namespace {

constexpr int kCloudEdge = 512;
constexpr std::size_t kMostCaches = 3;
// Pictures are at most this wide: every stretch of every ray is kept.
constexpr std::uint32_t kLargestPicture = 192;
constexpr double kLevels[] = {30, 40, 50};  // dB
constexpr double kTarget = 40, kHighestPlotted = 65;
constexpr double kMostOverOracle = 1.3;
// Density is scaled so that half of the rays that meet anything, framed, are at least this deep.
constexpr double kCacheDepth = 1, kCloudDepth = 2;

struct StreamScene {
    std::string name;
    std::filesystem::path folder;
    std::string channel;
    double median_depth = kCacheDepth;
};

struct NamedRun {
    const char* name;
    StreamRun run;
};

class StreamBench {
public:
    explicit StreamBench(const BenchOptions& options)
        : options_(options), edge_(std::min(options.size, kLargestPicture)) {}

    Result<nlohmann::json> run() {
        auto scenes = makeScenes();
        if (!scenes) return tl::unexpected(scenes.error());
        csv_ = "scene,view,order,bytes,psnr_db,worst_error\n";
        for (const StreamScene& scene : *scenes)
            if (Result<void> done = runScene(scene); !done)
                return fail(done.error().code, fmt::format("{}: {}", scene.name, done.error().message));
        std::ofstream file(options_.output / "stream.csv");
        if (!(file << csv_ << std::flush))
            return fail(ErrorCode::kIo, fmt::format("{}: cannot be written; is the disk full?",
                                                    (options_.output / "stream.csv").string()));
        report();
        return nlohmann::json{{"size", edge_},
                              {"views", figures_},
                              {"fewest_bytes_at_40_db", fewest_},
                              {"worst_over_oracle_at_40_db", worst_},
                              {"views_counted", views_}};
    }

private:
    Result<std::vector<StreamScene>> makeScenes() {
        const Result<std::vector<BenchCache>> caches = findCaches(options_.data);
        if (!caches) return tl::unexpected(caches.error());
        std::vector<StreamScene> scenes;
        for (std::size_t i = 0; i < std::min(caches->size(), kMostCaches); ++i) {
            const BenchCache& cache = (*caches)[i];
            options_.progress(fmt::format("converting {}", cache.name));
            const std::filesystem::path folder = options_.scratch / fmt::format("{}.bricks", i);
            const Result<BenchDataset> dataset = convertCache(cache, folder, 0, {cache.channel});
            if (!dataset) return tl::unexpected(dataset.error());
            scenes.push_back({cache.name, folder, cache.channel, kCacheDepth});
        }
        options_.progress("making a cloud");
        const std::filesystem::path cloud = options_.scratch / "cloud.bricks";
        if (Result<void> stored = storeSyntheticCloud(kCloudEdge, cloud); !stored)
            return tl::unexpected(stored.error());
        scenes.push_back({fmt::format("cloud {}", kCloudEdge), cloud, "density", kCloudDepth});
        return scenes;
    }

    Result<void> runScene(const StreamScene& scene) {
        const Result<Dataset> dataset = Dataset::open(scene.folder);
        if (!dataset) return tl::unexpected(dataset.error());
        const auto store = dataset->openFrame(dataset->manifest().frames(0).frame());
        if (!store) return tl::unexpected(store.error());
        const FrameFooter& footer = (*store)->footer();
        std::uint32_t channel = 0;
        while (footer.channels(int(channel)).name() != scene.channel) ++channel;  // it was converted

        const std::vector<BenchView> views = streamViews(footer.channels(int(channel)));
        std::optional<double> scale;
        for (const BenchView& view : views) {
            if (view.name != "framing") continue;
            const Result<PinholeCamera> camera = PinholeCamera::create(view.camera, edge_, edge_);
            if (!camera) return tl::unexpected(camera.error());
            const Result<double> found = streamScale(**store, channel, *camera, scene.median_depth);
            if (!found) return tl::unexpected(found.error());
            scale = *found;
        }
        std::vector<PlotPanel> quality, worst;
        for (const BenchView& view : views) {
            options_.progress(fmt::format("{}, {}", scene.name, view.name));
            const Result<PinholeCamera> camera = PinholeCamera::create(view.camera, edge_, edge_);
            if (!camera) return tl::unexpected(camera.error());
            const Result<StreamTable> table = StreamTable::create(**store, channel, *camera, *scale);
            if (!table) return tl::unexpected(table.error());
            StreamRunOptions run;
            run.scale = *scale;
            const std::vector<NamedRun> runs = {
                {"ours", runOrder(*table, **store, *camera, PageOrder::kErrorPerByte, run)},
                {"GigaVoxels", runOrder(*table, **store, *camera, PageOrder::kProjectedSize, run)},
                {"breadth-first", runOrder(*table, **store, *camera, PageOrder::kBreadthFirst, run)},
                {"oracle", runOracle(*table, run)}};
            note(scene, view.name, runs);
            quality.push_back(panel(scene.name + ", " + view.name, "PSNR of alpha, dB", false, runs));
            worst.push_back(panel(scene.name + ", " + view.name, "worst error of alpha", true, runs));
        }
        std::string file = "stream_" + scene.name;
        std::replace(file.begin(), file.end(), ' ', '_');
        if (Result<void> plotted = writePlot(quality, options_.output / (file + "_psnr")); !plotted)
            return plotted;
        return writePlot(worst, options_.output / (file + "_worst"));
    }

    static PlotPanel panel(const std::string& title, const char* y_label, bool worst,
                           const std::vector<NamedRun>& runs) {
        PlotPanel panel{title, "bytes", y_label, true, worst, {}};
        for (const NamedRun& named : runs) {
            PlotSeries series{named.name, {}, true, false};
            // The last page may make the picture exact: no decibels tell that.
            for (const StreamPoint& point : named.run.points)
                series.points.push_back({double(point.bytes),
                                         worst ? point.worst : std::min(point.psnr, kHighestPlotted),
                                         std::string(), false});
            panel.series.push_back(std::move(series));
        }
        return panel;
    }

    void note(const StreamScene& scene, const std::string& view, const std::vector<NamedRun>& runs) {
        nlohmann::json figure{{"scene", scene.name}, {"view", view}};
        std::vector<std::string> row{scene.name + ", " + view};
        for (const NamedRun& named : runs) {
            nlohmann::json bytes;
            for (double level : kLevels) bytes.push_back(named.run.bytesTo(level));
            figure["bytes_to_30_40_50_db"][named.name] = bytes;
            figure["plans"][named.name] = named.run.plans;
            figure["plan_seconds"][named.name] = named.run.plan_seconds;
            for (const StreamPoint& point : named.run.points)
                csv_ += fmt::format("{},{},{},{},{:.3f},{:.5g}\n", scene.name, view, named.name, point.bytes,
                                    point.psnr, point.worst);
        }
        for (double level : kLevels)
            for (const NamedRun& named : runs) row.push_back(fmt::format("{}", named.run.bytesTo(level)));
        const double ours = double(runs[0].run.bytesTo(kTarget)),
                     oracle = double(runs[3].run.bytesTo(kTarget));
        const double over = oracle > 0 ? ours / oracle : std::nan("");
        row.push_back(cell(over));
        figure["over_oracle_at_40_db"] = over;
        worst_ = std::max(worst_, over);
        ++views_;
        if (ours <= double(std::min(runs[1].run.bytesTo(kTarget), runs[2].run.bytesTo(kTarget)))) ++fewest_;
        rows_.push_back(std::move(row));
        figures_.push_back(std::move(figure));
    }

    void report() {
        std::vector<std::string> header{"bytes to"};
        for (double level : kLevels)
            for (const char* name : {"ours", "GigaVoxels", "breadth", "oracle"})
                header.push_back(fmt::format("{:g} dB {}", level, name));
        header.push_back("ours/oracle");
        TextTable table(header);
        for (std::vector<std::string>& row : rows_) table.add(std::move(row));
        options_.print(table.text());
        options_.print(fmt::format(
            "At {:g} dB ours needs the fewest bytes in {} of {} views, and at most {} times the oracle's "
            "(wanted: {:g}).",
            kTarget, fewest_, views_, cell(worst_), kMostOverOracle));
    }

    const BenchOptions& options_;
    const std::uint32_t edge_;
    std::string csv_;
    std::vector<std::vector<std::string>> rows_;
    nlohmann::json figures_ = nlohmann::json::array();
    double worst_ = 0;
    unsigned fewest_ = 0, views_ = 0;
};

}  // namespace

Result<nlohmann::json> benchStream(const BenchOptions& options) { return StreamBench(options).run(); }

}  // namespace brickyard

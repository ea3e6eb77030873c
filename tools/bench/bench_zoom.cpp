// `brickyard bench zoom`: a camera goes slowly nearer, and what matters is what changes from picture to
// picture that should not: levels of detail that switch, samples that miss, noise.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <fstream>

#include "tools/bench/bench_subject.h"
#include "tools/bench/benchmark.h"
#include "tools/bench/text_table.h"
#include "tools/bench/timing.h"
#include "tools/quality_preset.h"

namespace brickyard {
namespace {

constexpr int kFrames = 60, kQuickFrames = 6;
// Lit pictures take a hundred times as long. Smaller ones than the last are a quick look.
constexpr std::uint32_t kLargestPicture = 96, kLargestLit = 48, kQuickLook = 32;
// Distance of the first and the last eye from the middle, over that of the framing view.
constexpr double kFarthest = 2, kNearest = 0.7;
// Rays along each edge of a pixel of the picture that is taken for the truth.
constexpr std::uint32_t kTruthEdge = 4;
constexpr std::size_t kCaches = 2;

struct ZoomMode {
    std::string name;
    QualitySettings quality;
    bool general = false;         // drawn the general way, whose levels blend
    std::uint32_t samples = 1;    // stratified rays a pixel
    std::uint32_t grid_edge = 1;  // or so many along its edges, on a grid
};

std::vector<ZoomMode> zoomModes(bool lit) {
    const QualitySettings final = *qualityPreset("final"), draft = *qualityPreset("draft"),
                          reference{.reference = true};
    std::vector<ZoomMode> modes{{"reference, fast", reference},
                                {"final, fast", final},
                                {"final, general", final, true},
                                {"final, fast, samples 4", final, false, 1, 2},
                                {"final, general, samples 4", final, true, 1, 2},
                                {"final, general, spp 4", final, true, 4},
                                {"draft, fast", draft},
                                {"draft, general", draft, true}};
    if (!lit) modes.push_back({"final, general, spp 16", final, true, 16});
    return modes;
}

struct ZoomRun {
    Timing seconds;
    double squares = 0;           // of errors, over all frames
    std::vector<double> flicker;  // by frame but the first: rms over pixels of the change of the error
    double largest = 0;           // change of one pixel's error
    std::vector<double> before;   // errors of the last frame
};

class ZoomBench {
public:
    explicit ZoomBench(const BenchOptions& options)
        : options_(options), pool_(/*jobs=*/0), frames_(options.size < kQuickLook ? kQuickFrames : kFrames) {}

    Result<nlohmann::json> run() {
        const Result<std::vector<BenchCache>> caches = findCaches(options_.data);
        if (!caches) return tl::unexpected(caches.error());
        csv_ = "cache,lit,mode,frame,rms_error_change\n";
        for (std::size_t i = 0; i < std::min(caches->size(), kCaches); ++i) {
            const BenchCache& cache = (*caches)[i];
            options_.progress("zoom: converting " + cache.name);
            const Result<BenchSubject> subject =
                prepareSubject(cache, options_.scratch / std::to_string(i), pool_);
            if (!subject) return tl::unexpected(subject.error());
            for (const bool lit : {false, true}) {
                edge_ = std::min(options_.size, lit ? kLargestLit : kLargestPicture);
                if (Result<void> done = zoom(*subject, lit); !done) return tl::unexpected(done.error());
            }
        }
        std::ofstream file(options_.output / "zoom.csv");
        if (!(file << csv_ << std::flush))
            return fail(ErrorCode::kIo, fmt::format("{}: cannot be written; is the disk full?",
                                                    (options_.output / "zoom.csv").string()));
        options_.print(fmt::format("Written: zoom.csv in {}", options_.output.string()));
        return nlohmann::json{{"frames", frames_}, {"zooms", figures_}};
    }

private:
    RenderRequest requestOf(const BenchSubject& subject, const Camera& camera, bool lit, std::uint32_t grid,
                            QualitySettings quality) const {
        quality.pixels_per_voxel *= double(grid);
        RenderRequest request = brickyard::requestOf(subject, {"zoom", camera}, edge_ * grid, quality);
        if (lit) {
            Light& light = *request.scene.add_lights();
            for (const double d : {-0.4, 0.3, -0.85}) light.add_direction(d);
            for (int c = 0; c < 3; ++c) light.add_irradiance(10);
        }
        return request;
    }

    // Alpha, or where there is light the red radiance: what lights is white.
    static std::vector<double> valuesOf(const Picture& picture, bool lit) {
        std::vector<double> values;
        values.reserve(picture.pixels.size());
        for (const Pixel& pixel : picture.pixels)
            values.push_back(double(lit ? pixel.radiance[0] : pixel.alpha));
        return values;
    }

    static double rms(double squares, double count) { return count > 0 ? std::sqrt(squares / count) : 0; }

    static void addFrame(const std::vector<double>& values, const std::vector<double>& truth, ZoomRun& run) {
        std::vector<double> errors(values.size());
        double change = 0;
        for (std::size_t i = 0; i < values.size(); ++i) {
            errors[i] = values[i] - truth[i];
            run.squares += errors[i] * errors[i];
            if (run.before.empty()) continue;
            const double one = errors[i] - run.before[i];
            change += one * one;
            run.largest = std::max(run.largest, std::abs(one));
        }
        if (!run.before.empty()) run.flicker.push_back(rms(change, double(values.size())));
        run.before = std::move(errors);
    }

    Result<void> zoom(const BenchSubject& subject, bool lit) {
        const auto framing = std::find_if(subject.views.begin(), subject.views.end(),
                                          [](const BenchView& view) { return view.name == "framing"; });
        const std::vector<ZoomMode> modes = zoomModes(lit);
        std::vector<ZoomRun> runs(modes.size());
        // Its errors are against nothing: what is left is the change of the picture itself.
        ZoomRun own;
        const std::vector<double> nothing(std::size_t(edge_) * edge_, 0.0);
        for (int frame = 0; frame < frames_; ++frame) {
            options_.progress(fmt::format("zoom: {}{}, frame {} of {}", subject.cache.name,
                                          lit ? ", lit" : "", frame + 1, frames_));
            const Camera camera = cameraAt(framing->camera, double(frame) / (frames_ - 1));
            const Result<RenderOutcome> exact = renderDataset(
                subject.dataset, requestOf(subject, camera, lit, kTruthEdge, {.reference = true}));
            if (!exact) return tl::unexpected(exact.error());
            const std::vector<double> truth = valuesOf(boxFiltered(exact->picture, kTruthEdge), lit);
            addFrame(truth, nothing, own);
            for (std::size_t m = 0; m < modes.size(); ++m) {
                RenderRequest request = requestOf(subject, camera, lit, modes[m].grid_edge, modes[m].quality);
                request.samples = modes[m].samples;
                if (modes[m].general) request.shadows = ShadowMethod::kDeepMap;
                const Result<RenderOutcome> outcome = renderDataset(subject.dataset, request);
                if (!outcome) return tl::unexpected(outcome.error());
                runs[m].seconds.add(outcome->seconds_total);
                addFrame(valuesOf(boxFiltered(outcome->picture, modes[m].grid_edge), lit), truth, runs[m]);
            }
        }
        report(subject, lit, modes, runs, own);
        return {};
    }

    static Camera cameraAt(const Camera& framing, double part) {
        Camera camera = framing;
        const double distance = kFarthest * std::pow(kNearest / kFarthest, part);
        for (int a = 0; a < 3; ++a)
            camera.set_eye(a, framing.target(a) + distance * (framing.eye(a) - framing.target(a)));
        return camera;
    }

    void report(const BenchSubject& subject, bool lit, const std::vector<ZoomMode>& modes,
                const std::vector<ZoomRun>& runs, const ZoomRun& own) {
        const double pixels = double(edge_) * edge_;
        const double own_change = rmsOf(own.flicker);
        options_.print(
            fmt::format("\n{}{}: {} pictures, {:.1f} to {:.1f} voxels a pixel; the picture itself changes by "
                        "{} from one to the next (rms)",
                        subject.cache.name, lit ? ", lit" : "", frames_, voxelsAPixel(subject, kFarthest),
                        voxelsAPixel(subject, kNearest), cell(own_change)));
        TextTable table({"mode", "s a picture", "rms error", "flicker", "of the change", "worst picture",
                         "over median", "largest jump"});
        for (std::size_t m = 0; m < modes.size(); ++m) {
            const ZoomRun& run = runs[m];
            const double flicker = rmsOf(run.flicker);
            std::vector<double> sorted = run.flicker;
            std::sort(sorted.begin(), sorted.end());
            const double median = sorted[sorted.size() / 2], worst = sorted.back();
            const double error = rms(run.squares, pixels * frames_);
            table.add({modes[m].name, cell(run.seconds.median()), cell(error), cell(flicker),
                       cell(flicker / own_change), cell(worst), cell(worst / median), cell(run.largest)});
            for (std::size_t i = 0; i < run.flicker.size(); ++i)
                csv_ += fmt::format("\"{}\",{:d},\"{}\",{},{:.6g}\n", subject.cache.name, lit, modes[m].name,
                                    i + 2, run.flicker[i]);
            figures_.push_back({{"cache", subject.cache.name},
                                {"lit", lit},
                                {"size", edge_},
                                {"mode", modes[m].name},
                                {"seconds_a_frame", run.seconds.median()},
                                {"rms_error", error},
                                {"flicker", flicker},
                                {"flicker_over_own_change", flicker / own_change},
                                {"worst_frame", worst},
                                {"worst_over_median", worst / median},
                                {"largest_jump", run.largest},
                                {"own_change", own_change}});
        }
        options_.print(table.text());
    }

    static double rmsOf(const std::vector<double>& values) {
        double squares = 0;
        for (const double value : values) squares += value * value;
        return rms(squares, double(values.size()));
    }

    // At the middle of the box.
    double voxelsAPixel(const BenchSubject& subject, double distance) const {
        const auto framing = std::find_if(subject.views.begin(), subject.views.end(),
                                          [](const BenchView& view) { return view.name == "framing"; });
        const Camera& camera = framing->camera;
        double squares = 0;
        for (int a = 0; a < 3; ++a) {
            const double one = camera.eye(a) - camera.target(a);
            squares += one * one;
        }
        const Result<PinholeCamera> pinhole = PinholeCamera::create(camera, edge_, edge_);
        const double pixel = pinhole ? pinhole->pixelEdge() * distance * std::sqrt(squares) : NAN;
        return pixel / subject.transform.voxelSize();
    }

    const BenchOptions& options_;
    WorkerPool pool_;
    std::uint32_t edge_ = 0;  // pixels a side, of the zoom under way
    const int frames_;
    std::string csv_;
    nlohmann::json figures_ = nlohmann::json::array();
};

}  // namespace

Result<nlohmann::json> benchZoom(const BenchOptions& options) { return ZoomBench(options).run(); }

}  // namespace brickyard

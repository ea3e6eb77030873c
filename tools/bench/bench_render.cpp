// `brickyard bench render`: seconds and error beside other ways to the same picture.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "tools/bench/bench_subject.h"
#include "tools/bench/benchmark.h"
#include "tools/bench/contender.h"
#include "tools/bench/lit_comparison.h"
#include "tools/bench/nano_grid.h"
#include "tools/bench/nano_marcher.h"
#include "tools/bench/text_table.h"

namespace brickyard {
namespace {

constexpr double kOurErrors[] = {0.001, 0.003, 0.01, 0.03, 0.1};
constexpr double kPeerSteps[] = {0.5, 1, 2};
constexpr unsigned kSlowRounds = 2;
constexpr std::uint32_t kTile = 16;  // pixels a side that a thread of the marcher takes at a time

void store(const glm::dvec3& vector, double* numbers) {
    for (int a = 0; a < 3; ++a) numbers[a] = vector[a];
}

NanoView nanoView(const PinholeCamera& camera, const Affine& transform, double density_scale,
                  double step_voxels) {
    // At distance 1: the centre of pixel (0, 0), and the steps to its neighbours.
    const glm::dvec3 along_x = camera.pixelEdge() * camera.right(),
                     along_y = -camera.pixelEdge() * camera.up();
    const glm::dvec3 corner =
        camera.forward() + (0.5 - 0.5 * camera.width()) * along_x + (0.5 - 0.5 * camera.height()) * along_y;
    NanoView view{};
    store(transform.inversePoint(camera.eye()), view.origin);
    store(transform.inverseVector(corner), view.corner);
    store(transform.inverseVector(along_x), view.along_x);
    store(transform.inverseVector(along_y), view.along_y);
    store(corner, view.world_corner);
    store(along_x, view.world_along_x);
    store(along_y, view.world_along_y);
    view.width = camera.width();
    view.density_scale = density_scale;
    view.step_voxels = step_voxels;
    return view;
}

// What a geometric mean needs of many ratios.
struct Ratios {
    double sum_logs = 0, lowest = std::numeric_limits<double>::infinity();
    unsigned count = 0, missing = 0;
    void add(double ratio) {
        sum_logs += std::log(ratio);
        lowest = std::min(lowest, ratio);
        ++count;
    }
    nlohmann::json toJson() const {
        if (count == 0) return {{"views", 0}, {"none_as_exact", missing}};
        return {{"geometric_mean", std::exp(sum_logs / count)},
                {"lowest", lowest},
                {"views", count},
                {"none_as_exact", missing}};
    }
    std::string text() const {
        const std::string gap =
            missing > 0 ? fmt::format("; in {} views none of ours is as exact", missing) : "";
        if (count == 0) return "not measured" + gap;
        return fmt::format("{} (lowest {}, {} views{})", cell(std::exp(sum_logs / count)), cell(lowest),
                           count, gap);
    }
};

class RenderBench {
public:
    explicit RenderBench(const BenchOptions& options) : options_(options), pool_(/*jobs=*/0) {}

    Result<nlohmann::json> run() {
        const Result<std::vector<BenchCache>> caches = findCaches(options_.data);
        if (!caches) return tl::unexpected(caches.error());
        nlohmann::json views = nlohmann::json::array();
        for (std::size_t i = 0; i < caches->size(); ++i) {
            options_.progress("render: converting " + (*caches)[i].name);
            const Result<BenchSubject> subject =
                prepareSubject((*caches)[i], options_.scratch / std::to_string(i), pool_);
            if (!subject) return tl::unexpected(subject.error());
            const Result<NanoGrid> nano = NanoGrid::create(subject->grid);
            if (!nano) return tl::unexpected(nano.error());
            for (const BenchView& view : subject->views) {
                options_.progress(fmt::format("render: {}, {}", subject->cache.name, view.name));
                Result<nlohmann::json> figures = measure(*subject, *nano, view);
                if (!figures) return figures;
                views.push_back(std::move(*figures));
            }
        }
        return nlohmann::json{{"views", std::move(views)}, {"summary", summary()}};
    }

private:
    Contender ours(const std::string& name, const BenchSubject& subject, const BenchView& view,
                   const ViewTruth& truth, const QualitySettings& quality) const {
        RenderRequest request = requestOf(subject, view, options_.size, quality);
        request.repeats = 1;
        Contender contender;
        contender.name = name;
        contender.ours = true;
        contender.draw = [&subject, &truth, request](PictureError* error) -> Result<double> {
            const Result<RenderOutcome> outcome = renderDataset(subject.dataset, request);
            if (!outcome) return tl::unexpected(outcome.error());
            if (error) error->addPicture(outcome->picture, truth.alpha);
            return outcome->seconds_render;
        };
        return contender;
    }

    Contender marcher(const BenchSubject& subject, const NanoGrid& nano, const ViewTruth& truth,
                      double step) {
        Contender contender;
        contender.name = fmt::format("NanoVDB step {}", step);
        contender.peer_step = step;
        contender.draw = [this, &nano, &truth,
                          view = nanoView(truth.camera, subject.transform, subject.density_scale, step)](
                             PictureError* error) -> Result<double> {
            std::vector<float> alpha(truth.alpha.size());
            const std::uint32_t size = view.width, tiles = (size + kTile - 1) / kTile;
            const double seconds = secondsOf([&] {
                pool_.run(std::size_t(tiles) * tiles, [&](std::size_t tile) {
                    const std::uint32_t x = std::uint32_t(tile) % tiles * kTile;
                    const std::uint32_t y = std::uint32_t(tile) / tiles * kTile;
                    marchNano(nano.data(), view, x, std::min(x + kTile, size), y, std::min(y + kTile, size),
                              alpha.data());
                });
            });
            if (error) error->addValues(alpha, truth.alpha);
            return seconds;
        };
        return contender;
    }

    Contender scalar(const BenchSubject& subject, const ViewTruth& truth, bool all_threads) {
        Contender contender;
        contender.name = all_threads ? "cell walk" : "cell walk, one thread";
        contender.max_rounds = kSlowRounds;
        contender.draw = [this, &subject, &truth, all_threads](PictureError* error) -> Result<double> {
            std::vector<double> depths;
            const double seconds = secondsOf([&] {
                depths = subject.walk.depths(truth.camera, all_threads ? pool_.parallelFor() : serialFor);
            });
            if (error) error->addValues(alphaOf(depths, subject.density_scale), truth.alpha);
            return seconds;
        };
        return contender;
    }

    Result<nlohmann::json> measure(const BenchSubject& subject, const NanoGrid& nano, const BenchView& view) {
        const Result<ViewTruth> truth = truthOf(subject, view, options_.size, pool_);
        if (!truth) return tl::unexpected(truth.error());
        std::vector<Contender> contenders;
        contenders.push_back(ours("reference", subject, view, *truth, {.reference = true}));
        for (const double error : kOurErrors)
            contenders.push_back(
                ours(fmt::format("max-error {}", error), subject, view, *truth, {.max_error = error}));
        for (const double step : kPeerSteps) contenders.push_back(marcher(subject, nano, *truth, step));
        contenders.push_back(scalar(subject, *truth, /*all_threads=*/true));
        contenders.push_back(scalar(subject, *truth, /*all_threads=*/false));
        if (Result<void> done = race(contenders, options_.repeats); !done)
            return tl::unexpected(done.error());

        options_.print(
            fmt::format("\n{}, {}: median optical depth {}, {:.0f} % of pixels meet something, density "
                        "scale {}",
                        subject.cache.name, view.name, cell(truth->median_depth), 100 * truth->hit_share,
                        cell(subject.density_scale)));
        nlohmann::json json = report(contenders);
        json["cache"] = subject.cache.name;
        json["view"] = view.name;
        json["density_scale"] = subject.density_scale;
        json["median_optical_depth"] = truth->median_depth;
        json["hit_share"] = truth->hit_share;
        Result<nlohmann::json> lit = compareLit(subject, view, *truth, options_, pool_);
        if (!lit) return lit;
        if (lit->contains("vdb_render_over_reference"))
            lit_reference_.add((*lit)["vdb_render_over_reference"].get<double>());
        if (lit->contains("vdb_render_over_ours_at_equal_rms"))
            lit_equal_.add((*lit)["vdb_render_over_ours_at_equal_rms"].get<double>());
        else if (!lit->contains("skipped"))
            ++lit_equal_.missing;
        json["lit"] = std::move(*lit);
        return json;
    }

    nlohmann::json report(const std::vector<Contender>& contenders) {
        TextTable table({"absorption", "seconds", "best", "Mrays/s", "rms", "worst", "ours at equal rms",
                         "is faster by"});
        nlohmann::json json{{"pictures", nlohmann::json::array()}, {"equal_rms", nlohmann::json::array()}};
        for (const Contender& contender : contenders) {
            json["pictures"].push_back(toJson(contender));
            std::vector<std::string> row{
                contender.name,
                cell(contender.timing.median()),
                cell(contender.timing.best()),
                cell(double(contender.error.pixels()) / contender.timing.median() / 1e6),
                cell(contender.error.rms()),
                cell(contender.error.worst()),
                "",
                ""};
            if (contender.peer_step > 0) compareAtEqualError(contenders, contender, row, json["equal_rms"]);
            table.add(row);
        }
        options_.print(table.text());
        const double reference = contenders.front().timing.median();
        const Contender& one = contenders.back();
        const Contender& all = contenders[contenders.size() - 2];
        json["cell_walk_over_reference"] = all.timing.median() / reference;
        json["cell_walk_one_thread_over_reference"] = one.timing.median() / reference;
        walk_all_.add(all.timing.median() / reference);
        walk_one_.add(one.timing.median() / reference);
        options_.print(
            fmt::format("  the cell walk takes {} times as long as our reference ({} on one thread)",
                        cell(all.timing.median() / reference), cell(one.timing.median() / reference)));
        return json;
    }

    void compareAtEqualError(const std::vector<Contender>& contenders, const Contender& peer,
                             std::vector<std::string>& row, nlohmann::json& json) {
        const std::size_t step =
            std::size_t(std::find(std::begin(kPeerSteps), std::end(kPeerSteps), peer.peer_step) - kPeerSteps);
        const Contender* ours = cheapestOfOurs(contenders, peer.error.rms());
        json.push_back({{"peer_step", peer.peer_step}, {"peer_rms", peer.error.rms()}});
        if (!ours) {
            ++equal_[step].missing;
            row[6] = "none";
            return;
        }
        const double ratio = peer.timing.median() / ours->timing.median();
        json.back()["ours"] = ours->name;
        json.back()["ours_rms"] = ours->error.rms();
        json.back()["peer_over_ours"] = ratio;
        equal_[step].add(ratio);
        row[6] = ours->name;
        row[7] = cell(ratio);
    }

    nlohmann::json summary() const {
        nlohmann::json json;
        options_.print("\nTimes as long as ours, geometric mean over all views:");
        const auto add = [&](const std::string& what, const char* key, const Ratios& ratios) {
            options_.print(fmt::format("  {:<48}{}", what, ratios.text()));
            json[key] = ratios.toJson();
        };
        for (std::size_t i = 0; i < std::size(kPeerSteps); ++i)
            add(fmt::format("NanoVDB, step {}, at equal rms", kPeerSteps[i]),
                fmt::format("nanovdb_step_{}_over_ours_at_equal_rms", kPeerSteps[i]).c_str(), equal_[i]);
        add("cell walk, all threads, over the reference", "cell_walk_over_reference", walk_all_);
        add("cell walk, one thread, over the reference", "cell_walk_one_thread_over_reference", walk_one_);
        add("vdb_render, over the lit reference", "vdb_render_over_reference", lit_reference_);
        add("vdb_render, at equal rms", "vdb_render_over_ours_at_equal_rms", lit_equal_);
        return json;
    }

    const BenchOptions& options_;
    WorkerPool pool_;
    Ratios equal_[std::size(kPeerSteps)], walk_all_, walk_one_, lit_reference_, lit_equal_;
};

}  // namespace

Result<nlohmann::json> benchRender(const BenchOptions& options) { return RenderBench(options).run(); }

}  // namespace brickyard

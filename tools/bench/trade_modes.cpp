#include "tools/bench/trade_modes.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "tools/bake/bake.h"
#include "tools/bench/bench_subject.h"
#include "tools/bench/mode_error.h"
#include "tools/bench/mode_groups.h"
#include "tools/bench/text_table.h"
#include "tools/bench/timing.h"

namespace brickyard {
namespace {

// The first caches of `bench trade`.
constexpr std::size_t kCaches = 2;
// A picture that takes this long is not drawn again for its time.
constexpr double kEnoughSeconds = 0.3;
constexpr double kWithinThree = 0.997;

struct ModeRun {
    double seconds = 0;
    std::uint64_t bytes = 0;  // streamed
    std::string method;
    bool final = false;
    ModeError error;
};

class TradeModes {
public:
    TradeModes(const BenchOptions& options, WorkerPool& pool) : options_(options), pool_(pool) {}

    Result<nlohmann::json> run() {
        const Result<std::vector<BenchCache>> caches = findCaches(options_.data);
        if (!caches) return tl::unexpected(caches.error());
        for (std::size_t i = 0; i < std::min(caches->size(), kCaches); ++i)
            if (Result<void> done = runCache((*caches)[i], options_.scratch / fmt::format("modes-{}", i));
                !done)
                return tl::unexpected(done.error());
        options_.print(fmt::format("\nModes whose estimates hold in fewer than {:.1f} % of the pixels: {}",
                                   100 * kWithinThree, broken_.empty() ? "none" : ""));
        for (const nlohmann::json& one : broken_)
            options_.print(fmt::format("  {}, {}, {}: {:.2f} %", one["cache"].get<std::string>(),
                                       one["group"].get<std::string>(), one["mode"].get<std::string>(),
                                       100 * one["within_3"].get<double>()));
        return nlohmann::json{{"groups", figures_}, {"estimates_that_fail", broken_}};
    }

private:
    Result<void> runCache(const BenchCache& cache, const std::filesystem::path& folder) {
        options_.progress("trade: converting " + cache.name);
        const Result<BenchSubject> prepared =
            prepareSubject(cache, std::filesystem::path(folder.string() + "-density"), pool_);
        if (!prepared) return tl::unexpected(prepared.error());
        const Result<BenchDataset> whole = convertCache(cache, folder, /*max_error=*/0, /*channels=*/{});
        if (!whole) return tl::unexpected(whole.error());
        const auto framing = std::find_if(prepared->views.begin(), prepared->views.end(),
                                          [](const BenchView& view) { return view.name == "framing"; });
        ModeSubject subject{cache.channel, framing->camera, prepared->density_scale, whole->footer, {}};
        // Drawn from is the dataset with the light in it: who does not ask for it pays nothing for it.
        BenchDataset dataset = *whole;
        if (asksFor("shadows")) {
            BakeOptions bakes;
            bakes.dataset = whole->folder;
            bakes.output = std::filesystem::path(folder.string() + "-lit");
            bakes.scene = sunlitScene(subject);
            const Result<BakeReport> baked = bake(bakes);
            if (!baked) return tl::unexpected(baked.error());
            dataset.folder = bakes.output;
            subject.baked = baked->channels.front();
        }
        for (const ModeGroup& group : modeGroups(subject, options_.size, options_.modes))
            if (Result<void> done = runGroup(cache, dataset, group); !done)
                return fail(done.error().code,
                            fmt::format("{}, {}: {}", cache.name, group.name, done.error().message));
        return {};
    }

    static std::uint32_t edgeOf(const ModeGroup& group) {
        return group.truths[0].request.width / group.truths[0].grid_edge;
    }

    bool asksFor(const char* group) const {
        return options_.modes.empty() ||
               std::find(options_.modes.begin(), options_.modes.end(), group) != options_.modes.end();
    }

    Result<void> runGroup(const BenchCache& cache, const BenchDataset& dataset, const ModeGroup& group) {
        std::vector<RenderOutcome> truths;
        for (const ModeTruth& truth : group.truths) {
            options_.progress(fmt::format("trade: {}, {}: the truth", cache.name, group.name));
            Result<RenderOutcome> outcome = renderDataset(dataset, truth.request);
            if (!outcome) return tl::unexpected(outcome.error());
            outcome->picture = boxFiltered(outcome->picture, truth.grid_edge);
            truths.push_back(std::move(*outcome));
        }
        std::vector<ModeRun> runs;
        const ModeRun* baseline = nullptr;
        runs.reserve(group.rows.size());
        for (const ModeRow& row : group.rows) {
            options_.progress(fmt::format("trade: {}, {}: {}", cache.name, group.name, row.name));
            Result<ModeRun> run = runRow(dataset, row, truths, group.of_alpha);
            if (!run) return tl::unexpected(run.error());
            runs.push_back(std::move(*run));
            if (row.name == group.baseline) baseline = &runs.back();
        }
        note(cache, group, runs, *baseline);
        return {};
    }

    Result<ModeRun> runRow(const BenchDataset& dataset, const ModeRow& row,
                           const std::vector<RenderOutcome>& truths, bool of_alpha) const {
        ModeRun run;
        const Picture& truth = truths[row.truth].picture;
        if (row.is_truth) {
            const RenderOutcome& drawn = truths[*row.is_truth];
            return ModeRun{drawn.seconds_total, drawn.streamed.bytes_streamed, drawn.method, drawn.final,
                           modeError(drawn.picture, truth, of_alpha)};
        }
        Timing timing;
        for (unsigned i = 0; i < options_.repeats && (i == 0 || timing.total() < kEnoughSeconds); ++i) {
            const Result<RenderOutcome> outcome = renderDataset(dataset, row.request);
            if (!outcome) return tl::unexpected(outcome.error());
            timing.add(outcome->seconds_total);
            if (i > 0) continue;
            run.method = outcome->method;
            run.final = outcome->final;
            run.bytes = outcome->streamed.bytes_streamed;
            run.error = modeError(boxFiltered(outcome->picture, row.grid_edge), truth, of_alpha);
        }
        run.seconds = timing.median();
        return run;
    }

    void note(const BenchCache& cache, const ModeGroup& group, const std::vector<ModeRun>& runs,
              const ModeRun& baseline) {
        options_.print(fmt::format(
            "\n{}, {}, {} pixels a side: error of {} against {}; seconds and bytes over those of '{}'",
            cache.name, group.name, edgeOf(group), group.of_alpha ? "alpha" : "R, G and B", group.truth_is,
            group.baseline));
        TextTable table({"mode", "drawn by", "seconds", "times", "bytes", "rms", "p99", "worst", "estimate",
                         "est/rms", "in 3"});
        nlohmann::json rows = nlohmann::json::array();
        for (std::size_t i = 0; i < runs.size(); ++i) {
            const ModeRun& run = runs[i];
            const std::string& name = group.rows[i].name;
            const double bytes = double(run.bytes) / double(std::max<std::uint64_t>(baseline.bytes, 1));
            const bool claims = !group.rows[i].silent;
            table.add({name, run.method, cell(run.seconds), cell(run.seconds / baseline.seconds), cell(bytes),
                       cell(run.error.rms), cell(run.error.p99), cell(run.error.worst),
                       claims ? cell(run.error.mean_estimate) : "",
                       claims && run.error.rms > 1e-7 ? cell(run.error.estimateOverRms()) : "",
                       claims ? fmt::format("{:.2f}%", 100 * run.error.within_3) : ""});
            nlohmann::json row = toJson(run.error);
            row["mode"] = name;
            row["method"] = run.method;
            row["seconds"] = run.seconds;
            row["seconds_over_baseline"] = run.seconds / baseline.seconds;
            row["bytes_over_baseline"] = bytes;
            row["final"] = run.final;
            if (claims && run.error.within_3 < kWithinThree)
                broken_.push_back({{"cache", cache.name},
                                   {"group", group.name},
                                   {"mode", name},
                                   {"within_3", run.error.within_3},
                                   {"estimate_over_rms", run.error.estimateOverRms()}});
            rows.push_back(std::move(row));
        }
        options_.print(table.text());
        figures_.push_back({{"cache", cache.name},
                            {"group", group.name},
                            {"size", edgeOf(group)},
                            {"truth", group.truth_is},
                            {"baseline", group.baseline},
                            {"of", group.of_alpha ? "alpha" : "rgb"},
                            {"rows", rows}});
    }

    const BenchOptions& options_;
    WorkerPool& pool_;
    nlohmann::json figures_ = nlohmann::json::array(), broken_ = nlohmann::json::array();
};

}  // namespace

Result<nlohmann::json> tradeModes(const BenchOptions& options, WorkerPool& pool) {
    return TradeModes(options, pool).run();
}

}  // namespace brickyard

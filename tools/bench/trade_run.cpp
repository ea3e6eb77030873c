#include "tools/bench/trade_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <map>

#include "tools/bench/timing.h"
#include "tools/quality_preset.h"

namespace brickyard {
namespace {

constexpr double kErrors[] = {0.3, 0.1, 0.03, 0.01, 0.003, 0.001};
constexpr double kQuantised[] = {1e-2, 1e-3, 1e-4};
constexpr double kEnoughSeconds = 1;
// A page and its parents must fit, whatever the working set.
constexpr std::uint64_t kLeastCacheBytes = 256 << 10;

}  // namespace

std::vector<TradeSetting> tradeSettings() {
    std::vector<TradeSetting> settings;
    for (const char* preset : kQualityPresets)
        settings.push_back({preset, "presets", *qualityPreset(preset)});
    for (const double error : kErrors)
        settings.push_back({fmt::format("max-error {}", error), "max-error", {.max_error = error}});
    for (const double error : kErrors)
        settings.push_back({fmt::format("strict {}", error), "strict", {.strict = true, .max_error = error}});
    for (const double quantised : kQuantised)
        settings.push_back({fmt::format("quantised {}, reference", quantised),
                            "quantised, reference",
                            {.reference = true},
                            quantised});
    for (const double quantised : kQuantised)
        settings.push_back({fmt::format("quantised {}, max-error 0.01", quantised),
                            "quantised, max-error 0.01",
                            {.max_error = 0.01},
                            quantised});
    for (const char* preset : {"final", "reference"})
        settings.push_back({fmt::format("{}, cache 1/10", preset), "cache 1/10", *qualityPreset(preset),
                            /*quantised=*/0, /*small_cache=*/true});
    return settings;
}

std::vector<double> quantisations(const std::vector<TradeSetting>& settings) {
    std::vector<double> all{0};
    for (const TradeSetting& setting : settings)
        if (std::find(all.begin(), all.end(), setting.quantised) == all.end())
            all.push_back(setting.quantised);
    return all;
}

namespace {

// The same bytes come out of every repeat; only the seconds differ.
Result<TradeRun> runSetting(const BenchDataset& dataset, const RenderRequest& request, unsigned repeats,
                            const ViewTruth& truth) {
    TradeRun run;
    Timing timing;
    for (unsigned i = 0; i < repeats && (i == 0 || timing.total() < kEnoughSeconds); ++i) {
        const Result<RenderOutcome> outcome = renderDataset(dataset, request);
        if (!outcome) return tl::unexpected(outcome.error());
        timing.add(outcome->seconds_total);
        if (i > 0) continue;
        run.error.addClaims(alphaClaims(outcome->picture), truth.alpha);
        run.seconds_render = outcome->seconds_render;
        run.bytes = outcome->streamed.bytes_streamed;
        run.pages = outcome->streamed.pages_streamed;
        run.cache_bytes = outcome->cache_bytes;
        run.reloads = outcome->cache.reloads;
        run.final = outcome->final;
    }
    run.seconds = timing.median();
    return run;
}

}  // namespace

Result<std::vector<TradeRun>> runTrade(const BenchSubject& subject, const BenchView& view,
                                       const std::vector<TradeSetting>& settings,
                                       const std::vector<BenchDataset>& datasets, std::uint32_t size,
                                       unsigned repeats, WorkerPool& pool) {
    const Result<ViewTruth> truth = truthOf(subject, view, size, pool);
    if (!truth) return tl::unexpected(truth.error());
    const std::vector<double> errors = quantisations(settings);
    std::map<std::string, std::uint64_t> working_set;  // by name of the preset
    std::vector<TradeRun> runs;
    for (const TradeSetting& setting : settings) {
        RenderRequest request = requestOf(subject, view, size, setting.quality);
        if (setting.small_cache)
            request.cache_bytes =
                std::max(working_set[setting.name.substr(0, setting.name.find(','))] / 10, kLeastCacheBytes);
        const auto dataset = std::find(errors.begin(), errors.end(), setting.quantised) - errors.begin();
        Result<TradeRun> run = runSetting(datasets[std::size_t(dataset)], request, repeats, *truth);
        if (!run)
            return fail(run.error().code, fmt::format("{}, {}, {}: {}", subject.cache.name, view.name,
                                                      setting.name, run.error().message));
        working_set[setting.name] = run->cache_bytes;
        run->cache = subject.cache.name;
        run->view = view.name;
        run->setting = &setting;
        runs.push_back(std::move(*run));
    }
    return runs;
}

}  // namespace brickyard

// `brickyard bench trade`: what error costs, and whether pictures tell the truth about themselves.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "tools/bench/benchmark.h"
#include "tools/bench/text_table.h"
#include "tools/bench/trade_front.h"
#include "tools/bench/trade_modes.h"
#include "tools/bench/trade_run.h"

namespace brickyard {
namespace {

// What an estimate promises (docs/error-bounds.md).
constexpr double kWithinThree = 0.997, kMostEstimateOverRms = 3;

class TradeBench {
public:
    explicit TradeBench(const BenchOptions& options)
        : options_(options), pool_(/*jobs=*/0), settings_(tradeSettings()) {}

    Result<nlohmann::json> run() {
        nlohmann::json json = nlohmann::json::object();
        // Whoever names modes wants those alone.
        if (options_.modes.empty()) {
            Result<nlohmann::json> settings = runSettings();
            if (!settings) return settings;
            json = std::move(*settings);
        }
        Result<nlohmann::json> modes = tradeModes(options_, pool_);
        if (!modes) return modes;
        json["modes"] = std::move(*modes);
        return json;
    }

private:
    Result<nlohmann::json> runSettings() {
        const Result<std::vector<BenchCache>> caches = findCaches(options_.data);
        if (!caches) return tl::unexpected(caches.error());
        for (std::size_t i = 0; i < caches->size(); ++i)
            if (Result<void> done = runCache((*caches)[i], options_.scratch / std::to_string(i)); !done)
                return tl::unexpected(done.error());

        const std::vector<TradeTotal> totals = totalTrade(runs_, settings_);
        if (Result<void> done = writeTradeCsv(runs_, options_.output / "trade.csv"); !done)
            return tl::unexpected(done.error());
        if (Result<void> done = plotTrade(totals, options_.output / "trade"); !done)
            return tl::unexpected(done.error());
        printTotals(totals);
        nlohmann::json json{{"runs", nlohmann::json::array()}, {"settings", nlohmann::json::array()}};
        for (const TradeRun& run : runs_) json["runs"].push_back(runJson(run));
        for (const TradeTotal& total : totals) json["settings"].push_back(totalJson(total));
        json["presets"] = presets(totals);
        json["calibration"] = calibration();
        for (const char* extension : {"csv", "svg", "png"})
            json["files"].push_back((options_.output / "trade.").string() + extension);
        options_.print(
            fmt::format("Written: trade.csv, trade.svg and trade.png in {}", options_.output.string()));
        return json;
    }

    Result<void> runCache(const BenchCache& cache, const std::filesystem::path& folder) {
        options_.progress("trade: converting " + cache.name);
        std::error_code ignored;
        std::filesystem::create_directory(folder, ignored);  // the conversion says so where it is not there
        const Result<BenchSubject> subject = prepareSubject(cache, folder / "exact", pool_);
        if (!subject) return tl::unexpected(subject.error());
        std::vector<BenchDataset> datasets{subject->dataset};
        const double range = subject->dataset.density.value_max() - subject->dataset.density.value_min();
        for (const double error : quantisations(settings_)) {
            if (error == 0) continue;
            Result<BenchDataset> dataset =
                convertCache(cache, folder / fmt::format("{}", error), error * range, {cache.channel});
            if (!dataset) return tl::unexpected(dataset.error());
            datasets.push_back(std::move(*dataset));
        }
        for (const BenchView& view : subject->views) {
            options_.progress(fmt::format("trade: {}, {}", cache.name, view.name));
            Result<std::vector<TradeRun>> runs =
                runTrade(*subject, view, settings_, datasets, options_.size, options_.repeats, pool_);
            if (!runs) return tl::unexpected(runs.error());
            runs_.insert(runs_.end(), runs->begin(), runs->end());
        }
        return {};
    }

    static nlohmann::json runJson(const TradeRun& run) {
        nlohmann::json json = toJson(run.error);
        json["cache"] = run.cache;
        json["view"] = run.view;
        json["setting"] = run.setting->name;
        json["seconds"] = run.seconds;
        json["seconds_render"] = run.seconds_render;
        json["bytes_streamed"] = run.bytes;
        json["pages_streamed"] = run.pages;
        json["cache_bytes"] = run.cache_bytes;
        json["cache_reloads"] = run.reloads;
        json["final"] = run.final;
        return json;
    }

    static nlohmann::json totalJson(const TradeTotal& total) {
        nlohmann::json json = toJson(total.error);
        json["setting"] = total.setting->name;
        json["bytes_over_reference"] = total.bytes_share;
        json["seconds_over_reference"] = total.seconds_share;
        json["on_front"] = {{"bytes", total.bytes_front}, {"seconds", total.seconds_front}};
        return json;
    }

    void printTotals(const std::vector<TradeTotal>& totals) const {
        options_.print(
            fmt::format("\nOver {} views; bytes and seconds as shares of the exact picture's "
                        "(geometric means); * on the Pareto front",
                        totals.front().views));
        TextTable table({"setting", "bytes", "seconds", "rms", "worst", "estimate", "bound", "bound/rms",
                         "in 1", "in 2", "in 3", "broken"});
        for (const TradeTotal& total : totals) {
            const PictureError& error = total.error;
            const auto percent = [&](int sigmas) {
                return fmt::format("{:.2f}%", 100 * error.within(sigmas));
            };
            table.add({total.setting->name, cell(total.bytes_share) + (total.bytes_front ? "*" : " "),
                       cell(total.seconds_share) + (total.seconds_front ? "*" : " "), cell(error.rms()),
                       cell(error.worst()), cell(error.meanEstimate()), cell(error.meanBound()),
                       cell(error.rms() > 1e-7 ? error.meanBound() / error.rms() : NAN), percent(1),
                       percent(2), percent(3), std::to_string(error.broken())});
        }
        options_.print(table.text());
    }

    nlohmann::json presets(const std::vector<TradeTotal>& totals) const {
        nlohmann::json json = nlohmann::json::object();
        options_.print("");
        for (const TradeTotal& total : totals) {
            if (total.setting->family != "presets") continue;
            const auto verdict = [&](bool front, unsigned views) {
                return fmt::format("{} the front ({} of {} views)", front ? "on" : "off", views, total.views);
            };
            options_.print(fmt::format("  {:<10} error against bytes: {}; against seconds: {}",
                                       total.setting->name,
                                       verdict(total.bytes_front, total.bytes_front_views),
                                       verdict(total.seconds_front, total.seconds_front_views)));
            json[total.setting->name] = {{"on_bytes_front", total.bytes_front},
                                         {"on_seconds_front", total.seconds_front},
                                         {"bytes_front_views", total.bytes_front_views},
                                         {"seconds_front_views", total.seconds_front_views},
                                         {"views", total.views}};
        }
        return json;
    }

    // Over the pictures that have an error: an exact one keeps every promise, and would flatter the share.
    nlohmann::json calibration() const {
        PictureError all;
        const TradeRun* worst = nullptr;
        unsigned pictures = 0, not_final = 0;
        std::uint64_t broken = 0;
        for (const TradeRun& run : runs_) {
            broken += run.error.broken();
            not_final += !run.final;
            if (run.setting->quality.reference && run.setting->quantised == 0) continue;
            all.add(run.error);
            ++pictures;
            if (!worst || run.error.within(3) < worst->error.within(3)) worst = &run;
        }
        const double over = all.rms() > 0 ? all.meanEstimate() / all.rms() : 0;
        const bool within = all.within(3) >= kWithinThree, tight = over <= kMostEstimateOverRms;
        const auto says = [](bool holds) { return holds ? "holds" : "FAILS"; };
        options_.print(
            fmt::format("  within three estimates: {:.3f} % of pixels, wanted {:.1f}: {} (least: {:.3f} % "
                        "in {}, {}, {})",
                        100 * all.within(3), 100 * kWithinThree, says(within), 100 * worst->error.within(3),
                        worst->cache, worst->view, worst->setting->name));
        options_.print(fmt::format("  mean estimate over rms error: {:.2f}, wanted at most {}: {}", over,
                                   kMostEstimateOverRms, says(tight)));
        options_.print(
            fmt::format("  pixels that break their bound: {}, wanted none: {}", broken, says(broken == 0)));
        if (not_final > 0) options_.print(fmt::format("  pictures that are not final: {}", not_final));
        return {{"pictures", pictures},           {"within_3", all.within(3)},
                {"within_3_holds", within},       {"least_within_3", worst->error.within(3)},
                {"mean_estimate_over_rms", over}, {"mean_estimate_holds", tight},
                {"bounds_broken", broken},        {"bounds_hold", broken == 0},
                {"pictures_not_final", not_final}};
    }

    const BenchOptions& options_;
    WorkerPool pool_;
    std::vector<TradeSetting> settings_;
    std::vector<TradeRun> runs_;
};

}  // namespace

Result<nlohmann::json> benchTrade(const BenchOptions& options) { return TradeBench(options).run(); }

}  // namespace brickyard

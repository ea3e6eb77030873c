#include "tools/bench/trade_front.h"

#include <fmt/format.h>
#include <fmt/ostream.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <fstream>

#include "core/io_error.h"
#include "tools/bench/plot.h"

namespace brickyard {
namespace {

// Under a tenth is noise of the clock; bytes are the same every time.
constexpr double kSecondsNoise = 0.1, kBytesNoise = 0.01;
// Closer to the truth than this is exact: the rest is the rounding of floats.
constexpr double kExact = 1e-6;

struct CostError {
    double cost, error;
};

// Whether some other point is at least as exact and cheaper by more than `noise`.
bool onFront(const std::vector<CostError>& points, std::size_t which, double noise) {
    return std::none_of(points.begin(), points.end(), [&](const CostError& other) {
        return std::max(other.error, kExact) <= std::max(points[which].error, kExact) &&
               other.cost < (1 - noise) * points[which].cost;
    });
}

bool sameView(const TradeRun& a, const TradeRun& b) { return a.cache == b.cache && a.view == b.view; }

// Adds a view's runs, which are all that `runs` holds.
void addView(const std::vector<TradeRun>& runs, std::vector<TradeTotal>& totals) {
    const auto exact = std::find_if(runs.begin(), runs.end(),
                                    [](const TradeRun& run) { return run.setting->name == "reference"; });
    std::vector<CostError> bytes, seconds;
    for (const TradeRun& run : runs) {
        bytes.push_back({double(run.bytes), run.error.rms()});
        seconds.push_back({run.seconds, run.error.rms()});
    }
    for (std::size_t i = 0; i < runs.size(); ++i) {
        TradeTotal& total = totals[i];
        total.error.add(runs[i].error);
        // Sums of logarithms until every view is in.
        total.bytes_share += std::log(double(std::max<std::uint64_t>(runs[i].bytes, 1)) /
                                      double(std::max<std::uint64_t>(exact->bytes, 1)));
        total.seconds_share += std::log(runs[i].seconds / exact->seconds);
        total.bytes_front_views += onFront(bytes, i, kBytesNoise);
        total.seconds_front_views += onFront(seconds, i, kSecondsNoise);
        ++total.views;
    }
}

// A family's points from the cheapest on, so that its line does not run to and fro.
PlotSeries seriesOf(const std::vector<TradeTotal>& totals, const std::string& family, bool of_bytes) {
    PlotSeries series;
    series.name = family;
    series.line = family != "presets" && family != "cache 1/10";
    for (const TradeTotal& total : totals) {
        if (total.setting->family != family) continue;
        PlotPoint point;
        point.x = of_bytes ? total.bytes_share : total.seconds_share;
        point.y = std::max(total.error.rms(), kExact);
        if (family == "presets") point.label = total.setting->name;
        point.highlight = of_bytes ? total.bytes_front : total.seconds_front;
        series.points.push_back(point);
    }
    return series;
}

}  // namespace

std::vector<TradeTotal> totalTrade(const std::vector<TradeRun>& runs,
                                   const std::vector<TradeSetting>& settings) {
    std::vector<TradeTotal> totals(settings.size());
    for (std::size_t i = 0; i < settings.size(); ++i) totals[i].setting = &settings[i];
    for (auto begin = runs.begin(); begin != runs.end();) {
        const auto end =
            std::find_if(begin, runs.end(), [&](const TradeRun& run) { return !sameView(run, *begin); });
        addView(std::vector<TradeRun>(begin, end), totals);
        begin = end;
    }
    std::vector<CostError> bytes, seconds;
    for (TradeTotal& total : totals) {
        total.bytes_share = std::exp(total.bytes_share / total.views);
        total.seconds_share = std::exp(total.seconds_share / total.views);
        bytes.push_back({total.bytes_share, total.error.rms()});
        seconds.push_back({total.seconds_share, total.error.rms()});
    }
    for (std::size_t i = 0; i < totals.size(); ++i) {
        totals[i].bytes_front = onFront(bytes, i, kBytesNoise);
        totals[i].seconds_front = onFront(seconds, i, kSecondsNoise);
    }
    return totals;
}

Result<void> plotTrade(const std::vector<TradeTotal>& totals, const std::filesystem::path& file) {
    std::vector<std::string> families;
    for (const TradeTotal& total : totals)
        if (std::find(families.begin(), families.end(), total.setting->family) == families.end())
            families.push_back(total.setting->family);
    std::vector<PlotPanel> panels(2);
    panels[0].title = "Error against bytes (ringed: Pareto front)";
    panels[0].x_label = "bytes streamed (1: the exact picture)";
    panels[1].title = "Error against seconds (ringed: Pareto front)";
    panels[1].x_label = "seconds to the final picture (1: the exact one)";
    for (std::size_t i = 0; i < panels.size(); ++i) {
        panels[i].y_label = "rms error of alpha (1e-06: exact)";
        panels[i].log_x = panels[i].log_y = true;
        for (const std::string& family : families)
            panels[i].series.push_back(seriesOf(totals, family, /*of_bytes=*/i == 0));
    }
    return writePlot(panels, file);
}

Result<void> writeTradeCsv(const std::vector<TradeRun>& runs, const std::filesystem::path& file) {
    std::ofstream out(file);
    fmt::print(
        out,
        "cache,view,setting,seconds,seconds_render,bytes,pages,cache_bytes,cache_reloads,final,rms,worst,"
        "mean_estimate,mean_bound,bound_over_rms,within_1,within_2,within_3,bounds_broken\n");
    for (const TradeRun& run : runs) {
        const PictureError& error = run.error;
        fmt::print(out,
                   "\"{}\",{},\"{}\",{:.6g},{:.6g},{},{},{},{},{},{:.6g},{:.6g},{:.6g},{:.6g},{:.6g},{:.6g},"
                   "{:.6g},{:.6g},{}\n",
                   run.cache, run.view, run.setting->name, run.seconds, run.seconds_render, run.bytes,
                   run.pages, run.cache_bytes, run.reloads, run.final, error.rms(), error.worst(),
                   error.meanEstimate(), error.meanBound(),
                   error.rms() > 0 ? error.meanBound() / error.rms() : 0, error.within(1), error.within(2),
                   error.within(3), error.broken());
    }
    out.close();
    if (!out) return ioError("write", file, errno);
    return {};
}

}  // namespace brickyard

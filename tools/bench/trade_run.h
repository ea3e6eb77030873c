// The settings that `bench trade` compares, and what each made of one view. Plain values.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "client/cpu/render_plan.h"
#include "core/result.h"
#include "tools/bench/bench_subject.h"
#include "tools/bench/picture_error.h"

namespace brickyard {

struct TradeSetting {
    std::string name;
    std::string family;  // settings of one family differ in one number; they are one line of a chart
    QualitySettings quality;
    double quantised = 0;      // largest error of a stored value, as a fraction of the channel's range
    bool small_cache = false;  // a tenth of the working set
};

std::vector<TradeSetting> tradeSettings();

struct TradeRun {
    std::string cache, view;
    const TradeSetting* setting = nullptr;
    PictureError error;
    double seconds = 0;         // from an opened dataset to the final picture; median
    double seconds_render = 0;  // rays alone, of all passes
    std::uint64_t bytes = 0, pages = 0, cache_bytes = 0, reloads = 0;
    bool final = false;
};

// All settings on one view, `repeats` times each where that takes moments. `datasets` are the subject's cache
// by TradeSetting::quantised, as quantisations() orders them. The settings must outlive the runs.
Result<std::vector<TradeRun>> runTrade(const BenchSubject& subject, const BenchView& view,
                                       const std::vector<TradeSetting>& settings,
                                       const std::vector<BenchDataset>& datasets, std::uint32_t size,
                                       unsigned repeats, WorkerPool& pool);

// Each error of a stored value that a setting has, once; the first is 0.
std::vector<double> quantisations(const std::vector<TradeSetting>& settings);

}  // namespace brickyard

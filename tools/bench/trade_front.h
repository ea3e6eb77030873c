// Settings over all views, which of them nothing beats, and the chart of it.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "core/result.h"
#include "tools/bench/trade_run.h"

namespace brickyard {

// One setting over all views. Costs are geometric means of what a view's exact picture (`reference`) costs.
struct TradeTotal {
    const TradeSetting* setting = nullptr;
    PictureError error;
    double bytes_share = 0, seconds_share = 0;
    // Whether no other setting is at least as exact and clearly cheaper: over all views, and in how many of
    // them taken one by one.
    bool bytes_front = false, seconds_front = false;
    unsigned bytes_front_views = 0, seconds_front_views = 0, views = 0;
};

// `runs` holds every setting for every view. In the order of `settings`.
std::vector<TradeTotal> totalTrade(const std::vector<TradeRun>& runs,
                                   const std::vector<TradeSetting>& settings);

// Error against bytes and against seconds: `file`.svg and .png. Errors: kIo.
Result<void> plotTrade(const std::vector<TradeTotal>& totals, const std::filesystem::path& file);

// One line a run. Errors: kIo.
Result<void> writeTradeCsv(const std::vector<TradeRun>& runs, const std::filesystem::path& file);

}  // namespace brickyard

// The shape of a benchmark of `brickyard bench`: it measures, prints a table for a person through
// BenchOptions::print, and gives its figures as JSON. docs/bench.md says what each measures and how to read
// it.
//
// One benchmark runs at a time, on the thread that called it; it may use every processor.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/result.h"

namespace brickyard {

struct BenchOptions {
    std::filesystem::path data;      // caches to measure with; exists
    std::filesystem::path output;    // where files such as trade.csv go; exists
    std::filesystem::path scratch;   // empty; datasets go here. Its owner removes it afterwards
    std::uint32_t size = 512;        // pictures are size x size pixels, a raw dump has size^3 voxels
    unsigned repeats = 5;            // of each timed run, interleaved with its peers; at least 1
    int brick_edge = 16;             // cells along each edge of the bricks that a codec is given
    std::vector<std::string> modes;  // of trade: these groups of options alone; all where it is empty
    // Of a server's clients: how many stream, for how long, and how many connections do nothing.
    std::size_t viewers = 1000, idle = 10'000;
    double seconds = 60;
    std::uint32_t wish_kib = 32;  // of payload that each of their wishes asks for
    std::size_t normal = 50;      // viewers beside a greedy client
    // Of a far network: a round trip, and the bandwidth each way.
    double delay_ms = 100, mbit = 20;
    // Takes lines for a person: tables and verdicts, on stdout. Does nothing under --json.
    std::function<void(const std::string& text)> print;
    // Takes one line on what is being done now, for stderr where that is a terminal.
    std::function<void(const std::string& line)> progress;
};

// Each gives one JSON object. Errors: one line on what, where, what to do. A peer that is not installed is no
// error: its figures are left out and the object says why.
Result<nlohmann::json> benchRender(const BenchOptions& options);
Result<nlohmann::json> benchTrade(const BenchOptions& options);
Result<nlohmann::json> benchPay(const BenchOptions& options);
Result<nlohmann::json> benchStream(const BenchOptions& options);
Result<nlohmann::json> benchFly(const BenchOptions& options);
Result<nlohmann::json> benchZoom(const BenchOptions& options);
Result<nlohmann::json> benchConvert(const BenchOptions& options);
Result<nlohmann::json> benchCodec(const BenchOptions& options);
// These have a server.
Result<nlohmann::json> benchViewers(const BenchOptions& options);
Result<nlohmann::json> benchFirstPicture(const BenchOptions& options);
Result<nlohmann::json> benchFairness(const BenchOptions& options);

}  // namespace brickyard

// Input files into a dataset: plans the frames, skips those that are there, reads, builds and commits the
// others.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/dataset_writer.h"
#include "core/octree_builder.h"
#include "core/result.h"
#include "tools/frame_plan.h"

namespace brickyard {

struct ConversionOptions {
    std::vector<std::string> inputs;  // files and patterns (frame_plan.h)
    // Only these of the frames that the inputs make; other frames of the dataset are left alone.
    std::optional<FrameSet> frames;
    std::filesystem::path output;
    std::vector<std::string> channels;  // empty: all
    double max_error = 0;
    std::map<std::string, double> channel_errors;  // by channel name; wins over max_error
    int brick_edge = kDefaultBrickEdge;
    bool drafts = true;              // exact level-0 payloads begin with one where that pays
    std::uint64_t memory_bytes = 0;  // what the whole conversion may take, about; 0: a gigabyte or so
    // As in InputOptions; an empty `raw`: the inputs are no raw dumps.
    std::string raw, name;
    std::array<double, 3> raw_voxel_size{1, 1, 1};
    unsigned jobs = 0;  // 0: one per hardware thread
    NonFinite nonfinite = NonFinite::kReject;
    ExistingDataset existing = ExistingDataset::kContinue;
    // The brickyard command that reads each file first (vdb_reader_guard.h); empty: this program.
    std::filesystem::path probe_program;
    // How long a file's size and time must not have changed for it to be taken; 0: as it is.
    std::chrono::duration<double> settle{0};
    // Told of what is left out, as one line. May be empty.
    std::function<void(const std::string& note)> note;
    // Asked between bricks, from any thread: true ends the conversion there. May be empty.
    std::function<bool()> stop;
};

struct ConversionReport {
    std::vector<FrameEntry> frames;  // all that the inputs make, those that were there already included
    std::uint32_t converted = 0;     // of them, by this run
    std::uint32_t planned = 0;       // frames that the inputs make
    std::uint64_t input_bytes = 0;
    double seconds = 0;
    bool stopped = false;  // by `options.stop`: finished frames are kept, with kOverwrite the old dataset is
};

// What convert would do, from a sample.
struct ConversionForecast {
    std::uint32_t frames = 0, frames_done = 0;  // frames_done: there already
    std::uint64_t input_bytes = 0;              // of the frames to do
    double bytes = 0, seconds = 0;
    std::vector<std::uint32_t> sampled_frames;
    double sampled = 0;  // share of their bricks that were built, in [0, 1]
};

// Nothing half-written is left behind an error: finished frames stay, and a dataset without any is removed.
// Errors: of the inputs, of the dataset (settings or sources differ), of the disk. One line each.
Result<ConversionReport> convert(const ConversionOptions& options);

// Reads the first, the middle and the last frame that are to do and builds some of their bricks in memory;
// writes nothing. Errors: as of convert.
Result<ConversionForecast> forecast(const ConversionOptions& options);

const char* toString(NonFinite policy);

}  // namespace brickyard

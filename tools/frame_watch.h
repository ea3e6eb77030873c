// Takes the frames of a folder as a simulation completes them, one by one, into one dataset. Kept apart from
// the conversion itself: each frame is an ordinary append, so whatever ends this program loses nothing.
#pragma once

#include <chrono>
#include <functional>
#include <optional>
#include <string>

#include "tools/conversion.h"

namespace brickyard {

struct WatchOptions {
    std::filesystem::path folder;
    std::string pattern;  // of file names; empty: what is a format of ours by its extension
    std::chrono::duration<double> settle{2};            // how long a file's size and time must not change
    std::optional<std::chrono::duration<double>> idle;  // ends when nothing has changed for so long
    std::optional<std::uint32_t> until_frame;           // ends when this frame is there
    std::function<void(const std::string& line)> tell;  // one line per frame
};

struct WatchReport {
    std::uint32_t converted = 0,
                  failed = 0;  // frames; a frame that fails is tried again when its file changes
    bool stopped = false;      // by `options.stop`
};

// `options` says how to convert; its inputs and what it says of an existing dataset are not used. Errors:
// kNotFound (no such folder).
Result<WatchReport> watchFrames(const WatchOptions& watch, ConversionOptions options);

}  // namespace brickyard

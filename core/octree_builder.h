// From one channel's field to its octree of bricks: topology, levels, statistics, error bounds, payloads; in
// memory that does not grow with the field, and in one pass over it.
//
// Levels: full weighting (1/4, 1/2, 1/4 per axis) of the level below; level l is stored on the ancestors of
// level-0 bricks. Every coarse level is quantised to a tenth of its own step's RMS and the deviations are
// measured on the decoded values against the source's level 0, so bounds hold for what a reader sees.
// docs/design.md, sections "Levels" and "Error".
//
// The field is worked on in chunks of 128^3 voxels (chunk.h): read, reduced, measured and encoded at once,
// committed in their order. What chunks leave for the levels above them, a 512th, is worked on in the same
// way, and so on. Levels within a chunk are measured against level 0 itself; above, the RMS still is, and the
// strict bound is the deviation from the chunk's top plus that one's own.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>

#include "core/brick_shape.h"
#include "core/field_source.h"
#include "core/frame_writer.h"
#include "core/result.h"

namespace brickyard {

// Calls body(i) for each i in [0, n), in any order and from any number of threads; returns when all are done.
// core starts no threads of its own: the caller brings them. Best handed out in rising order: long pieces
// come first.
using ParallelFor = std::function<void(std::size_t n, const std::function<void(std::size_t)>& body)>;
inline void serialFor(std::size_t n, const std::function<void(std::size_t)>& body) {
    for (std::size_t i = 0; i < n; ++i) body(i);
}

enum class NonFinite { kReject, kZero, kClamp };

struct BuildOptions {
    BrickShape shape;
    double max_error = 0;  // |stored - source| at level 0; 0 is bit-exact
    bool drafts = true;    // exact level-0 payloads begin with a draft where that pays (brick_codec.h)
    NonFinite nonfinite = NonFinite::kReject;
    ParallelFor parallel_for = serialFor;
    // Told now and then: chunks done, of how many that are known so far. May be empty. Called from one thread
    // at a time.
    std::function<void(std::size_t done, std::size_t total)> progress;
    // What building may hold at once, beside what the fields keep; 0: some hundred megabytes. The same bytes
    // come out.
    std::uint64_t memory_bytes = 0;
    // Where what does not fit is put for a while (ScratchFile). Empty: it all stays in memory.
    std::filesystem::path scratch_folder;
};

// Builds every channel and appends payloads (finest level of all channels first), then tree blocks. Gives the
// footer for FrameWriter::finish. The same bytes for any ParallelFor. `parallel_for`, `progress`,
// `memory_bytes` and `scratch_folder` are those of the first options. Errors: those of the sources; kInvalid
// (a value that is not finite: names channel, voxel and value); kIo.
Result<FrameFooter> buildFrame(std::span<const FieldSource* const> channels,
                               std::span<const BuildOptions> options, FrameWriter& writer);

}  // namespace brickyard

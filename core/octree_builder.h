// From one channel's field to its octree of bricks: topology, levels, statistics, error bounds, payloads.
//
// Levels: full weighting (1/4, 1/2, 1/4 per axis) of the level below; level l is stored on the ancestors of
// level-0 bricks, and counts as background elsewhere. Every coarse level is quantised to a tenth of its own
// step's RMS and the deviations are measured on the decoded values against the source's level 0, so bounds
// hold for what a reader sees. docs/design.md, sections "Levels" and "Error".
#pragma once

#include <functional>

#include "core/brick_shape.h"
#include "core/field_source.h"
#include "core/frame_writer.h"
#include "core/result.h"

namespace brickyard {

// Calls body(i) for each i in [0, n), in any order and from any number of threads; returns when all are done.
// core starts no threads of its own: the caller brings them.
using ParallelFor = std::function<void(std::size_t n, const std::function<void(std::size_t)>& body)>;
inline void serialFor(std::size_t n, const std::function<void(std::size_t)>& body) {
    for (std::size_t i = 0; i < n; ++i) body(i);
}

enum class NonFinite { kReject, kZero, kClamp };

struct BuildOptions {
    BrickShape shape;
    double max_error = 0;  // |stored - source| at level 0; 0 is bit-exact
    NonFinite nonfinite = NonFinite::kReject;
    ParallelFor parallel_for = serialFor;
    // Told now and then: level-0 bricks done, of how many. May be empty. Called from one thread at a time.
    std::function<void(std::size_t done, std::size_t total)> progress;
};

// Builds every channel and appends payloads (finest level of all channels first), then tree blocks. Gives the
// footer for FrameWriter::finish. The same bytes for any ParallelFor. Errors: those of the sources; kInvalid
// (a value that is not finite: names channel, voxel and value); kIo.
Result<FrameFooter> buildFrame(std::span<const FieldSource* const> channels,
                               std::span<const BuildOptions> options, FrameWriter& writer);

}  // namespace brickyard

// The levels of a channel's octree, counted.
#pragma once

#include <vector>

#include "tools/field_reader.h"

namespace brickyard {

struct LevelSummary {
    std::uint64_t nodes = 0, bricks = 0, payload_bytes = 0;
    double rms = 0;    // deviation from level 0: root mean square over the level's nodes with bricks
    double bound = 0;  // largest
};

// By level, 0 first. Reads every tree block, no payload. Errors: kCorrupt, kIo.
Result<std::vector<LevelSummary>> summarizeLevels(const FieldReader& reader);

}  // namespace brickyard

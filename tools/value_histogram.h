// How often which value occurs in a level of a channel, counted in voxels of level 0.
#pragma once

#include <vector>

#include "tools/field_walk.h"

namespace brickyard {

struct ValueHistogram {
    int level = 0;
    double lowest = 0, highest = 0;  // bins divide [lowest, highest]; the last has its end in it
    // Per bin; a voxel of level L counts 8^L. One bin where all values are the same.
    std::vector<std::uint64_t> voxels;
};

// Active voxels over the channel's own range; of vectors their length, over the range of lengths there can
// be. What levels above 0 have outside of the range (they mix in the background) counts at its ends. Errors:
// those of FieldReader.
Result<ValueHistogram> countValues(const FieldReader& reader, int level, int bins);

}  // namespace brickyard

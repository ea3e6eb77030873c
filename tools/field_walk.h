// The stored voxels of one level of a channel, whole regions at a time. What is not stored is inactive
// background and is not told. Level 0 comes in the channel's own type with the source's states; levels above
// it have no states and come as float32: what differs from the background counts as active.
#pragma once

#include "tools/field_reader.h"
#include "tools/voxel_sink.h"

namespace brickyard {

// The type of a level's values: the channel's at level 0, float32 above it.
SampleType walkedType(SampleType type, int level);
// The background as walkField's values have it.
std::vector<ValueBits> walkedBackground(const FieldReader& reader, int level);
// The voxels of `level` that lie in a box of level 0: their positions times 2^level are inside.
IndexBox levelBox(const IndexBox& finest, int level);

// Tells `sink` of every stored voxel of `level` in `box`, which counts voxels of that level. A channel with
// fewer levels is evaluated between its coarsest samples. Errors: those of FieldReader.
Result<void> walkField(const FieldReader& reader, int level, const IndexBox& box, VoxelSink& sink);

// The voxels of `box` of `level` as one dense block in walkedType(): what is not stored is background. Takes
// memory for all of the box.
Result<void> readLevel(const FieldReader& reader, int level, const IndexBox& box, SampleBlock& out);

}  // namespace brickyard

// A box of one channel as a dense dump: x fastest, components interleaved, little-endian.
#pragma once

#include <filesystem>
#include <string>

#include "tools/field_reader.h"

namespace brickyard {

// What a dump holds a value in: the source's own integer type where the channel knows it, float32 above level
// 0; bools are uint8.
std::string rawTypeName(const ChannelFooter& channel, int level);

// Writes the voxels of `box` of `level` (in that level's positions) and replaces `file` when all is written.
// Memory: some 64 MiB and the reader's cache, whatever the box. Errors: those of FieldReader; kInvalid (a
// value that the source's type cannot hold); kIo (also where the disk has not the room, before it is filled).
Result<void> writeRaw(const std::filesystem::path& file, const FieldReader& reader, int level,
                      const IndexBox& box);

}  // namespace brickyard

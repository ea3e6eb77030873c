// A dense volume in a file as a field: every sample within its extents is active, outside is inactive 0.
// Holds a bounded part of the file in memory, whatever its size.
#pragma once

#include <memory>

#include "core/field_source.h"
#include "tools/importers/byte_file.h"
#include "tools/importers/dense_layout.h"

namespace brickyard {

// `name`, `index_to_world`, `grid_class`, `vector_type` and `metadata` of `info` are the caller's; the rest
// follows from the layout. `memory_bytes` is what the field may hold; 0: as much as pays (192 MiB). At least
// 16 MiB are taken where the volume is that large. REQUIRES: the layout's bytes are within the file. Errors:
// kIo, kCorrupt.
Result<std::unique_ptr<FieldSource>> makeDenseField(ByteFile file, const DenseLayout& layout,
                                                    ChannelInfo info, std::uint64_t memory_bytes);

}  // namespace brickyard

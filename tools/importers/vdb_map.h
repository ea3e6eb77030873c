// The map from index to world of a .vdb grid, as stored (openvdb/math/Maps.h).
#pragma once

#include <array>
#include <optional>

#include "core/result.h"
#include "tools/importers/vdb_bytes.h"

namespace brickyard {

// Reads a map. Gives its columns as Affine::fromColumns takes them, unjudged; nothing for a frustum, whose
// bytes are not passed. Errors: kCorrupt (no map has this name; also where the cursor ended), without file
// and place.
Result<std::optional<std::array<double, 16>>> readVdbMap(VdbCursor& cursor);

}  // namespace brickyard

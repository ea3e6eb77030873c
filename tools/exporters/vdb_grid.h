// An exported channel as an OpenVDB grid in memory. Only the exporters that see OpenVDB include this.
#pragma once

#include <openvdb/Grid.h>

#include <filesystem>

#include "tools/exporters/exported_grid.h"

namespace brickyard {

// Values, active states, name, class, vector type, half flag, transform and metadata. Errors: those of the
// filler; kUnsupported (OpenVDB has no such type). Throws what OpenVDB throws (voxels below 1e-9; memory).
Result<openvdb::GridBase::Ptr> makeVdbGrid(const ExportedGrid& grid);

// What to say of an exception that OpenVDB or NanoVDB threw while `file` was made. `program` is its name.
Error exportFailure(const std::filesystem::path& file, const char* program, const std::exception& thrown);

}  // namespace brickyard

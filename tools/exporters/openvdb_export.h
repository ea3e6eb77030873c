// Channels of a frame as one .vdb file.
#pragma once

#include <filesystem>
#include <span>

#include "tools/exporters/exported_grid.h"

namespace brickyard {

// Writes a .vdb with one grid per entry and the file's own metadata, replacing `file` when all is written.
// Holds all grids in memory: so OpenVDB writes. Errors: those of the fillers; kUnsupported (OpenVDB has no
// such type); kIo (memory, disk, or OpenVDB refuses the transform).
Result<void> writeVdb(const std::filesystem::path& file, std::span<const ExportedGrid> grids,
                      const std::vector<MetadataEntry>& metadata);

}  // namespace brickyard

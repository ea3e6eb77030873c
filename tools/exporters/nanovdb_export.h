// Channels of a frame as one .nvdb file.
#pragma once

#include <filesystem>
#include <span>

#include "tools/exporters/exported_grid.h"

namespace brickyard {

enum class NanoCodec { kNone, kZip, kBlosc };

// Writes a .nvdb with one segment per grid, replacing `file` when all is written. Holds one grid at a time in
// memory, twice: as OpenVDB's and as NanoVDB's. NanoVDB has no metadata and no vector types. Errors: those of
// the fillers; kUnsupported (a type that NanoVDB lacks: names the channel; nothing is written); kIo.
Result<void> writeNanoVdb(const std::filesystem::path& file, std::span<const ExportedGrid> grids,
                          NanoCodec codec);

}  // namespace brickyard

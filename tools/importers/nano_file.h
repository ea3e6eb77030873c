// The outside of a .nvdb file: its segments, and where each grid's bytes are, unpacked where they are
// compressed. Nothing of NanoVDB itself is needed for that.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "core/result.h"
#include "tools/importers/byte_file.h"

namespace brickyard {

enum class NanoCodec : std::uint16_t { kNone = 0, kZip = 1, kBlosc = 2 };

// One grid as the table of its segment says. Every length was compared with the file's.
struct NanoGridEntry {
    std::string name;        // bytes as they are
    std::uint32_t type = 0;  // nanovdb::GridType
    NanoCodec codec = NanoCodec::kNone;
    std::uint64_t begin = 0, file_bytes = 0;  // in the file
    std::uint64_t grid_bytes = 0;             // unpacked
};

// Errors: kNotFound, kIo, kCorrupt; kTooNew, kUnsupported (a version whose grids are laid out otherwise).
Result<std::vector<NanoGridEntry>> listNanoGrids(const ByteFile& file);

// A grid's bytes: `size` of them from `begin`.
struct NanoGridBytes {
    std::shared_ptr<const ByteFile> file;
    std::uint64_t begin = 0, size = 0;

    // Errors: kIo; kCorrupt where [offset, offset + out.size()) is not within the grid.
    Result<void> read(std::uint64_t offset, std::span<std::byte> out) const;
};

// `file` itself where the grid is not compressed, else an unlinked temporary file. Errors: kIo, kCorrupt.
Result<NanoGridBytes> unpackNanoGrid(const std::shared_ptr<const ByteFile>& file, const NanoGridEntry& entry);

}  // namespace brickyard

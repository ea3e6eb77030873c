// One input file of any format that is understood, as the fields that become channels. Which format it is, is
// read from its first bytes, not from its name; a raw dump has none and is named by its layout.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/field_source.h"
#include "core/result.h"

namespace brickyard {

// A grid that is sound, but is no channel.
struct SkippedGrid {
    std::string name;    // as a channel would be called
    std::string reason;  // "is a frustum grid ..."
};

struct InputContents {
    // In the order of their names. A field reads its samples when it is asked for them, and may keep the file
    // open.
    std::vector<std::unique_ptr<FieldSource>> fields;
    std::vector<SkippedGrid> skipped;
    std::vector<std::string> names;       // of every grid, wanted or not
    std::vector<MetadataEntry> metadata;  // of the file
};

struct InputOptions {
    std::vector<std::string> channels;  // only these; empty: all
    // What the readers of one file may hold in memory, all fields together; 0: as it comes.
    std::uint64_t memory_bytes = 0;
    // Layout of a raw dump, as after --raw: "128x128x128:float32". Empty: the file tells what it is.
    std::string raw;
    // Of a raw dump, which has neither.
    std::array<double, 3> raw_voxel_size{1, 1, 1};
    std::string name;  // of its channel, and of a NRRD file's; empty: "density"
    // The brickyard command that reads a file under limits where our own reader cannot (vdb_reader_guard.h);
    // empty: this program.
    std::filesystem::path probe_program;
};

enum class InputFormat { kOpenVdb, kNanoVdb, kNrrd, kRaw };

// Told by the first bytes; kRaw where a layout is given. Errors: kNotFound, kIo; kUnsupported, with what
// would be understood.
Result<InputFormat> detectFormat(const std::filesystem::path& file, const InputOptions& options);

// Errors: kNotFound, kIo, kCorrupt, kUnsupported, kInvalid: one line with file, grid and place.
Result<InputContents> openInput(const std::filesystem::path& file, const InputOptions& options);

}  // namespace brickyard

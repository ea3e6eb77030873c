// The outside of a .vdb file, read with every length compared with the file's first: archive header,
// metadata, the table of grids, and of each grid what precedes its tree. File versions 220 to 224 for the
// header and the table, 222 to 224 for grids. No value of a grid is read here.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "core/field_source.h"
#include "core/result.h"
#include "tools/importers/vdb_bytes.h"

namespace brickyard {

// One line of the table of grids.
struct VdbGridEntry {
    std::string unique_name;  // with "\x1e" and a number where the file has several grids of one name
    std::string type;         // "Tree_float_5_4_3"
    std::string parent;       // unique name of the grid whose tree this one shares; else empty
    // The grid's bytes. Of a file without offsets only the beginning is known.
    std::uint64_t begin = 0, end = 0;

    std::string name() const { return unique_name.substr(0, unique_name.find('\x1e')); }
    // "density[1]", as OpenVDB shows a unique name.
    std::string shownName() const;
    // "float" of "Tree_float_5_4_3"; empty where the tree has other levels.
    std::string valueType() const;
};

// What precedes a grid's tree.
struct VdbGridHead {
    std::uint32_t compression = 0;
    std::vector<MetadataEntry>
        metadata;  // in the file's order, without what is only of use to OpenVDB's reader
    std::uint64_t metadata_bytes = 0;
    bool linear = true;
    std::array<double, 16> index_to_world{};  // column-major; only where linear
    std::uint64_t tree_begin = 0;

    // The value of a note of type string; empty where there is none.
    std::string text(const std::string& name) const;
    // Whether a note of any type is there and neither zero nor empty.
    bool flag(const std::string& name) const;
};

// Immutable once open. Any thread.
class VdbFile {
public:
    // Costs a read of at most some kilobytes per grid. Errors: kNotFound, kIo, kInvalid, kCorrupt, kTooNew,
    // kUnsupported (older than 220, of 2012).
    static Result<VdbFile> open(const std::filesystem::path& file);

    const VdbBytes& bytes() const { return *bytes_; }
    std::shared_ptr<const VdbBytes> sharedBytes() const { return bytes_; }
    std::uint32_t version() const { return version_; }
    const std::vector<MetadataEntry>& metadata() const { return metadata_; }

    // False for a file that was written as a stream: its grids follow each other, and where one ends is known
    // when its tree has been passed. Then grids() is empty, and readEntry takes the first of gridCount() at
    // gridsBegin().
    bool hasOffsets() const { return has_offsets_; }
    const std::vector<VdbGridEntry>& grids() const { return grids_; }
    std::size_t gridCount() const { return grid_count_; }
    std::uint64_t gridsBegin() const { return grids_begin_; }
    // Errors: kCorrupt, kIo.
    Result<VdbGridEntry> readEntry(std::uint64_t at, std::size_t number) const;

    // REQUIRES: version() >= 222. Errors: kCorrupt, kIo, kUnsupported (notes beyond any use), with the file
    // and `where` ("grid 'density'").
    Result<VdbGridHead> readHead(const VdbGridEntry& grid, const std::string& where) const;

private:
    explicit VdbFile(VdbBytes bytes) : bytes_(std::make_shared<VdbBytes>(std::move(bytes))) {}
    Result<void> readHeader();
    Result<void> readTable();
    Result<VdbGridEntry> readEntry(VdbCursor& cursor, std::size_t number) const;

    std::shared_ptr<const VdbBytes> bytes_;
    std::uint32_t version_ = 0;
    bool has_offsets_ = true;
    std::vector<MetadataEntry> metadata_;
    std::vector<VdbGridEntry> grids_;
    std::size_t grid_count_ = 0;
    std::uint64_t grids_begin_ = 0;
};

}  // namespace brickyard

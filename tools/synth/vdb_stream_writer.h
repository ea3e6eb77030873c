// Writes .vdb files of float fog volumes leaf by leaf, in constant memory: OpenVDB's own writer needs the
// whole tree. A file has a tree's topology first and its values behind it, so each block of leaves is made
// twice. The format is OpenVDB's file version 224, which libopenvdb 8 and newer reads.
#pragma once

#include <array>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "core/octree_builder.h"
#include "core/result.h"
#include "tools/synth/leaf_source.h"

namespace brickyard {

struct VdbGridSummary {
    std::uint64_t voxels = 0, leaves = 0;
    std::array<std::int32_t, 3> first{}, last{};  // tight box of the active voxels, inclusive
};

class VdbStreamWriter {
public:
    struct Options {
        bool blosc = true;                     // else the values are not compressed
        std::uint32_t grids = 1;               // how many addGrid calls will follow
        ParallelFor parallel_for;              // makes leaves
        std::function<void(double)> progress;  // of the grid being added, in [0, 1]; may be empty
    };
    // Errors: kIo.
    static Result<std::unique_ptr<VdbStreamWriter>> create(const std::filesystem::path& file,
                                                           Options options);
    ~VdbStreamWriter();

    // REQUIRES: a name that no other grid of the file has, and at least one active voxel.
    Result<VdbGridSummary> addGrid(const std::string& name, double voxel_size, const LeafSource& source);
    // Everything is on disk. Errors: kIo.
    Result<std::uint64_t> finish();

private:
    using Coord = std::array<std::int32_t, 3>;
    VdbStreamWriter(std::filesystem::path path, std::FILE* file, Options options)
        : path_(std::move(path)), file_(file), options_(std::move(options)) {}

    template <class T>
    void put(const T& value);
    void putBytes(const void* bytes, std::size_t count);
    void putString(const std::string& text);
    void putMetadata(const std::string& name, const std::string& type, const std::string& value);
    bool putBranch(const std::vector<Coord>& blocks, std::size_t begin, std::size_t end, const Coord& origin,
                   const LeafSource& source, VdbGridSummary& summary);
    std::int64_t position();
    Result<void> status();

    std::filesystem::path path_;
    std::FILE* file_;
    Options options_;
    int error_ = 0;  // the first errno
};

}  // namespace brickyard

// OpenVDB grids as fields: every float, double, int32, int64, bool, mask, vec3s, vec3d and vec3i grid of a
// .vdb file. No OpenVDB header is seen from here. A file that is not ours should first pass checkVdb
// (vdb_reader_guard.h).
#pragma once

#include <array>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/field_source.h"
#include "core/result.h"
#include "tools/importers/input_file.h"

namespace brickyard {

class VdbField : public FieldSource {
public:
    // What openvdb::tools::BoxSampler gives at a position in index space: the independent check of our own
    // field. Nothing for types that it does not interpolate (integers, bools) and next to the limits of
    // int32.
    virtual std::optional<std::array<double, 3>> boxSample(const glm::dvec3& index) const = 0;
};

struct VdbContents {
    std::vector<std::unique_ptr<VdbField>> fields;  // in the order of their names
    std::vector<SkippedGrid> skipped;
    std::vector<std::string> names;       // of every grid, wanted or not
    std::vector<MetadataEntry> metadata;  // of the file
};

// Reads the grids whose channel name is in `channels`; all where that is empty. Names are made unique as
// OpenVDB makes them ("density[1]"), an empty one becomes "unnamed", bytes that are not UTF-8 become %XX.
// Errors: kNotFound, kCorrupt, kIo, kInvalid (a transform that is singular or not finite): file and grid are
// named.
Result<VdbContents> readVdb(const std::filesystem::path& file, const std::vector<std::string>& channels);

}  // namespace brickyard

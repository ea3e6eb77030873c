// A channel of a dataset as an OpenVDB grid in a .vdb file: values, active states, name, class and transform.
// No OpenVDB header is seen from here.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/affine.h"
#include "core/brick_shape.h"
#include "core/index_box.h"
#include "core/result.h"
#include "core/sample_type.h"

namespace brickyard {

// What a grid is, beside its voxels.
struct ExportedGrid {
    std::string name;
    SampleType type = SampleType::kFloat32;
    int components = 1;
    std::vector<ValueBits> background;
    Affine index_to_world;
    std::string grid_class, vector_type;
    bool saved_as_half = false;
};

// Receives one grid's voxels, in any order; each box once. Not thread-safe.
class GridSink {
public:
    virtual ~GridSink() = default;
    // A box of one value and one state.
    virtual void fill(const IndexBox& box, std::span<const ValueBits> value, bool active) = 0;
    // The voxels of a box whose corner and extents are multiples of 8: planar, x fastest; one state byte
    // each.
    virtual void copy(const IndexBox& box, std::span<const std::byte> values,
                      std::span<const std::uint8_t> active) = 0;
};

// Puts the voxels of one grid into `sink`.
using GridFiller = std::function<Result<void>(GridSink& sink)>;

// Writes a .vdb with one grid per entry, replacing `file` when all is written. Errors: those of the fillers;
// kInvalid (OpenVDB has no such grid type, or refuses the transform); kIo.
Result<void> writeVdb(const std::filesystem::path& file, std::span<const ExportedGrid> grids,
                      std::span<const GridFiller> fillers);

}  // namespace brickyard

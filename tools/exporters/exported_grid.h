// A channel as it goes into a file of another program: what it is, and who puts its voxels in. No header of
// that program is seen from here.
#pragma once

#include <string>
#include <vector>

#include "core/affine.h"
#include "core/field_source.h"
#include "tools/voxel_sink.h"

namespace brickyard {

struct ExportedGrid {
    std::string name;
    SampleType type = SampleType::kFloat32;
    int components = 1;
    std::vector<ValueBits> background;
    Affine index_to_world;
    std::string grid_class, vector_type;
    bool saved_as_half = false;
    bool mask = false;  // states alone: the source had no values
    std::vector<MetadataEntry> metadata;
    VoxelFiller fill;
};

}  // namespace brickyard

// What a SourceGrid holds. Includes OpenVDB: only for the files that read it.
#pragma once

#include <openvdb/openvdb.h>

#include "core/affine.h"

namespace brickyard {

struct SourceGridData {
    openvdb::FloatGrid::ConstPtr grid;
    Affine transform;               // the grid's index to world
    openvdb::CoordBBox active_box;  // of its active voxels
};

}  // namespace brickyard

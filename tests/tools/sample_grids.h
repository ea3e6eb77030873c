// OpenVDB files for tests: every type of grid that converts, with voxels, tiles, negative coordinates and
// strange names.
#pragma once

#include <openvdb/openvdb.h>

#include <cmath>
#include <filesystem>
#include <random>
#include <string>

namespace brickyard {

template <class Value>
Value gridValue(double v) {
    if constexpr (std::is_arithmetic_v<Value>)
        return Value(v);
    else
        return Value(typename Value::ValueType(v), typename Value::ValueType(-2 * v),
                     typename Value::ValueType(v * v));
}

// Values from a formula of the position in a lumpy region around (-20, 5, 30), active tiles of 8^3 and 128^3,
// inactive voxels with values, and a background that is not zero.
// The large tile costs a converter thousands of bricks.
template <class GridT>
typename GridT::Ptr lumpyGrid(const std::string& name, unsigned seed, bool large_tile = false) {
    using Value = typename GridT::ValueType;
    auto grid = GridT::create(gridValue<Value>(3));
    grid->setName(name);
    auto accessor = grid->getAccessor();
    std::mt19937 random(seed);
    for (int z = 0; z < 48; ++z)
        for (int y = 0; y < 37; ++y)
            for (int x = 0; x < 29; ++x) {
                const openvdb::Coord at(x - 20, y - 7, z + 3);
                const double lump = std::sin(0.31 * x) + std::cos(0.23 * y) + std::sin(0.17 * z + seed);
                if (lump < 0.2) continue;
                const auto value = gridValue<Value>(100 * lump + double(random() % 7));
                if (random() % 11 == 0)
                    accessor.setValueOff(at, value);
                else
                    accessor.setValueOn(at, value);
            }
    grid->tree().addTile(1, openvdb::Coord(64, 0, 0), gridValue<Value>(9), true);
    grid->tree().addTile(1, openvdb::Coord(-64, -64, -64), gridValue<Value>(4), false);
    if (large_tile) grid->tree().addTile(2, openvdb::Coord(-256, 128, 0), gridValue<Value>(11), true);
    return grid;
}

inline openvdb::MaskGrid::Ptr lumpyMask(const std::string& name) {
    auto grid = openvdb::MaskGrid::create();
    grid->setName(name);
    for (int i = 0; i < 4000; ++i)
        grid->tree().setValueOn(openvdb::Coord(i % 31 - 9, i / 31 % 17, i / 500 - 3));
    grid->tree().addTile(1, openvdb::Coord(64, 0, 0), true, true);
    return grid;
}

inline void writeGrids(const std::filesystem::path& file, const openvdb::GridPtrVec& grids) {
    openvdb::io::File output(file.string());
    output.write(grids);
    output.close();
}

// One grid of every type, each with its own affine transform.
inline openvdb::GridPtrVec gridsOfAllTypes(unsigned seed) {
    openvdb::GridPtrVec grids{lumpyGrid<openvdb::FloatGrid>("a_float", seed, /*large_tile=*/true),
                              lumpyGrid<openvdb::FloatGrid>("a_half", seed + 1),
                              lumpyGrid<openvdb::DoubleGrid>("a_double", seed + 2),
                              lumpyGrid<openvdb::Int32Grid>("an_int32", seed + 3),
                              lumpyGrid<openvdb::Int64Grid>("an_int64", seed + 4),
                              lumpyGrid<openvdb::BoolGrid>("a_bool", seed + 5),
                              lumpyMask("a_mask"),
                              lumpyGrid<openvdb::Vec3SGrid>("a_vec3s", seed + 6),
                              lumpyGrid<openvdb::Vec3DGrid>("a_vec3d", seed + 7),
                              lumpyGrid<openvdb::Vec3IGrid>("a_vec3i", seed + 8)};
    for (std::size_t i = 0; i < grids.size(); ++i) {
        grids[i]->setTransform(openvdb::math::Transform::createLinearTransform(0.1 * double(i + 1)));
        grids[i]->transform().postTranslate(openvdb::Vec3d(double(i), -1, 1e6));
        if (i % 2) grids[i]->transform().preRotate(0.3, openvdb::math::X_AXIS);
    }
    grids[1]->setSaveFloatAsHalf(true);
    grids[0]->setGridClass(openvdb::GRID_FOG_VOLUME);
    grids[7]->setGridClass(openvdb::GRID_STAGGERED);
    grids[7]->setVectorType(openvdb::VEC_CONTRAVARIANT_RELATIVE);
    return grids;
}

}  // namespace brickyard

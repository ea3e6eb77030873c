// Are two .vdb files the same to whoever reads them with OpenVDB? Their trees may be built differently.
#pragma once

#include <openvdb/openvdb.h>

#include <cstring>
#include <map>
#include <random>
#include <sstream>
#include <string>

namespace brickyard {

template <class Tree>
std::string compareVoxel(const openvdb::tree::ValueAccessor<const Tree>& a,
                         const openvdb::tree::ValueAccessor<const Tree>& b, const openvdb::Coord& at) {
    const auto x = a.getValue(at), y = b.getValue(at);
    if (std::memcmp(&x, &y, sizeof x) == 0 && a.isValueOn(at) == b.isValueOn(at)) return {};
    std::ostringstream text;
    text << at << ": " << x << (a.isValueOn(at) ? " active" : " inactive") << " and " << y
         << (b.isValueOn(at) ? " active" : " inactive");
    return text.str();
}

// Every voxel of every leaf of `a`, and corners and random places of its tiles, in `b`. Both ways round they
// meet all voxels of both.
template <class Tree>
std::string compareTree(const Tree& a, const Tree& b) {
    const openvdb::tree::ValueAccessor<const Tree> in_a(a), in_b(b);
    for (auto leaf = a.cbeginLeaf(); leaf; ++leaf)
        for (openvdb::Index n = 0; n < Tree::LeafNodeType::SIZE; ++n)
            if (auto difference = compareVoxel(in_a, in_b, leaf->offsetToGlobalCoord(n)); !difference.empty())
                return difference;
    std::mt19937 random(3);
    auto tile = a.cbeginValueAll();
    tile.setMaxDepth(Tree::ValueAllCIter::LEAF_DEPTH - 1);
    for (; tile; ++tile) {
        const openvdb::CoordBBox box = tile.getBoundingBox();
        for (int i = 0; i < 24; ++i) {
            openvdb::Coord at;
            for (int axis = 0; axis < 3; ++axis)
                at[axis] = i < 8 ? (i >> axis & 1 ? box.max() : box.min())[axis]
                                 : box.min()[axis] + std::int32_t(random() % std::uint32_t(box.dim()[axis]));
            if (auto difference = compareVoxel(in_a, in_b, at); !difference.empty()) return difference;
        }
    }
    return {};
}

template <class GridT>
bool compareAs(const openvdb::GridBase& a, const openvdb::GridBase& b, std::string& difference) {
    if (!a.isType<GridT>()) return false;
    if (!b.isType<GridT>()) {
        difference = "is a " + b.type();
        return true;
    }
    const auto& one = static_cast<const GridT&>(a);
    const auto& other = static_cast<const GridT&>(b);
    const auto x = one.background(), y = other.background();
    if (std::memcmp(&x, &y, sizeof x) != 0) difference = "background";
    if (difference.empty()) difference = compareTree(one.constTree(), other.constTree());
    if (difference.empty()) difference = compareTree(other.constTree(), one.constTree());
    return true;
}

// All but what the writer of a file finds out by itself.
inline std::map<std::string, std::string> metadataOf(const openvdb::MetaMap& metadata) {
    std::map<std::string, std::string> texts;
    for (auto it = metadata.beginMeta(); it != metadata.endMeta(); ++it) {
        if (it->first.starts_with("file_")) continue;
        // No name and an empty one are the same.
        if (it->first == "name" && it->second->str().empty()) continue;
        std::ostringstream bytes;
        it->second->write(bytes);
        texts[it->first] = it->second->typeName() + " " + bytes.str();
    }
    return texts;
}

// The first difference of two grids, empty where there is none.
inline std::string compareGrids(const openvdb::GridBase& a, const openvdb::GridBase& b) {
    if (a.getName() != b.getName()) return "name '" + b.getName() + "'";
    if (a.getGridClass() != b.getGridClass()) return "class";
    if (a.getVectorType() != b.getVectorType()) return "vector type";
    if (a.saveFloatAsHalf() != b.saveFloatAsHalf()) return "half flag";
    const openvdb::Mat4d m = a.transform().baseMap()->getAffineMap()->getMat4(),
                         n = b.transform().baseMap()->getAffineMap()->getMat4();
    for (int i = 0; i < 16; ++i)
        if (m.asPointer()[i] != n.asPointer()[i]) return "transform";
    const auto one = metadataOf(a), other = metadataOf(b);
    for (const auto& [name, value] : one)
        if (!other.contains(name) || other.at(name) != value) return "metadata '" + name + "'";
    for (const auto& [name, value] : other)
        if (!one.contains(name)) return "metadata '" + name + "' is new";
    std::string difference;
    const bool known =
        [&]<class... Grids>(openvdb::TypeList<Grids...>) {
            return (compareAs<Grids>(a, b, difference) || ...);
        }(openvdb::TypeList<openvdb::FloatGrid, openvdb::DoubleGrid, openvdb::Int32Grid, openvdb::Int64Grid,
                            openvdb::BoolGrid, openvdb::MaskGrid, openvdb::Vec3SGrid, openvdb::Vec3DGrid,
                            openvdb::Vec3IGrid>());
    return known ? difference : "a type that is not compared";
}

}  // namespace brickyard

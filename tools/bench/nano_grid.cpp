#include "tools/bench/nano_grid.h"

#include <fmt/format.h>
#include <nanovdb/util/OpenToNanoVDB.h>

#include "tools/bench/source_grid_data.h"

namespace brickyard {
namespace {

using Buffer = nanovdb::GridHandle<nanovdb::HostBuffer>;

// Shares the buffer that the grid lies in.
template <class Value>
std::shared_ptr<const void> gridOf(Buffer buffer) {
    const auto owner = std::make_shared<Buffer>(std::move(buffer));
    return std::shared_ptr<const void>(owner, owner->template grid<Value>());
}

openvdb::MaskGrid::Ptr cellsWithDensity(const openvdb::FloatGrid& grid) {
    const auto cells = openvdb::MaskGrid::create();
    // Not registered with the tree: the tree is not changed in other ways while it is in use.
    auto accessor = cells->getUnsafeAccessor();
    // A corner belongs to the eight cells below it.
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf)
        for (auto value = leaf->cbeginValueAll(); value; ++value) {
            if (!(*value > 0)) continue;
            for (int i = 0; i < 8; ++i)
                accessor.setValueOn(value.getCoord().offsetBy(-(i >> 2 & 1), -(i >> 1 & 1), -(i & 1)));
        }
    auto tile = grid.tree().cbeginValueAll();
    tile.setMaxDepth(openvdb::FloatTree::ValueAllCIter::LEAF_DEPTH - 1);
    for (; tile; ++tile) {
        if (!(*tile > 0)) continue;
        openvdb::CoordBBox box = tile.getBoundingBox();
        box.min().offset(-1);
        cells->fill(box, true);
    }
    return cells;
}

}  // namespace

Result<NanoGrid> NanoGrid::create(const SourceGrid& grid) {
    const openvdb::FloatGrid& source = *grid.data().grid;
    if (source.background() > 0)
        return fail(ErrorCode::kUnsupported,
                    "the marcher wants a grid with nothing around it, its background is above 0; choose "
                    "another cache");
    try {
        NanoGrid nano;
        nano.density_ = gridOf<float>(nanovdb::openToNanoVDB(source));
        nano.cells_ = gridOf<nanovdb::ValueMask>(nanovdb::openToNanoVDB(*cellsWithDensity(source)));
        if (!nano.density_ || !nano.cells_)
            return fail(ErrorCode::kUnsupported, "NanoVDB made no grid; choose another cache");
        return nano;
    } catch (const std::exception& error) {
        return fail(ErrorCode::kUnsupported, fmt::format("NanoVDB refuses the grid: {}", error.what()));
    }
}

}  // namespace brickyard

#include "tools/bench/source_grid.h"

#include <fmt/format.h>

#include "tools/bench/source_grid_data.h"

namespace brickyard {
namespace {

Result<Affine> affineOf(const openvdb::FloatGrid& grid) {
    const auto map = grid.transform().baseMap()->getAffineMap()->getMat4();
    // OpenVDB multiplies row vectors from the left: its rows are our columns.
    std::vector<double> columns;
    for (int row = 0; row < 4; ++row)
        for (int column = 0; column < 4; ++column) columns.push_back(map[row][column]);
    return Affine::fromColumns(columns);
}

}  // namespace

Result<SourceGrid> SourceGrid::read(const std::filesystem::path& file, const std::string& name) {
    try {
        openvdb::initialize();
        openvdb::io::File input(file.string());
        input.open(/*delayLoad=*/false);
        if (!input.hasGrid(name))
            return fail(ErrorCode::kNotFound,
                        fmt::format("{}: has no grid '{}' to compare with", file.string(), name));
        const auto grid = openvdb::gridPtrCast<openvdb::FloatGrid>(input.readGrid(name));
        if (!grid || !grid->transform().isLinear())
            return fail(ErrorCode::kUnsupported,
                        fmt::format("{}: grid '{}' is no float grid with a linear transform; choose another",
                                    file.string(), name));
        auto transform = affineOf(*grid);
        if (!transform) return tl::unexpected(transform.error());
        SourceGrid source;
        source.data_ = std::make_shared<SourceGridData>(
            SourceGridData{grid, *transform, grid->evalActiveVoxelBoundingBox()});
        return source;
    } catch (const std::exception& error) {
        return fail(ErrorCode::kIo,
                    fmt::format("{}: OpenVDB cannot read it: {}", file.string(), error.what()));
    }
}

}  // namespace brickyard

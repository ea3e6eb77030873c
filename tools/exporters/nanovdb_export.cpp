// NanoVDB's converter takes a minute and nearly two gigabytes to compile: nothing else belongs in this file.
#define NANOVDB_USE_BLOSC
#define NANOVDB_USE_ZIP
#include "tools/exporters/nanovdb_export.h"

#include <fmt/format.h>
#include <nanovdb/util/IO.h>
#include <nanovdb/util/OpenToNanoVDB.h>
#include <openvdb/openvdb.h>

#include <cerrno>
#include <fstream>

#include "core/printable_name.h"
#include "tools/exporters/vdb_grid.h"
#include "tools/output_file.h"

namespace brickyard {
namespace {

nanovdb::io::Codec toNano(NanoCodec codec) {
    switch (codec) {
        case NanoCodec::kNone: break;
        case NanoCodec::kZip: return nanovdb::io::Codec::ZIP;
        case NanoCodec::kBlosc: return nanovdb::io::Codec::BLOSC;
    }
    return nanovdb::io::Codec::NONE;
}

// What NanoVDB would do with a grid but throw an exception that names neither type nor grid.
Result<void> checkType(const std::filesystem::path& file, const ExportedGrid& grid) {
    if (grid.components == 1 || grid.type == SampleType::kFloat32) return {};
    return fail(ErrorCode::kUnsupported,
                fmt::format("{}: NanoVDB has no grids of {} x {} for channel '{}'; choose others with "
                            "--channel, or write a .vdb",
                            file.string(), grid.components, toString(grid.type), printableName(grid.name)));
}

// NanoVDB allows a class for some types only, and does not write the others.
void makeClassFit(const ExportedGrid& exported, openvdb::GridBase& grid) {
    const auto stated = grid.getGridClass();
    const bool floating = exported.components == 1 && isFloating(exported.type);
    if ((stated == openvdb::GRID_LEVEL_SET || stated == openvdb::GRID_FOG_VOLUME) && !floating)
        grid.clearGridClass();
    if (stated == openvdb::GRID_STAGGERED && exported.components != 3) grid.clearGridClass();
}

}  // namespace

Result<void> writeNanoVdb(const std::filesystem::path& file, std::span<const ExportedGrid> grids,
                          NanoCodec codec) {
    for (const ExportedGrid& grid : grids)
        if (auto checked = checkType(file, grid); !checked) return checked;
    OutputFile output(file);
    try {
        openvdb::initialize();
        errno = 0;
        std::ofstream stream(output.temporary(), std::ios::binary | std::ios::trunc);
        if (!stream) return ioError("create", file, errno);
        for (const ExportedGrid& exported : grids) {
            auto grid = makeVdbGrid(exported);
            if (!grid) return tl::unexpected(grid.error());
            makeClassFit(exported, **grid);
            const auto handle = nanovdb::openToNanoVDB(*grid);
            grid->reset();
            nanovdb::io::writeGrid(stream, handle, toNano(codec));
        }
        stream.close();
        if (!stream) return ioError("write", file, errno ? errno : EIO);
    } catch (const std::exception& thrown) {
        return tl::unexpected(exportFailure(file, "NanoVDB", thrown));
    }
    return output.commit();
}

}  // namespace brickyard

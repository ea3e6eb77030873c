#include "tools/exporters/openvdb_export.h"

#include <openvdb/openvdb.h>
#include <unistd.h>

#include <cerrno>

#include "tools/exporters/vdb_grid.h"
#include "tools/importers/vdb_metadata.h"
#include "tools/output_file.h"

namespace brickyard {

Result<void> writeVdb(const std::filesystem::path& file, std::span<const ExportedGrid> grids,
                      const std::vector<MetadataEntry>& metadata) {
    OutputFile output(file);
    try {
        openvdb::initialize();
        openvdb::GridPtrVec written;
        for (const ExportedGrid& exported : grids) {
            auto grid = makeVdbGrid(exported);
            if (!grid) return tl::unexpected(grid.error());
            written.push_back(std::move(*grid));
        }
        // libopenvdb says nothing useful of a file it cannot create.
        if (::access(file.parent_path().empty() ? "." : file.parent_path().c_str(), W_OK) != 0)
            return ioError("create", file, errno);
        openvdb::MetaMap about_file;
        restoreMetadata(metadata, about_file);
        errno = 0;
        openvdb::io::File stream(output.temporary().string());
        stream.setCompression(openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK);
        stream.write(written, about_file);
        stream.close();
    } catch (const std::exception& thrown) {
        return tl::unexpected(exportFailure(file, "OpenVDB", thrown));
    }
    return output.commit();
}

}  // namespace brickyard

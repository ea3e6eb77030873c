#include "tools/importers/input_file.h"

#include "tools/importers/openvdb_source.h"
#include "tools/importers/vdb_reader_guard.h"

namespace brickyard {

Result<InputContents> openInput(const std::filesystem::path& file, const InputOptions& options) {
    VdbLimits limits;
    limits.memory_bytes = options.memory_bytes;
    if (auto checked = checkVdb(file, options.channels, limits, options.probe_program); !checked)
        return tl::unexpected(checked.error());
    auto contents = readVdb(file, options.channels);
    if (!contents) return tl::unexpected(contents.error());
    InputContents result;
    for (auto& field : contents->fields) result.fields.push_back(std::move(field));
    result.skipped = std::move(contents->skipped);
    result.names = std::move(contents->names);
    result.metadata = std::move(contents->metadata);
    return result;
}

}  // namespace brickyard

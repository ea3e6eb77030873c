#include "tools/importers/input_file.h"

#include "tools/importers/openvdb_source.h"
#include "tools/importers/vdb_reader_guard.h"
#include "tools/importers/vdb_source.h"

namespace brickyard {
namespace {

// By libopenvdb, once a child process has shown that this ends well.
Result<InputContents> openVdbGuarded(const std::filesystem::path& file, const InputOptions& options) {
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
    return result;
}

}  // namespace

Result<InputContents> openInput(const std::filesystem::path& file, const InputOptions& options) {
    auto contents = openVdb(file, options);
    if (contents || contents.error().code != ErrorCode::kUnsupported) return contents;
    return openVdbGuarded(file, options);
}

}  // namespace brickyard

#include "tools/importers/input_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>

#include "tools/importers/byte_file.h"
#include "tools/importers/nano_source.h"
#include "tools/importers/nrrd_source.h"
#include "tools/importers/openvdb_source.h"
#include "tools/importers/raw_source.h"
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
    result.metadata = std::move(contents->metadata);
    return result;
}

}  // namespace

Result<InputFormat> detectFormat(const std::filesystem::path& path, const InputOptions& options) {
    if (!options.raw.empty()) return InputFormat::kRaw;
    const auto file = ByteFile::open(path);
    if (!file) return tl::unexpected(file.error());
    std::array<char, 8> first{};
    const std::size_t length = std::size_t(std::min<std::uint64_t>(file->size(), first.size()));
    if (auto read = file->readAt(0, std::as_writable_bytes(std::span(first)).first(length)); !read)
        return tl::unexpected(read.error());
    const std::string_view magic(first.data(), length);
    // OpenVDB's is a 64-bit number, of which the upper half is 0.
    if (magic.starts_with(" BDV")) return InputFormat::kOpenVdb;
    if (magic.starts_with("NanoVDB")) return InputFormat::kNanoVdb;
    if (magic.starts_with("NRRD000")) return InputFormat::kNrrd;
    return fail(
        ErrorCode::kUnsupported,
        fmt::format("{}: not an OpenVDB file, nor of another format that is understood (OpenVDB, NanoVDB, "
                    "NRRD); a raw dump needs its layout, --raw 128x128x128:uint16",
                    path.string()));
}

Result<InputContents> openInput(const std::filesystem::path& file, const InputOptions& options) {
    const auto format = detectFormat(file, options);
    if (!format) return tl::unexpected(format.error());
    switch (*format) {
        case InputFormat::kOpenVdb: {
            auto contents = openVdb(file, options);
            if (contents || contents.error().code != ErrorCode::kUnsupported) return contents;
            return openVdbGuarded(file, options);
        }
        case InputFormat::kRaw: return readRaw(file, options);
        case InputFormat::kNrrd: return readNrrd(file, options);
        case InputFormat::kNanoVdb: break;
    }
#ifdef BRICKYARD_WITH_NANOVDB
    return readNanoVdb(file, options);
#else
    return fail(ErrorCode::kUnsupported,
                fmt::format("{}: NanoVDB is left out of this build; configure with -DBRICKYARD_NANOVDB=ON",
                            file.string()));
#endif
}

}  // namespace brickyard

#include "tools/importers/nano_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>

#include "core/printable_name.h"
#include "tools/importers/blosc_chunk.h"
#include "tools/importers/inflate.h"

namespace brickyard {
namespace {

// Segment: u64 magic, u32 version (11 bits major, 11 minor, 10 patch), u16 grids, u16 codec; then for each
// grid 176 bytes and its name; then the grids' bytes.
constexpr std::string_view kMagic = "NanoVDB0";
constexpr std::uint32_t kMajor = 32;
constexpr std::size_t kSegmentBytes = 16, kEntryBytes = 176;
constexpr std::uint32_t kMaxName = 64u << 10;
constexpr std::uint64_t kBloscChunk = std::uint64_t(1) << 30;  // unpacked; NanoVDB's own
// What LZ4 can pack at best.
constexpr std::uint64_t kMaxBloscRatio = 256;

template <class T>
T numberAt(std::span<const std::byte> bytes, std::size_t at) {
    T value;
    std::memcpy(&value, bytes.data() + at, sizeof value);
    return value;
}

tl::unexpected<Error> corrupt(const ByteFile& file, const std::string& what) {
    return fail(ErrorCode::kCorrupt, fmt::format("{}: {}; write the file again", file.path().string(), what));
}

Result<void> checkSegment(const ByteFile& file, std::span<const std::byte> header, std::uint64_t at) {
    const std::string_view magic(reinterpret_cast<const char*>(header.data()), 8);
    if (magic != kMagic) {
        if (at == 0 && magic.starts_with("NanoVDB"))
            return fail(ErrorCode::kTooNew,
                        fmt::format("{}: a NanoVDB file of version 32.6 or newer; save it with NanoVDB 32.4, "
                                    "or as .vdb",
                                    file.path().string()));
        if (at == 0 && magic == "0BDVonaN")
            return fail(ErrorCode::kUnsupported,
                        fmt::format("{}: a NanoVDB file of a big-endian machine; write it on another one",
                                    file.path().string()));
        return corrupt(file, fmt::format("no NanoVDB segment at byte {}", at));
    }
    const std::uint32_t version = numberAt<std::uint32_t>(header, 8), major = version >> 21;
    if (major != kMajor)
        return fail(major > kMajor ? ErrorCode::kTooNew : ErrorCode::kUnsupported,
                    fmt::format("{}: NanoVDB version {}.{}, whose grids are laid out otherwise than those of "
                                "{}; save it with "
                                "NanoVDB {}, or as .vdb",
                                file.path().string(), major, version >> 10 & 0x7ff, kMajor, kMajor));
    return {};
}

}  // namespace

Result<std::vector<NanoGridEntry>> listNanoGrids(const ByteFile& file) {
    std::vector<NanoGridEntry> grids;
    std::array<std::byte, kSegmentBytes> header;
    std::array<std::byte, kEntryBytes> entry;
    for (std::uint64_t at = 0; at < file.size();) {
        const auto cut = [&](const std::string& what) {
            return corrupt(file, fmt::format("cut off or damaged in {} of the segment at byte {}", what, at));
        };
        if (file.size() - at < kSegmentBytes) return cut("the head");
        if (auto read = file.readAt(at, header); !read) return tl::unexpected(read.error());
        if (auto checked = checkSegment(file, header, at); !checked) return tl::unexpected(checked.error());
        const std::size_t count = numberAt<std::uint16_t>(header, 12);
        const auto codec = numberAt<std::uint16_t>(header, 14);
        if (count == 0) return corrupt(file, fmt::format("the segment at byte {} has no grids", at));
        if (codec > std::uint16_t(NanoCodec::kBlosc))
            return corrupt(file,
                           fmt::format("the segment at byte {} is compressed in unknown way {}", at, codec));

        std::uint64_t position = at + kSegmentBytes;
        const std::size_t first = grids.size();
        for (std::size_t i = 0; i < count; ++i) {
            if (file.size() - position < kEntryBytes) return cut(fmt::format("grid {} of {}", i + 1, count));
            if (auto read = file.readAt(position, entry); !read) return tl::unexpected(read.error());
            position += kEntryBytes;
            NanoGridEntry grid;
            grid.grid_bytes = numberAt<std::uint64_t>(entry, 0);
            grid.file_bytes = numberAt<std::uint64_t>(entry, 8);
            grid.type = numberAt<std::uint32_t>(entry, 32);
            grid.codec = NanoCodec(codec);
            const auto name_bytes = numberAt<std::uint32_t>(entry, 136);
            if (name_bytes > kMaxName || name_bytes > file.size() - position)
                return cut(fmt::format("the name of grid {} of {}", i + 1, count));
            grid.name.resize(name_bytes);
            if (auto read = file.readAt(position, std::as_writable_bytes(std::span(grid.name))); !read)
                return tl::unexpected(read.error());
            grid.name.resize(std::min(grid.name.find('\0'), grid.name.size()));
            position += name_bytes;
            grids.push_back(std::move(grid));
        }
        for (std::size_t i = first; i < grids.size(); ++i) {
            grids[i].begin = position;
            if (grids[i].file_bytes > file.size() - position)
                return corrupt(
                    file, fmt::format("grid '{}' claims bytes [{}, {}) of {}", printableName(grids[i].name),
                                      position,
                                      // Not the sum, which may wrap.
                                      fmt::format("{} + {}", position, grids[i].file_bytes), file.size()));
            position += grids[i].file_bytes;
        }
        at = position;
    }
    if (grids.empty()) return corrupt(file, "has no NanoVDB segment");
    return grids;
}

Result<void> NanoGridBytes::read(std::uint64_t offset, std::span<std::byte> out) const {
    if (offset > size || out.size() > size - offset)
        return corrupt(*file, fmt::format("a node claims bytes [{}, {} + {}) of a grid of {}", offset, offset,
                                          out.size(), size));
    return file->readAt(begin + offset, out);
}

Result<NanoGridBytes> unpackNanoGrid(const std::shared_ptr<const ByteFile>& file,
                                     const NanoGridEntry& entry) {
    const auto damaged = [&](const std::string& what) {
        return corrupt(*file, fmt::format("grid '{}' {}", printableName(entry.name), what));
    };
    if (entry.codec == NanoCodec::kNone) {
        if (entry.file_bytes != entry.grid_bytes) return damaged("is not as long as it says");
        return NanoGridBytes{file, entry.begin, entry.grid_bytes};
    }
    if (entry.grid_bytes / (entry.codec == NanoCodec::kZip ? 1032 : kMaxBloscRatio) > entry.file_bytes)
        return damaged(
            fmt::format("has {} compressed bytes, which cannot hold {}", entry.file_bytes, entry.grid_bytes));
    auto out = ByteFile::temporary(file->path(), entry.grid_bytes);
    if (!out) return tl::unexpected(out.error());
    std::uint64_t position = entry.begin, done = 0;
    const std::uint64_t end = entry.begin + entry.file_bytes;
    while (done < entry.grid_bytes) {
        std::array<std::byte, 8> prefix;
        if (end - position < prefix.size()) return damaged("ends early");
        if (auto read = file->readAt(position, prefix); !read) return tl::unexpected(read.error());
        const auto length = numberAt<std::uint64_t>(prefix, 0);
        position += prefix.size();
        if (length > end - position) return damaged("ends early");
        const bool zip = entry.codec == NanoCodec::kZip;
        const std::uint64_t bytes = zip ? entry.grid_bytes : std::min(kBloscChunk, entry.grid_bytes - done);
        const auto unpacked = zip ? inflateZlib(*file, position, length, bytes, *out, done)
                                  : unpackBlosc(*file, position, length, bytes, *out, done);
        if (!unpacked) return tl::unexpected(unpacked.error());
        position += length;
        done += bytes;
    }
    return NanoGridBytes{std::make_shared<const ByteFile>(std::move(*out)), 0, entry.grid_bytes};
}

}  // namespace brickyard

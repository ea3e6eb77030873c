#include "tools/importers/vdb_file.h"

#include <fmt/format.h>

#include <algorithm>

#include "core/printable_name.h"
#include "tools/importers/vdb_map.h"
#include "tools/importers/vdb_notes.h"

namespace brickyard {
namespace {

// libopenvdb 10 reads file versions from 212 on; those before 220 (2012) have no writer left and were never
// tested.
constexpr std::uint32_t kOldestVersion = 220;
constexpr std::uint32_t kNewestVersion = 224;
constexpr std::uint64_t kMagic = 0x56444220;

constexpr std::uint32_t kMaxNameBytes = 1u << 20;
// Heads are some hundred bytes each, megabytes apart.
constexpr std::size_t kShortRun = 4096;

tl::unexpected<Error> corrupt(const std::string& where, const std::string& what) {
    return fail(ErrorCode::kCorrupt, fmt::format("{}: {}; write the file again", where, what));
}

}  // namespace

std::string VdbGridEntry::shownName() const {
    const std::size_t mark = unique_name.find('\x1e');
    return mark == std::string::npos ? unique_name : name() + "[" + unique_name.substr(mark + 1) + "]";
}

std::string VdbGridEntry::valueType() const {
    constexpr std::string_view kBefore = "Tree_", kAfter = "_5_4_3";
    if (!type.starts_with(kBefore) || !type.ends_with(kAfter) || type.size() < kBefore.size() + kAfter.size())
        return {};
    return type.substr(kBefore.size(), type.size() - kBefore.size() - kAfter.size());
}

std::string VdbGridHead::text(const std::string& name) const {
    const auto note = std::ranges::find(metadata, name, &MetadataEntry::name);
    return note == metadata.end() || note->type != "string" ? std::string() : note->value;
}

bool VdbGridHead::flag(const std::string& name) const {
    const auto note = std::ranges::find(metadata, name, &MetadataEntry::name);
    if (note == metadata.end()) return false;
    if (note->type == "string") return !note->value.empty();
    return std::ranges::any_of(note->value, [](char c) { return c != 0; });
}

Result<VdbFile> VdbFile::open(const std::filesystem::path& path) {
    auto bytes = VdbBytes::open(path);
    if (!bytes) return tl::unexpected(bytes.error());
    VdbFile file(std::move(*bytes));
    if (auto read = file.readHeader(); !read) return tl::unexpected(read.error());
    if (!file.has_offsets_) return file;
    if (auto read = file.readTable(); !read) return tl::unexpected(read.error());
    return file;
}

// i64 magic, u32 file version, 2 x u32 library version, u8 offsets are there, (u8 compression before version
// 222), 36 bytes of UUID, metadata, i32 number of grids.
Result<void> VdbFile::readHeader() {
    const std::string& path = bytes_->path();
    VdbCursor cursor(*bytes_, 0, bytes_->size(), kShortRun);
    const auto failed = [&](const std::string& what) -> tl::unexpected<Error> {
        return cursor.error() ? tl::unexpected(*cursor.error()) : corrupt(path, what);
    };
    if (cursor.number<std::uint64_t>() != kMagic || !cursor.ok()) return failed("not an OpenVDB file");
    version_ = cursor.number<std::uint32_t>();
    if (!cursor.ok()) return failed(fmt::format("an OpenVDB file cut off after {} bytes", bytes_->size()));
    if (version_ > kNewestVersion)
        return fail(ErrorCode::kTooNew,
                    fmt::format("{}: OpenVDB file version {} is newer than {}; save it for OpenVDB "
                                "10 or older",
                                path, version_, kNewestVersion));
    if (version_ < kOldestVersion)
        return fail(ErrorCode::kUnsupported,
                    fmt::format("{}: OpenVDB file version {} is older than {}; save it with a "
                                "newer program",
                                path, version_, kOldestVersion));
    cursor.skip(8);
    has_offsets_ = cursor.number<char>() != 0;
    if (version_ < 222) cursor.skip(1);
    cursor.skip(36);
    auto notes = readVdbNotes(cursor);
    if (!notes && notes.error().code == ErrorCode::kUnsupported)
        return fail(ErrorCode::kUnsupported, fmt::format("{}: its {}", path, notes.error().message));
    const auto count = notes ? cursor.number<std::int32_t>() : -1;
    if (count < 0 || !cursor.ok()) return failed("its header is cut off or damaged");
    metadata_ = std::move(*notes);
    grid_count_ = std::size_t(count);
    grids_begin_ = cursor.position();
    return {};
}

Result<VdbGridEntry> VdbFile::readEntry(VdbCursor& cursor, std::size_t number) const {
    VdbGridEntry grid;
    grid.unique_name = cursor.string(kMaxNameBytes);
    grid.type = cursor.string(kMaxNameBytes);
    grid.parent = cursor.string(kMaxNameBytes);
    // "..._HalfFloat" is for old readers: the grid's metadata say the same, and what they say counts.
    if (constexpr std::string_view kHalf = "_HalfFloat"; grid.type.ends_with(kHalf))
        grid.type.resize(grid.type.size() - kHalf.size());
    const auto begin = cursor.number<std::int64_t>();
    cursor.skip(8);  // where the leaves' values begin, as far as a reader of the topology sees for itself
    const auto end = cursor.number<std::int64_t>();
    if (cursor.error()) return tl::unexpected(*cursor.error());
    if (!cursor.ok())
        return corrupt(bytes_->path(),
                       fmt::format("cut off or damaged at byte {}, in the head of grid {} of {}",
                                   cursor.position(), number, grid_count_));
    if (!has_offsets_) {
        grid.begin = cursor.position();
        grid.end = bytes_->size();
        return grid;
    }
    if (begin < std::int64_t(cursor.position()) || end < begin || end > std::int64_t(bytes_->size()))
        return corrupt(bytes_->path(), fmt::format("grid '{}' claims bytes [{}, {}) of {}",
                                                   printableName(grid.name()), begin, end, bytes_->size()));
    grid.begin = std::uint64_t(begin);
    grid.end = std::uint64_t(end);
    return grid;
}

Result<VdbGridEntry> VdbFile::readEntry(std::uint64_t at, std::size_t number) const {
    VdbCursor cursor(*bytes_, at, bytes_->size(), kShortRun);
    return readEntry(cursor, number);
}

Result<void> VdbFile::readTable() {
    VdbCursor cursor(*bytes_, grids_begin_, bytes_->size(), kShortRun);
    for (std::size_t i = 1; i <= grid_count_; ++i) {
        auto grid = readEntry(cursor, i);
        if (!grid) return tl::unexpected(grid.error());
        cursor.skip(grid->end - cursor.position());
        grids_.push_back(std::move(*grid));
    }
    return {};
}

Result<VdbGridHead> VdbFile::readHead(const VdbGridEntry& grid, const std::string& where) const {
    VdbCursor cursor(*bytes_, grid.begin, grid.end, kShortRun);
    const auto failed = [&](const Error& error) -> tl::unexpected<Error> {
        if (cursor.error()) return tl::unexpected(*cursor.error());
        return fail(error.code, fmt::format("{}: {}: {}, at byte {}; write the file again", bytes_->path(),
                                            where, error.message, cursor.position()));
    };
    VdbGridHead head;
    head.compression = cursor.number<std::uint32_t>();
    auto notes = readVdbNotes(cursor);
    if (!notes) return failed(notes.error());
    head.metadata = std::move(*notes);
    head.metadata_bytes = vdbNoteBytes(head.metadata);
    auto map = readVdbMap(cursor);
    if (!map) return failed(map.error());
    head.linear = map->has_value();
    if (head.linear) head.index_to_world = **map;
    head.tree_begin = cursor.position();
    return head;
}

}  // namespace brickyard

#include "tools/importers/nano_source.h"

#include <fmt/format.h>
#include <nanovdb/NanoVDB.h>

#include <algorithm>
#include <set>

#include "core/printable_name.h"
#include "tools/importers/nano_field.h"
#include "tools/importers/nano_file.h"

namespace brickyard {
namespace {

const char* classWord(nanovdb::GridClass grid_class) {
    switch (grid_class) {
        case nanovdb::GridClass::LevelSet: return "level set";
        case nanovdb::GridClass::FogVolume: return "fog volume";
        case nanovdb::GridClass::Staggered: return "staggered";
        default: return "unknown";
    }
}

Result<Affine> readTransform(const nanovdb::Map& map) {
    std::array<double, 16> columns{};
    for (std::size_t row = 0; row < 3; ++row) {
        for (std::size_t axis = 0; axis < 3; ++axis) columns[4 * axis + row] = map.mMatD[3 * row + axis];
        columns[12 + row] = map.mVecD[row];
    }
    columns[15] = 1;
    return Affine::fromColumns(columns);
}

Result<std::unique_ptr<FieldSource>> makeField(std::uint32_t type, NanoGridBytes bytes, ChannelInfo info,
                                               std::uint64_t memory) {
    switch (nanovdb::GridType(type)) {
        case nanovdb::GridType::Float:
            return NanoField<float>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::Double:
            return NanoField<double>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::Int16:
            return NanoField<std::int16_t>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::Int32:
            return NanoField<std::int32_t>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::Int64:
            return NanoField<std::int64_t>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::UInt32:
            return NanoField<std::uint32_t>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::Vec3f:
            return NanoField<nanovdb::Vec3f>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::Vec3d:
            return NanoField<nanovdb::Vec3d>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::Boolean:
            return NanoField<bool>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::Mask:
            return NanoField<nanovdb::ValueMask>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::Fp4:
            return NanoField<nanovdb::Fp4>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::Fp8:
            return NanoField<nanovdb::Fp8>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::Fp16:
            return NanoField<nanovdb::Fp16>::create(std::move(bytes), std::move(info), memory);
        case nanovdb::GridType::FpN:
            return NanoField<nanovdb::FpN>::create(std::move(bytes), std::move(info), memory);
        default: return nullptr;
    }
}

bool isChannel(std::uint32_t type) {
    switch (nanovdb::GridType(type)) {
        case nanovdb::GridType::Unknown:
        case nanovdb::GridType::Half:  // no NanoVDB of this version writes it
        case nanovdb::GridType::RGBA8:
        case nanovdb::GridType::Vec4f:
        case nanovdb::GridType::Vec4d:
        case nanovdb::GridType::Index: return false;
        default: return type < std::uint32_t(nanovdb::GridType::End);
    }
}

// One grid into `contents`. Errors without the file's and the grid's name, but for those of reading.
Result<void> readGrid(const std::shared_ptr<const ByteFile>& file, const NanoGridEntry& entry,
                      const std::string& name, const InputOptions& options, InputContents& contents) {
    if (!isChannel(entry.type)) {
        const bool known = entry.type < std::uint32_t(nanovdb::GridType::End);
        contents.skipped.push_back(
            {name, fmt::format(
                       "has values of NanoVDB type {}, which cannot be converted",
                       known ? nanovdb::toStr(nanovdb::GridType(entry.type)) : std::to_string(entry.type))});
        return {};
    }
    auto bytes = unpackNanoGrid(file, entry);
    if (!bytes) return tl::unexpected(bytes.error());
    NodeBuffer buffer;
    const auto head = buffer.of(sizeof(nanovdb::GridData));
    if (auto read = bytes->read(0, head); !read) return read;
    const auto& data = *reinterpret_cast<const nanovdb::GridData*>(head.data());
    if (data.mMagic != NANOVDB_MAGIC_NUMBER || data.mGridSize > bytes->size ||
        std::uint32_t(data.mGridType) != entry.type)
        return fail(ErrorCode::kCorrupt,
                    "does not begin as a NanoVDB grid of its type and size; write the file again");
    if (data.mVersion.getMajor() != NANOVDB_MAJOR_VERSION_NUMBER)
        return fail(ErrorCode::kUnsupported,
                    fmt::format("is of NanoVDB version {}; save it with version {}", data.mVersion.getMajor(),
                                NANOVDB_MAJOR_VERSION_NUMBER));
    if (data.mGridClass == nanovdb::GridClass::PointIndex ||
        data.mGridClass == nanovdb::GridClass::PointData ||
        data.mGridClass == nanovdb::GridClass::IndexGrid) {
        contents.skipped.push_back({name, "holds points or indices, not values; only fields convert"});
        return {};
    }
    auto transform = readTransform(data.mMap);
    if (!transform)
        return fail(ErrorCode::kInvalid,
                    fmt::format("has an unusable transform ({}); give it an invertible, finite one",
                                transform.error().message));
    ChannelInfo info;
    info.name = name;
    info.index_to_world = *transform;
    info.grid_class = classWord(data.mGridClass);
    auto field = makeField(entry.type, std::move(*bytes), std::move(info), options.memory_bytes);
    if (!field) return tl::unexpected(field.error());
    contents.fields.push_back(std::move(*field));
    return {};
}

}  // namespace

Result<InputContents> readNanoVdb(const std::filesystem::path& path, const InputOptions& options) {
    auto opened = ByteFile::open(path);
    if (!opened) return tl::unexpected(opened.error());
    const auto file = std::make_shared<const ByteFile>(std::move(*opened));
    const auto grids = listNanoGrids(*file);
    if (!grids) return tl::unexpected(grids.error());
    InputContents contents;
    std::set<std::string> used;
    for (const NanoGridEntry& entry : *grids) {
        const std::string base = entry.name.empty() ? "unnamed" : validUtf8(entry.name);
        std::string name = base;
        for (int n = 1; !used.insert(name).second; ++n) name = fmt::format("{}[{}]", base, n);
        contents.names.push_back(name);
        if (!options.channels.empty() && std::ranges::find(options.channels, name) == options.channels.end())
            continue;
        if (auto read = readGrid(file, entry, name, options, contents); !read) {
            // Reading names the file, checking does not.
            if (read.error().message.starts_with(path.string())) return tl::unexpected(read.error());
            return fail(read.error().code, fmt::format("{}: grid '{}' {}", path.string(), printableName(name),
                                                       read.error().message));
        }
    }
    std::ranges::sort(contents.fields, {}, [](const auto& field) { return field->info().name; });
    return contents;
}

}  // namespace brickyard

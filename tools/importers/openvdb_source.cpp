#include "tools/importers/openvdb_source.h"

#include <fmt/format.h>

#include <mutex>
#include <set>

#include "core/printable_name.h"
#include "tools/importers/tree_field.h"
#include "tools/importers/vdb_metadata.h"

namespace brickyard {
namespace {

void initializeOnce() {
    static std::once_flag once;
    std::call_once(once, [] { openvdb::initialize(); });
}

// Where the "[2]" begins that a file adds to a name it has already, or npos. A grid's own name may end so,
// too.
std::size_t findCopyNumber(const std::string& name) {
    const std::size_t open = name.empty() || name.back() != ']' ? std::string::npos : name.rfind('[');
    const bool number = open != std::string::npos && open + 2 < name.size() &&
                        name.find_first_not_of("0123456789", open + 1) == name.size() - 1;
    return number ? open : std::string::npos;
}

// A channel's name for a grid of an open file: what OpenVDB calls it, but the first of several grids of one
// name has the plain name. `grid_name` is as File::NameIterator gives it.
std::string channelName(openvdb::io::File& file, const std::string& grid_name, std::set<std::string>& used) {
    std::string name = grid_name, copy;
    if (const std::size_t number = findCopyNumber(grid_name); number != std::string::npos) {
        const openvdb::GridBase::Ptr grid = file.readGridMetadata(grid_name);
        if (grid && grid->getName() != grid_name) {
            name = grid_name.substr(0, number);
            if (grid_name.substr(number) != "[0]") copy = grid_name.substr(number);
        }
    }
    const std::string base = (name.empty() ? "unnamed" : validUtf8(name)) + copy;
    name = base;
    for (int n = 1; !used.insert(name).second; ++n) name = fmt::format("{}[{}]", base, n);
    return name;
}

// OpenVDB multiplies rows: world = index * M. The linear part comes from the Jacobian, so that an offset of
// 1e12 costs it no digits, and maps that AffineMap's own check calls singular (voxels of 1e-9) are judged by
// our check.
Result<Affine> readTransform(const openvdb::math::Transform& transform) {
    const auto map = transform.baseMap();
    std::array<double, 16> columns{};
    for (int axis = 0; axis < 3; ++axis) {
        openvdb::Vec3d unit(0.0);
        unit[axis] = 1;
        const openvdb::Vec3d column = map->applyJacobian(unit);
        for (int row = 0; row < 3; ++row) columns[std::size_t(4 * axis + row)] = column[row];
    }
    const openvdb::Vec3d origin = map->applyMap(openvdb::Vec3d(0.0));
    for (int row = 0; row < 3; ++row) columns[std::size_t(12 + row)] = origin[row];
    columns[15] = 1;
    return Affine::fromColumns(columns);
}

// The first of the grid types that the grid is; nullptr for none.
template <class... Grids>
Result<std::unique_ptr<VdbField>> makeField(const openvdb::GridBase::Ptr& grid, const ChannelInfo& info) {
    Result<std::unique_ptr<VdbField>> field = nullptr;
    const auto attempt = [&]<class GridT>(GridT*) {
        if (!grid->isType<GridT>()) return false;
        field = TreeField<GridT>::create(openvdb::gridConstPtrCast<GridT>(grid), info);
        return true;
    };
    (attempt(static_cast<Grids*>(nullptr)) || ...);
    return field;
}

template <class... Grids>
bool isOneOf(const openvdb::GridBase& grid) {
    return (grid.isType<Grids>() || ...);
}

#define BRICKYARD_VDB_GRIDS                                                                             \
    openvdb::FloatGrid, openvdb::DoubleGrid, openvdb::Int32Grid, openvdb::Int64Grid, openvdb::BoolGrid, \
        openvdb::MaskGrid, openvdb::Vec3SGrid, openvdb::Vec3DGrid, openvdb::Vec3IGrid

// One grid of an open file, into `contents`.
Result<void> readGrid(openvdb::io::File& file, const std::string& grid_name, const std::string& name,
                      VdbContents& contents) {
    // Metadata alone tells the type, so that a large grid we cannot use is not read.
    const openvdb::GridBase::Ptr metadata = file.readGridMetadata(grid_name);
    if (!metadata) return fail(ErrorCode::kCorrupt, "has no metadata; write the file again");
    if (!isOneOf<BRICKYARD_VDB_GRIDS>(*metadata)) {
        contents.skipped.push_back({name, fmt::format("has values of type {}, which cannot be converted",
                                                      printableName(metadata->valueType()))});
        return {};
    }
    const openvdb::GridBase::Ptr grid = file.readGrid(grid_name);
    if (!grid) return fail(ErrorCode::kCorrupt, "cannot be read; write the file again");
    if (!grid->transform().isLinear()) {
        contents.skipped.push_back(
            {name,
             "has a frustum transform, which cannot be converted; resample it onto a linear transform"});
        return {};
    }
    auto transform = readTransform(grid->transform());
    if (!transform)
        return fail(ErrorCode::kInvalid,
                    fmt::format("has an unusable transform ({}); give it an invertible, finite one",
                                transform.error().message));
    ChannelInfo info;
    info.name = name;
    info.index_to_world = *transform;
    info.grid_class = openvdb::GridBase::gridClassToString(grid->getGridClass());
    info.saved_as_half = grid->saveFloatAsHalf();
    if (grid->valueType().starts_with("vec3"))
        info.vector_type = openvdb::GridBase::vecTypeToString(grid->getVectorType());
    if (grid->isType<openvdb::MaskGrid>()) info.source_type = "mask";
    info.metadata = gridMetadata(*grid, info);
    auto field = makeField<BRICKYARD_VDB_GRIDS>(grid, info);
    if (!field) return tl::unexpected(field.error());
    contents.fields.push_back(std::move(*field));
    return {};
}

std::string oneLine(std::string text) {
    std::replace_if(
        text.begin(), text.end(), [](char c) { return static_cast<unsigned char>(c) < 0x20; }, ' ');
    return validUtf8(text);
}

}  // namespace

Result<VdbContents> readVdb(const std::filesystem::path& path, const std::vector<std::string>& channels) {
    VdbContents contents;
    std::string where = path.string();
    try {
        initializeOnce();
        openvdb::io::File file(path.string());
        // A delayed read would first copy the file into TMPDIR, and would meet its damage later.
        file.setCopyMaxBytes(0);
        file.open(/*delayLoad=*/false);
        contents.metadata = fileMetadata(*file.getMetadata());
        std::set<std::string> used;
        for (auto it = file.beginName(); it != file.endName(); ++it) {
            const std::string name = channelName(file, *it, used);
            contents.names.push_back(name);
            if (!channels.empty() && std::find(channels.begin(), channels.end(), name) == channels.end())
                continue;
            where = fmt::format("{}: grid '{}'", path.string(), printableName(name));
            if (auto read = readGrid(file, *it, name, contents); !read)
                return fail(read.error().code, fmt::format("{} {}", where, read.error().message));
        }
    } catch (const std::bad_alloc&) {
        return fail(ErrorCode::kIo,
                    fmt::format("{}: does not fit in memory; allow more with --memory", where));
    } catch (const std::exception& error) {
        return fail(ErrorCode::kCorrupt, fmt::format("{}: not readable as OpenVDB: {}; write the file again",
                                                     where, oneLine(error.what())));
    }
    return contents;
}

}  // namespace brickyard

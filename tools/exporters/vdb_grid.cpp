#include "tools/exporters/vdb_grid.h"

#include <fmt/format.h>
#include <openvdb/openvdb.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <new>

#include "core/io_error.h"
#include "core/printable_name.h"
#include "tools/importers/vdb_metadata.h"

namespace brickyard {
namespace {

constexpr std::int64_t kInt32End = std::int64_t(1) << 31;

// How three components become one value of a grid.
template <class T>
struct Joined {
    using Component = T;
    static T from(const T* values, std::size_t, std::size_t at) { return values[at]; }
};
template <class T>
struct Joined<openvdb::math::Vec3<T>> {
    using Component = T;
    static openvdb::math::Vec3<T> from(const T* values, std::size_t count, std::size_t at) {
        return {values[at], values[count + at], values[2 * count + at]};
    }
};

template <class GridT>
class TreeSink final : public VoxelSink {
    using Tree = typename GridT::TreeType;
    using Leaf = typename Tree::LeafNodeType;
    using Value = typename Tree::ValueType;
    using Component = typename Joined<Value>::Component;

public:
    explicit TreeSink(GridT& grid) : tree_(grid.tree()), background_(grid.background()) {}

    static Value value(std::span<const ValueBits> bits) {
        std::array<Component, 3> components{};
        for (std::size_t c = 0; c < bits.size() && c < 3; ++c)
            std::memcpy(&components[c], &bits[c], sizeof(Component));
        return Joined<Value>::from(components.data(), 1, 0);
    }

    void fill(const IndexBox& whole, std::span<const ValueBits> bits, bool active) override {
        const IndexBox box = intersect(whole, kInt32Box);
        const Value filled = value(bits);
        if (box.empty() || (!active && std::memcmp(&filled, &background_, sizeof filled) == 0)) return;
        tree_.sparseFill({coordOf(box.begin[0], box.begin[1], box.begin[2]),
                          coordOf(box.end[0] - 1, box.end[1] - 1, box.end[2] - 1)},
                         filled, active);
    }

    void copy(const IndexBox& box, const IndexBox& part, std::span<const std::byte> bytes,
              std::span<const std::uint8_t> active) override {
        constexpr std::int64_t kEdge = Leaf::DIM;
        const IndexBox wanted = intersect(part, kInt32Box);
        const auto* values = reinterpret_cast<const Component*>(bytes.data());
        const auto down = [](std::int64_t at) { return at / kEdge * kEdge - (at % kEdge < 0 ? kEdge : 0); };
        for (std::int64_t z = down(wanted.begin[2]); z < wanted.end[2]; z += kEdge)
            for (std::int64_t y = down(wanted.begin[1]); y < wanted.end[1]; y += kEdge)
                for (std::int64_t x = down(wanted.begin[0]); x < wanted.end[0]; x += kEdge)
                    copyLeaf({{x, y, z}, {x + kEdge, y + kEdge, z + kEdge}}, box, wanted, values, active);
    }

private:
    static constexpr IndexBox kInt32Box{{-kInt32End, -kInt32End, -kInt32End},
                                        {kInt32End, kInt32End, kInt32End}};

    static openvdb::Coord coordOf(std::int64_t x, std::int64_t y, std::int64_t z) {
        return {std::int32_t(x), std::int32_t(y), std::int32_t(z)};
    }

    void copyLeaf(const IndexBox& cell, const IndexBox& box, const IndexBox& wanted, const Component* values,
                  std::span<const std::uint8_t> active) {
        const std::size_t nx = std::size_t(box.extent(0)), ny = std::size_t(box.extent(1));
        const IndexBox inside = intersect(cell, wanted);
        const openvdb::Coord origin = coordOf(cell.begin[0], cell.begin[1], cell.begin[2]);
        // A leaf that others put voxels in, too, is found again; a whole one cannot be there yet.
        Leaf* leaf = inside == cell ? nullptr : tree_.probeLeaf(origin);
        auto fresh = leaf ? nullptr : std::make_unique<Leaf>(origin, background_);
        if (!leaf) leaf = fresh.get();
        bool any = false;
        for (std::int64_t z = inside.begin[2]; z < inside.end[2]; ++z)
            for (std::int64_t y = inside.begin[1]; y < inside.end[1]; ++y)
                for (std::int64_t x = inside.begin[0]; x < inside.end[0]; ++x) {
                    const std::size_t at =
                        std::size_t(x - box.begin[0]) +
                        nx * (std::size_t(y - box.begin[1]) + ny * std::size_t(z - box.begin[2]));
                    const Value v = Joined<Value>::from(values, active.size(), at);
                    const openvdb::Index n = Leaf::coordToOffset(coordOf(x, y, z));
                    leaf->setValueOnly(n, v);
                    leaf->setActiveState(n, active[at] != 0);
                    any = any || active[at] != 0 || std::memcmp(&v, &background_, sizeof v) != 0;
                }
        if (fresh && any) tree_.addLeaf(fresh.release());
    }

    Tree& tree_;
    Value background_;
};

// Scales and offsets are composed one by one: from a whole matrix OpenVDB takes the scale as a difference of
// two positions, which an offset of 1e7 robs of its digits. Throws where the voxels are too small for OpenVDB
// (1e-9).
openvdb::math::Transform::Ptr makeTransform(const Affine& affine) {
    const glm::dmat4& m = affine.matrix();
    openvdb::Mat4d rows;
    bool diagonal = true;
    for (int column = 0; column < 4; ++column)
        for (int row = 0; row < 4; ++row) {
            rows(column, row) = m[column][row];
            diagonal = diagonal && (column == 3 || row == column || m[column][row] == 0);
        }
    if (!diagonal) return openvdb::math::Transform::createLinearTransform(rows);
    auto transform = openvdb::math::Transform::createLinearTransform(1.0);
    transform->postScale(openvdb::Vec3d(m[0][0], m[1][1], m[2][2]));
    if (const openvdb::Vec3d offset(m[3][0], m[3][1], m[3][2]); !offset.isZero())
        transform->postTranslate(offset);
    return transform;
}

template <class GridT>
Result<openvdb::GridBase::Ptr> makeGrid(const ExportedGrid& exported) {
    auto grid = GridT::create(TreeSink<GridT>::value(exported.background));
    TreeSink<GridT> sink(*grid);
    if (auto filled = exported.fill(sink); !filled) return tl::unexpected(filled.error());
    grid->setName(exported.name);
    grid->setTransform(makeTransform(exported.index_to_world));
    // A source that says nothing of these gets nothing said.
    if (const auto known = openvdb::GridBase::stringToGridClass(exported.grid_class);
        known != openvdb::GRID_UNKNOWN)
        grid->setGridClass(known);
    if (exported.components == 3)
        if (const auto known = openvdb::GridBase::stringToVecType(exported.vector_type);
            known != openvdb::VEC_INVARIANT)
            grid->setVectorType(known);
    if (exported.saved_as_half) grid->setSaveFloatAsHalf(true);
    restoreMetadata(exported.metadata, *grid);
    return openvdb::GridBase::Ptr(grid);
}

}  // namespace

Result<openvdb::GridBase::Ptr> makeVdbGrid(const ExportedGrid& grid) {
    const bool vector = grid.components == 3;
    switch (grid.type) {
        case SampleType::kFloat32:
            return vector ? makeGrid<openvdb::Vec3SGrid>(grid) : makeGrid<openvdb::FloatGrid>(grid);
        case SampleType::kFloat64:
            return vector ? makeGrid<openvdb::Vec3DGrid>(grid) : makeGrid<openvdb::DoubleGrid>(grid);
        case SampleType::kInt32:
            return vector ? makeGrid<openvdb::Vec3IGrid>(grid) : makeGrid<openvdb::Int32Grid>(grid);
        case SampleType::kInt64:
            if (!vector) return makeGrid<openvdb::Int64Grid>(grid);
            break;
        case SampleType::kBool:
            if (!vector && grid.mask) return makeGrid<openvdb::MaskGrid>(grid);
            if (!vector) return makeGrid<openvdb::BoolGrid>(grid);
            break;
    }
    return fail(ErrorCode::kUnsupported,
                fmt::format("channel '{}': OpenVDB has no grid of {} x {}; export it as .raw",
                            printableName(grid.name), grid.components, toString(grid.type)));
}

Error exportFailure(const std::filesystem::path& file, const char* program, const std::exception& thrown) {
    if (dynamic_cast<const std::bad_alloc*>(&thrown))
        return {
            ErrorCode::kIo,
            fmt::format("{}: does not fit in memory; export fewer channels at once, a --box, or a coarser "
                        "--level",
                        file.string())};
    if (errno == ENOSPC || errno == EDQUOT) return ioError("write", file, errno).value();
    std::string why = thrown.what();
    std::replace(why.begin(), why.end(), '\n', ' ');
    return {ErrorCode::kIo, fmt::format("{}: {} cannot write it: {}", file.string(), program, why)};
}

}  // namespace brickyard

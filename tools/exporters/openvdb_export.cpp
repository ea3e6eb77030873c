#include "tools/exporters/openvdb_export.h"

#include <fmt/format.h>
#include <openvdb/openvdb.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <limits>

#include "core/io_error.h"
#include "core/printable_name.h"

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
class TreeSink final : public GridSink {
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
        const IndexBox box =
            intersect(whole, {{-kInt32End, -kInt32End, -kInt32End}, {kInt32End, kInt32End, kInt32End}});
        const Value filled = value(bits);
        if (box.empty() || (!active && std::memcmp(&filled, &background_, sizeof filled) == 0)) return;
        tree_.sparseFill({openvdb::Coord(std::int32_t(box.begin[0]), std::int32_t(box.begin[1]),
                                         std::int32_t(box.begin[2])),
                          openvdb::Coord(std::int32_t(box.end[0] - 1), std::int32_t(box.end[1] - 1),
                                         std::int32_t(box.end[2] - 1))},
                         filled, active);
    }

    void copy(const IndexBox& box, std::span<const std::byte> bytes,
              std::span<const std::uint8_t> active) override {
        constexpr std::int64_t kEdge = Leaf::DIM;
        const auto* values = reinterpret_cast<const Component*>(bytes.data());
        const std::size_t nx = std::size_t(box.extent(0)), ny = std::size_t(box.extent(1));
        for (std::int64_t z = box.begin[2]; z < box.end[2]; z += kEdge)
            for (std::int64_t y = box.begin[1]; y < box.end[1]; y += kEdge)
                for (std::int64_t x = box.begin[0]; x < box.end[0]; x += kEdge) {
                    if (x < -kInt32End || y < -kInt32End || z < -kInt32End || x >= kInt32End ||
                        y >= kInt32End || z >= kInt32End)
                        continue;
                    auto leaf = std::make_unique<Leaf>(
                        openvdb::Coord(std::int32_t(x), std::int32_t(y), std::int32_t(z)), background_);
                    bool any = false;
                    for (openvdb::Index n = 0; n < Leaf::SIZE; ++n) {
                        const openvdb::Coord local = Leaf::offsetToLocalCoord(n);
                        const std::size_t at = std::size_t(x - box.begin[0] + local.x()) +
                                               nx * (std::size_t(y - box.begin[1] + local.y()) +
                                                     ny * std::size_t(z - box.begin[2] + local.z()));
                        const Value v = Joined<Value>::from(values, active.size(), at);
                        leaf->setValueOnly(n, v);
                        leaf->setActiveState(n, active[at] != 0);
                        any = any || active[at] != 0 || std::memcmp(&v, &background_, sizeof v) != 0;
                    }
                    if (any) tree_.addLeaf(leaf.release());
                }
    }

private:
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
    transform->postTranslate(openvdb::Vec3d(m[3][0], m[3][1], m[3][2]));
    return transform;
}

template <class GridT>
Result<openvdb::GridBase::Ptr> makeGrid(const ExportedGrid& exported, const GridFiller& filler) {
    auto grid = GridT::create(TreeSink<GridT>::value(exported.background));
    TreeSink<GridT> sink(*grid);
    if (auto filled = filler(sink); !filled) return tl::unexpected(filled.error());
    grid->setName(exported.name);
    grid->setTransform(makeTransform(exported.index_to_world));
    grid->setGridClass(openvdb::GridBase::stringToGridClass(exported.grid_class));
    if (exported.components == 3 && !exported.vector_type.empty())
        grid->setVectorType(openvdb::GridBase::stringToVecType(exported.vector_type));
    grid->setSaveFloatAsHalf(exported.saved_as_half);
    return openvdb::GridBase::Ptr(grid);
}

Result<openvdb::GridBase::Ptr> makeAnyGrid(const ExportedGrid& grid, const GridFiller& filler) {
    const bool vector = grid.components == 3;
    switch (grid.type) {
        case SampleType::kFloat32:
            return vector ? makeGrid<openvdb::Vec3SGrid>(grid, filler)
                          : makeGrid<openvdb::FloatGrid>(grid, filler);
        case SampleType::kFloat64:
            return vector ? makeGrid<openvdb::Vec3DGrid>(grid, filler)
                          : makeGrid<openvdb::DoubleGrid>(grid, filler);
        case SampleType::kInt32:
            return vector ? makeGrid<openvdb::Vec3IGrid>(grid, filler)
                          : makeGrid<openvdb::Int32Grid>(grid, filler);
        case SampleType::kInt64:
            if (!vector) return makeGrid<openvdb::Int64Grid>(grid, filler);
            break;
        case SampleType::kBool:
            if (!vector) return makeGrid<openvdb::BoolGrid>(grid, filler);
            break;
    }
    return fail(ErrorCode::kUnsupported,
                fmt::format("channel '{}': OpenVDB has no grid of {} x {}; export it as .raw",
                            printableName(grid.name), grid.components, toString(grid.type)));
}

}  // namespace

Result<void> writeVdb(const std::filesystem::path& file, std::span<const ExportedGrid> grids,
                      std::span<const GridFiller> fillers) {
    const std::filesystem::path temporary = fmt::format("{}.tmp-{}", file.string(), ::getpid());
    const auto failed = [&](tl::unexpected<Error> error) {
        ::unlink(temporary.c_str());
        return error;
    };
    try {
        openvdb::initialize();
        openvdb::GridPtrVec written;
        for (std::size_t i = 0; i < grids.size(); ++i) {
            auto grid = makeAnyGrid(grids[i], fillers[i]);
            if (!grid) return tl::unexpected(grid.error());
            written.push_back(*grid);
        }
        // libopenvdb says nothing useful of a file it cannot create.
        const int probe = ::access(file.parent_path().empty() ? "." : file.parent_path().c_str(), W_OK);
        if (probe != 0) return ioError("create", file, errno);
        errno = 0;
        openvdb::io::File output(temporary.string());
        output.setCompression(openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK);
        output.write(written);
        output.close();
    } catch (const std::bad_alloc&) {
        return failed(fail(ErrorCode::kIo,
                           fmt::format("{}: does not fit in memory; export fewer channels at once, or a "
                                       "coarser --level",
                                       file.string())));
    } catch (const std::exception& error) {
        if (errno == ENOSPC || errno == EDQUOT) return failed(ioError("write", file, errno));
        std::string why = error.what();
        std::replace(why.begin(), why.end(), '\n', ' ');
        return failed(
            fail(ErrorCode::kIo, fmt::format("{}: OpenVDB cannot write it: {}", file.string(), why)));
    }
    if (::rename(temporary.c_str(), file.c_str()) != 0) {
        const int why = errno;
        return failed(ioError("rename", temporary, why));
    }
    return {};
}

}  // namespace brickyard

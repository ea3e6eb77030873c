#include "tools/importers/vdb_map.h"

#include <fmt/format.h>

#include "core/printable_name.h"

namespace brickyard {
namespace {

template <std::size_t kCount>
std::array<double, kCount> numbers(VdbCursor& cursor) {
    std::array<double, kCount> values{};
    for (double& value : values) value = cursor.number<double>();
    return values;
}

}  // namespace

Result<std::optional<std::array<double, 16>>> readVdbMap(VdbCursor& cursor) {
    constexpr std::uint32_t kMaxNameBytes = 256;
    const std::string type = cursor.string(kMaxNameBytes);
    if (!cursor.ok()) return fail(ErrorCode::kCorrupt, "its transform is cut off or damaged");
    std::array<double, 16> columns{};
    columns[0] = columns[5] = columns[10] = columns[15] = 1;
    if (type == "NonlinearFrustumMap") return std::nullopt;
    if (type == "AffineMap" || type == "UnitaryMap") {
        // OpenVDB multiplies rows, world = index * M, row by row: that is our columns. The last of a row says
        // nothing; the sums keep the sign of a zero as OpenVDB's do.
        const auto m = numbers<16>(cursor);
        for (std::size_t axis = 0; axis < 4; ++axis)
            for (std::size_t row = 0; row < 3; ++row) {
                double sum = 0;
                for (std::size_t k = 0; k < 3; ++k) sum += (k == axis ? 1.0 : 0.0) * m[4 * k + row];
                columns[4 * axis + row] = axis < 3 ? sum : sum + m[12 + row];
            }
    } else if (type == "ScaleMap" || type == "UniformScaleMap") {
        const auto scale = numbers<3>(cursor);
        numbers<12>(cursor);  // what follows from the scale: voxel size, inverses
        for (std::size_t axis = 0; axis < 3; ++axis) columns[5 * axis] = scale[axis];
    } else if (type == "TranslationMap") {
        const auto offset = numbers<3>(cursor);
        for (std::size_t row = 0; row < 3; ++row) columns[12 + row] = offset[row];
    } else if (type == "ScaleTranslateMap" || type == "UniformScaleTranslateMap") {
        const auto offset = numbers<3>(cursor), scale = numbers<3>(cursor);
        numbers<12>(cursor);
        for (std::size_t axis = 0; axis < 3; ++axis) {
            columns[5 * axis] = scale[axis];
            columns[12 + axis] = offset[axis];
        }
    } else {
        return fail(ErrorCode::kCorrupt,
                    fmt::format("its transform has the unknown type '{}'", printableName(type)));
    }
    if (!cursor.ok()) return fail(ErrorCode::kCorrupt, "its transform is cut off");
    return columns;
}

}  // namespace brickyard

#include "core/affine.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

namespace brickyard {

namespace {

bool allFinite(const glm::dmat3& m) {
    for (int c = 0; c < 3; ++c)
        for (int r = 0; r < 3; ++r)
            if (!std::isfinite(m[c][r])) return false;
    return true;
}

}  // namespace

Result<Affine> Affine::fromColumns(std::span<const double> columns) {
    if (columns.size() != 16)
        return fail(ErrorCode::kInvalid, fmt::format("transform has {} numbers, not 16", columns.size()));
    Affine affine;
    for (int c = 0; c < 4; ++c)
        for (int r = 0; r < 4; ++r) {
            const double value = columns[std::size_t(4 * c + r)];
            if (!std::isfinite(value)) return fail(ErrorCode::kInvalid, "transform is not finite");
            if (r == 3 && value != (c == 3 ? 1.0 : 0.0))
                return fail(ErrorCode::kInvalid, "transform is not affine: its last row is not 0 0 0 1");
            affine.forward_[c][r] = value;
        }
    affine.linear_ = glm::dmat3(affine.forward_);
    affine.offset_ = glm::dvec3(affine.forward_[3]);

    // Columns are scaled to unit length first: voxels of 1e-110 have a determinant that underflows, and are
    // invertible.
    glm::dmat3 unit;
    glm::dvec3 length;
    for (int c = 0; c < 3; ++c) {
        const glm::dvec3 column = affine.linear_[c];
        const double largest = std::max({std::abs(column.x), std::abs(column.y), std::abs(column.z)});
        length[c] = largest > 0 ? largest * glm::length(column / largest) : 0;
        unit[c] = column / length[c];
    }
    const glm::dmat3 unit_inverse = glm::inverse(unit);
    for (int c = 0; c < 3; ++c)
        for (int r = 0; r < 3; ++r) affine.inverse_linear_[c][r] = unit_inverse[c][r] / length[r];
    if (!allFinite(unit_inverse) || !allFinite(affine.inverse_linear_))
        return fail(ErrorCode::kInvalid, "transform cannot be inverted in double precision");
    return affine;
}

double Affine::voxelSize() const {
    return std::max({glm::length(linear_[0]), glm::length(linear_[1]), glm::length(linear_[2])});
}

}  // namespace brickyard

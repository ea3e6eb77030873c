// Index-to-world maps: double-precision affine 4x4, column vectors (world = M * index). Plain value, any
// thread.
#pragma once

#include <glm/mat3x3.hpp>
#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <span>

#include "core/result.h"

namespace brickyard {

class Affine {
public:
    Affine() = default;  // identity

    // 16 numbers, column-major as in the file. Errors: kInvalid unless all are finite, the last row is 0 0 0
    // 1 and the linear part is invertible in double precision.
    static Result<Affine> fromColumns(std::span<const double> columns);
    const glm::dmat4& matrix() const { return forward_; }

    glm::dvec3 point(const glm::dvec3& index) const { return linear_ * index + offset_; }
    glm::dvec3 vector(const glm::dvec3& index) const { return linear_ * index; }
    // World to index. The offset is subtracted before the inverse is applied: no cancellation at 1e12.
    glm::dvec3 inversePoint(const glm::dvec3& world) const { return inverse_linear_ * (world - offset_); }
    glm::dvec3 inverseVector(const glm::dvec3& world) const { return inverse_linear_ * world; }

    // Longest world length of an index-space axis: the edge of a voxel of level 0.
    double voxelSize() const;
    bool operator==(const Affine& other) const { return forward_ == other.forward_; }

private:
    glm::dmat4 forward_{1.0};
    glm::dmat3 linear_{1.0};
    glm::dmat3 inverse_linear_{1.0};
    glm::dvec3 offset_{0.0};
};

}  // namespace brickyard

// A channel of one frame as a dense block of floats, coarse enough to fit: for statistics, not for pictures.
// Immutable once read: any thread.
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <vector>

#include "tools/field_reader.h"

namespace brickyard {

class SampledField {
public:
    // Of the finest level from `finest` on whose part of the active box has at most `most_samples`; one more
    // on each side. Nothing is active: empty. Errors: those of FieldReader.
    static Result<SampledField> read(const FieldReader& reader, std::uint64_t most_samples, int finest = 0);

    bool empty() const { return values_.empty(); }
    int level() const { return level_; }
    std::int64_t size(int axis) const { return box_.extent(axis); }
    std::int64_t count() const { return size(0) * size(1) * size(2); }
    // Sample `at` of [0, count), x fastest.
    float value(std::int64_t at, int component = 0) const {
        return values_[std::size_t(count() * component + at)];
    }
    // World position of a sample; world length from one sample to the next along an index axis.
    glm::dvec3 world(std::int64_t at) const;
    double spacing(int axis) const;
    // Trilinear; the background outside.
    double at(const glm::dvec3& world, int component = 0) const;
    glm::dvec3 vectorAt(const glm::dvec3& world) const;  // REQUIRES: three components

    // The value below which `part` in [0, 1] of the samples lie; 0 where it is empty.
    double quantile(double part) const;

private:
    Affine index_to_world_;
    int level_ = 0;
    IndexBox box_;  // positions of the level's own lattice
    std::vector<float> values_, background_;
};

}  // namespace brickyard

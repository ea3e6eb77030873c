// The picture contract once more, in long double and by other means than the renderer's: what its pictures
// are held against.
//
// The source's samples are read where the octree is not: recursively over boxes of 2^k cells. In a cell the
// field along the ray is a cubic in Bernstein form, whose mean is that of its four control points; where its
// sign changes it is halved until it does not. The ray is moved next to the medium in 113 bits first, so that
// distance from the eye costs nothing.
#pragma once

#include <array>
#include <map>
#include <memory>
#include <vector>

#include "core/camera.h"
#include "core/field_source.h"

namespace brickyard {

// Control points over [0, 1].
using Bernstein = std::array<long double, 4>;

// Mean of max(0, cubic) over [0, 1].
long double positiveMean(const Bernstein& cubic);
long double valueAt(const Bernstein& cubic, long double s);
// The cubic over [from, to] of what it was over [0, 1].
Bernstein part(const Bernstein& cubic, long double from, long double to);

// A stretch of a ray on which the field is one cubic. `begin` and `end` are world distances from the ray's
// origin.
struct ReferenceStep {
    long double begin = 0, end = 0;
    Bernstein cubic{};
};

// One scalar channel. Keeps what it has read; one thread at a time. `source` outlives it.
class ReferenceField {
public:
    explicit ReferenceField(const FieldSource& source) : source_(source) {}

    // Of the medium only: its active box and one sample beyond. In order; background that is 0 is left out.
    std::vector<ReferenceStep> along(const WorldRay& ray) const;
    // Of max(0, field) along all of the ray, by world distance.
    long double integral(const WorldRay& ray) const;

private:
    struct Ray {
        long double origin[3], direction[3];
        long double distance;  // world distance of `origin` from the eye
    };
    struct Span {
        long double begin, end;
    };
    struct Block {
        bool uniform = false;
        std::vector<double> samples;  // 1, or (kBlockEdge + 1)^3
    };
    using Key = std::array<std::int64_t, 4>;  // low corner, edge
    static constexpr std::int64_t kBlockEdge = 8;

    Ray enter(const WorldRay& ray, const std::array<std::int64_t, 3>& low,
              const std::array<std::int64_t, 3>& high) const;
    void visit(const Ray& ray, const Key& box, Span span, const Block* block,
               std::vector<ReferenceStep>& out) const;
    void visitCell(const Ray& ray, const Key& cell, Span span, const Block& block,
                   std::vector<ReferenceStep>& out) const;
    const Block& blockAt(const Key& key) const;

    const FieldSource& source_;
    mutable std::map<Key, Block> blocks_;
};

// Integral of emission * transmittance: `emission` and `density` are multiplied by their scales.
long double emittedRadiance(const std::vector<ReferenceStep>& density, long double density_scale,
                            const std::vector<ReferenceStep>& emission, long double emission_scale);
// Integral of transmittance * extinction * transmittance towards the light.
long double scatteredWeight(const ReferenceField& field, const WorldRay& ray, long double density_scale,
                            const glm::dvec3& to_light);

}  // namespace brickyard

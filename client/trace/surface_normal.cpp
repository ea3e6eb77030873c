// The normals of SurfaceTracer: gradients of the lattice's samples around a hit.

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "client/cpu/cell_walk.h"
#include "client/trace/surface_tracer.h"

namespace brickyard {

namespace {

// A separable kernel over the samples at -1, 0, 1 and 2 of an axis, and its derivative, at `s` in [0, 1].
struct AxisWeights {
    double value[4], slope[4];
};

// Mitchell, Netravali. Reconstruction Filters in Computer Graphics. 1988: B and C give the cubic B-spline (1,
// 0), Catmull and Rom's (0, 1/2), and theirs (1/3, 1/3).
AxisWeights cubicKernel(double s, double b, double c) {
    AxisWeights weights{};
    for (int i = 0; i < 4; ++i) {
        const double signed_x = s - (i - 1), x = std::abs(signed_x);
        double value = 0, slope = 0;
        if (x < 1) {
            const double c3 = 12 - 9 * b - 6 * c, c2 = -18 + 12 * b + 6 * c;
            value = (c3 * x + c2) * x * x + 6 - 2 * b;
            slope = (3 * c3 * x + 2 * c2) * x;
        } else if (x < 2) {
            const double c3 = -b - 6 * c, c2 = 6 * b + 30 * c, c1 = -12 * b - 48 * c;
            value = ((c3 * x + c2) * x + c1) * x + 8 * b + 24 * c;
            slope = (3 * c3 * x + 2 * c2) * x + c1;
        }
        weights.value[i] = value / 6;
        weights.slope[i] = (signed_x < 0 ? -slope : slope) / 6;
    }
    return weights;
}

// Standard deviation half a cell, normalised over the four.
AxisWeights gaussianKernel(double s) {
    AxisWeights weights{};
    double sum = 0, sum_slope = 0;
    for (int i = 0; i < 4; ++i) {
        const double x = s - (i - 1);
        weights.value[i] = std::exp(-2 * x * x);
        weights.slope[i] = -4 * x * weights.value[i];
        sum += weights.value[i];
        sum_slope += weights.slope[i];
    }
    for (int i = 0; i < 4; ++i) {
        weights.value[i] /= sum;
        weights.slope[i] = (weights.slope[i] - weights.value[i] * sum_slope) / sum;
    }
    return weights;
}

AxisWeights weightsOf(FieldFilter filter, double s) {
    switch (filter) {
        case FieldFilter::kBSpline: return cubicKernel(s, 1, 0);
        case FieldFilter::kCatmullRom: return cubicKernel(s, 0, 0.5);
        case FieldFilter::kMitchell: return cubicKernel(s, 1.0 / 3, 1.0 / 3);
        case FieldFilter::kGaussian: return gaussianKernel(s);
        case FieldFilter::kNearest:
        case FieldFilter::kTrilinear: break;
    }
    return {{0, 1 - s, s, 0}, {-0.5 * (1 - s), -0.5 * s, 0.5 * (1 - s), 0.5 * s}};
}

// Of the trilinear cell itself.
glm::dvec3 cellGradient(const float* samples, BrickShape shape, const glm::ivec3& cell, const glm::dvec3& p) {
    glm::dvec3 gradient(0);
    for (int corner = 0; corner < 8; ++corner) {
        const int i = corner & 1, j = corner >> 1 & 1, k = corner >> 2;
        const double value = double(samples[shape.sampleAt(cell.x + i, cell.y + j, cell.z + k)]);
        const double x = i ? p.x : 1 - p.x, y = j ? p.y : 1 - p.y, z = k ? p.z : 1 - p.z;
        gradient += value * glm::dvec3((i ? 1 : -1) * y * z, (j ? 1 : -1) * x * z, (k ? 1 : -1) * x * y);
    }
    return gradient;
}

}  // namespace

bool SurfaceTracer::outwards(const glm::dvec3& gradient, glm::dvec3& normal) const {
    auto scaled = [](glm::dvec3& v) {
        const double most = std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)});
        if (!(most > 0) || !std::isfinite(most)) return false;
        v /= most;
        return true;
    };
    glm::dvec3 direction = inside_below_ ? gradient : -gradient;
    if (!scaled(direction)) return false;
    // Gradients go with the transpose of the inverse.
    glm::dvec3 world;
    const glm::dvec3 axes[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int a = 0; a < 3; ++a) world[a] = glm::dot(channel_.transform().inverseVector(axes[a]), direction);
    if (!scaled(world)) return false;
    normal = glm::normalize(world);
    return true;
}

SurfaceTracer::Found SurfaceTracer::normal(const SurfaceHit& hit, const glm::dvec3& direction,
                                           FieldFilter filter, const RayContext& context, glm::dvec3& normal,
                                           double worth, bool* failed) const {
    normal = hit.entering ? -direction : direction;
    if (!hit.has_node) return Found::kHit;
    NodeFields fields(channel_, context, worth, MissingPages::kWant);
    const auto field = fields.read({hit.node, hit.key, channel_.block(hit.node.block)});
    if (field.state == NodeFields::State::kMissing) return Found::kMissing;
    // A page that has failed since.
    if (failed && (field.failed || hit.failed)) *failed = true;
    if (field.state != NodeFields::State::kBrick || !(field.node.key == hit.key)) return Found::kHit;
    const BrickShape shape = channel_.shape();
    outwards(cellGradient(field.samples, shape, hit.cell, hit.inside), normal);

    AxisWeights weights[3];
    std::int64_t base[3];  // of the brick, in cells of its level
    const std::int32_t corner[3] = {hit.key.x, hit.key.y, hit.key.z};
    for (int a = 0; a < 3; ++a) {
        weights[a] = weightsOf(filter, hit.inside[a]);
        base[a] = std::int64_t(corner[a]) * shape.edge_cells;
    }
    glm::dvec3 gradient(0);
    bool missing = false;
    for (int k = 0; k < 4; ++k)
        for (int j = 0; j < 4; ++j)
            for (int i = 0; i < 4; ++i) {
                const AxisWeights &x = weights[0], &y = weights[1], &z = weights[2];
                const glm::dvec3 weight(x.slope[i] * y.value[j] * z.value[k],
                                        x.value[i] * y.slope[j] * z.value[k],
                                        x.value[i] * y.value[j] * z.slope[k]);
                if (weight == glm::dvec3(0)) continue;
                int at[3] = {hit.cell.x + i - 1, hit.cell.y + j - 1, hit.cell.z + k - 1};
                bool own = true;
                for (int c : at) own = own && c >= 0 && c <= shape.edge_cells;
                double value = 0;
                if (!own) {
                    const auto sample =
                        fields.sample(hit.key.level, {base[0] + at[0], base[1] + at[1], base[2] + at[2]});
                    missing = missing || sample.state == NodeFields::State::kMissing;
                    if (failed && sample.failed) *failed = true;
                    value = sample.value;
                    // What nobody knows is taken to go on as it is at the border.
                    own = sample.state == NodeFields::State::kUnknown;
                    for (int& c : at) c = std::clamp(c, 0, shape.edge_cells);
                }
                if (own) value = double(field.samples[shape.sampleAt(at[0], at[1], at[2])]);
                gradient += value * weight;
            }
    if (missing) return Found::kMissing;
    outwards(gradient, normal);
    return Found::kHit;
}

}  // namespace brickyard

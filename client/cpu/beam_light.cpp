// What a tile's rays scatter of a light. docs/error-bounds.md, section "Light".

#include <algorithm>
#include <cmath>

#include "client/cpu/beam_tile.h"
#include "client/cpu/cell_walk.h"
#include "client/cpu/node_cells.h"

namespace brickyard {

namespace {

constexpr int kLanes = RayPacket::kRays;
constexpr double kNever = std::numeric_limits<double>::infinity();

bool inSpan(const PacketSpans& spans, int lane) { return spans.begin[lane] < spans.end[lane]; }

}  // namespace

void BeamTile::scatterNode(const Visit& met, const BrickCells& cells, const RayPacket& packet,
                           const PacketSpans& spans, PacketScatter& out) const {
    if (met.in_kernel) {
        LightCells light;
        light.quads = met.light->quads.data();
        std::copy_n(met.light->points, 3, light.points);
        std::copy_n(met.light->per_cell, 3, light.per_cell);
        return scatterInBrick(packet, cells, light, spans, scale_, out);
    }
    // One value, or a brick too dense for floats: step by step in double.
    const glm::dvec3 low = nodeLow(met.field.key, channel_.shape());
    const double cell = cellEdge(met.field.key.level);
    for (int lane = 0; lane < kLanes; ++lane) {
        out.depth[lane] = out.weight[lane] = 0;
        out.passed[lane] = out.last[lane] = 1;
        if (!inSpan(spans, lane)) continue;
        const IndexRay ray = rayOf(packet, lane);
        auto step = [&](double begin, double end, double amount) {
            const glm::dvec3 p = (ray.origin + 0.5 * (begin + end) * ray.direction - low) / cell;
            out.last[lane] = met.light ? met.light->transmittance(p.x, p.y, p.z) : 1;
            out.depth[lane] += amount;
            const double passed = out.passed[lane] * std::exp(-amount * scale_);
            out.weight[lane] += (out.passed[lane] - passed) * out.last[lane];
            out.passed[lane] = passed;
        };
        if (met.samples) {
            walkCells(met.samples, channel_.shape(), met.field.key, met.field.record(), ray,
                      {spans.begin[lane], spans.end[lane]},
                      [&](const Cell& values, const glm::dvec3& from, const glm::dvec3& to, double begin,
                          double end) { step(begin, end, meanPositive(values, from, to) * (end - begin)); });
            continue;
        }
        const int steps = met.light ? 2 * kMostLightCells : 1;
        const double length = (spans.end[lane] - spans.begin[lane]) / steps;
        for (int k = 0; k < steps; ++k)
            step(spans.begin[lane] + k * length, spans.begin[lane] + (k + 1) * length, met.constant * length);
    }
}

double BeamTile::mostScattered() const {
    const glm::dvec3 scattered = plan_.scattered();
    return std::max({scattered.x, scattered.y, scattered.z}) *
           henyeyGreenstein(std::abs(plan_.scene.anisotropy), 1);
}

// docs/error-bounds.md, section "Radiance".
void BeamTile::lightPixel(std::size_t place, int lane, Pixel& pixel) const {
    const BeamRays& rays = rays_[place];
    const PixelPlace at = pixels_.lanes[place].place[lane];
    const glm::dvec3 view = plan_.camera->ray(at.x, at.y).direction;
    const glm::dvec3 color =
        plan_.scattered() *
        henyeyGreenstein(plan_.scene.anisotropy, glm::dot(plan_.scene.light->to_light, view));
    const double most = std::max({color.x, color.y, color.z});
    const double weight = rays.weight[lane];
    // Strict: shadows are known to lie in [0, 1] only, so the weight lies between none and all of the true
    // alpha.
    const double alpha_high = -std::expm1(-rays.high[lane] * scale_);
    constexpr double kWeightRounding = 4e-6;
    const double bound = most * (std::max(weight, alpha_high - weight) + kWeightRounding * (1 + weight));
    // Expected: raising a node's depth adds T S and takes away what is scattered behind; shadows share their
    // errors.
    const double levels = std::max(0.0, rays.moment2[lane] - 2 * weight * rays.moment1[lane] +
                                            weight * weight * rays.variance[lane]) *
                          scale_ * scale_;
    const double estimate =
        most * std::sqrt(levels + rays.shadow_deviation[lane] * rays.shadow_deviation[lane] +
                         rays.shadow_variance[lane]);
    constexpr double kMost = std::numeric_limits<float>::max();
    for (std::size_t c = 0; c < 3; ++c) pixel.radiance[c] = float(std::min(color[int(c)] * weight, kMost));
    pixel.bound_radiance = float(std::min(bound, kMost));
    pixel.estimate_radiance = float(std::min({estimate, bound, kMost}));
}

// Transmittance of the last cut in front of a place on the ray.
double BeamTile::transmittanceBefore(std::size_t place, int lane, double distance) const {
    const BeamRays& rays = rays_[place];
    for (std::int32_t m = rays.last_mark; m >= 0; m = marks_[std::size_t(m)].previous) {
        const Mark& mark = marks_[std::size_t(m)];
        if (mark.cut == rays.cut[lane] && mark.end[lane] <= distance && mark.end[lane] > -kNever)
            return std::exp(-mark.depth[lane] * scale_);
    }
    return 1;
}

}  // namespace brickyard

#include "client/trace/light_projection.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>

namespace brickyard {

namespace {

// A point counts as covered as far as this, in pixels, outside the outermost: rounding must not lose the
// border.
constexpr double kBorder = 1e-3;
// Wider cones are covered by a cube: tangents grow without bound.
constexpr double kLeastPerspectiveCosine = 0.5;

glm::dvec3 cornerOf(const WorldBox& box, int corner) {
    return {corner & 1 ? box.high.x : box.low.x, corner & 2 ? box.high.y : box.low.y,
            corner & 4 ? box.high.z : box.low.z};
}

// Distance of pixels where `edge_pixels` are along the longer side.
double pitchOf(double extent_u, double extent_v, std::uint32_t edge_pixels) {
    return std::max(extent_u, extent_v) / double(edge_pixels - 1);
}

}  // namespace

void LightProjection::addFaces(std::vector<Face> faces, const std::vector<Extent>& extents, double pitch) {
    auto pixelsOver = [&](double extent) {
        return extent > 0 ? std::uint32_t(std::ceil(extent / pitch - 1e-6)) + 1 : 1;
    };
    for (std::size_t i = 0; i < faces.size(); ++i) {
        Face& face = faces[i];
        const Extent& e = extents[i];
        face.low_u = e.low_u;
        face.low_v = e.low_v;
        face.width = pixelsOver(e.high_u - e.low_u);
        face.height = pixelsOver(e.high_v - e.low_v);
        if (face.width > 1) face.step_u = (e.high_u - e.low_u) / (face.width - 1);
        if (face.height > 1) face.step_v = (e.high_v - e.low_v) / (face.height - 1);
        face.first = pixel_count_;
        pixel_count_ += face.width * face.height;
    }
    faces_ = std::move(faces);
}

void LightProjection::measureDistances() {
    glm::dvec3 nearest;
    for (int a = 0; a < 3; ++a) nearest[a] = std::clamp(origin_[a], box_.low[a], box_.high[a]);
    nearest_ = glm::length(nearest - origin_);
    for (int c = 0; c < 8; ++c) farthest_ = std::max(farthest_, glm::length(cornerOf(box_, c) - origin_));
}

LightProjection LightProjection::directional(const glm::dvec3& to_light, const WorldBox& box,
                                             std::uint32_t edge_pixels) {
    const glm::dvec3 middle = box.low + 0.5 * (box.high - box.low), forward = -to_light;
    // Of the rectangles that have a side along an edge of the box, the least.
    Face face;
    Extent extent{};
    double least = std::numeric_limits<double>::infinity();
    for (int a = 0; a < 3; ++a) {
        glm::dvec3 axis(0);
        axis[a] = 1;
        const glm::dvec3 across = axis - glm::dot(axis, forward) * forward;
        // Seen from its end, an edge has no direction.
        if (glm::length(across) < 1e-3) continue;
        const glm::dvec3 right = glm::normalize(across), up = glm::cross(right, forward);
        double half_u = 0, half_v = 0;
        for (int c = 0; c < 8; ++c) {
            const glm::dvec3 corner = cornerOf(box, c) - middle;
            half_u = std::max(half_u, std::abs(glm::dot(corner, right)));
            half_v = std::max(half_v, std::abs(glm::dot(corner, up)));
        }
        if (!(half_u * half_v < least)) continue;
        least = half_u * half_v;
        face.forward = forward;
        face.right = right;
        face.up = up;
        extent = {-half_u, half_u, -half_v, half_v};
    }
    double half_depth = 0;
    for (int c = 0; c < 8; ++c)
        half_depth = std::max(half_depth, std::abs(glm::dot(cornerOf(box, c) - middle, forward)));
    LightProjection projection(box, middle - half_depth * forward, /*parallel=*/true);
    projection.addFaces({face}, {extent},
                        pitchOf(extent.high_u - extent.low_u, extent.high_v - extent.low_v, edge_pixels));
    projection.farthest_ = 2 * half_depth;
    return projection;
}

LightProjection LightProjection::point(const glm::dvec3& position, const WorldBox& box,
                                       std::uint32_t edge_pixels) {
    LightProjection projection(box, position, /*parallel=*/false);
    projection.measureDistances();
    std::vector<Face> faces;
    std::vector<Extent> extents;
    for (int side = 0; side < 6; ++side) {
        const int w = side / 2, u = (w + 1) % 3, v = (w + 2) % 3;
        const double sign = side % 2 ? -1 : 1;
        Face face;
        face.forward[w] = sign;
        face.right[u] = 1;
        face.up[v] = 1;
        // Depths of the box before the face; tangents are extreme at its nearest and farthest.
        double near = sign * (sign > 0 ? box.low : box.high)[w] - sign * position[w];
        const double far = sign * (sign > 0 ? box.high : box.low)[w] - sign * position[w];
        if (!(far > 0)) continue;
        near = std::max(near, 0.0);
        auto tangent = [](double across, double depth_if_inwards, double depth_if_outwards) {
            if (across == 0) return 0.0;
            // A box that begins at the light's own depth fills the face.
            return std::clamp(across / (across > 0 ? depth_if_outwards : depth_if_inwards), -1.0, 1.0);
        };
        auto low = [&](int a) { return tangent(box.low[a] - position[a], near, far); };
        auto high = [&](int a) { return tangent(box.high[a] - position[a], far, near); };
        const Extent extent{low(u), high(u), low(v), high(v)};
        // Seen beside the face alone: clamped to one of its edges.
        const bool beside = extent.low_u == extent.high_u || extent.low_v == extent.high_v;
        if (beside && box.low[u] < box.high[u] && box.low[v] < box.high[v]) continue;
        faces.push_back(face);
        extents.push_back(extent);
    }
    // One grid for all, of which each face takes what it needs: the rays of an edge are the same from both
    // sides.
    double longest = 0;
    for (const Extent& e : extents) longest = std::max({longest, e.high_u - e.low_u, e.high_v - e.low_v});
    if (longest > 0) {
        const double cells = std::ceil(2 * (edge_pixels - 1) / longest * (1 - 1e-12));
        auto snapped = [&](double tangent, double up) {
            const double at = (tangent + 1) * 0.5 * cells,
                         to = up > 0 ? std::ceil(at - 1e-9) : std::floor(at + 1e-9);
            return std::clamp(to / cells * 2 - 1, -1.0, 1.0);
        };
        for (Extent& e : extents)
            e = {snapped(e.low_u, -1), snapped(e.high_u, 1), snapped(e.low_v, -1), snapped(e.high_v, 1)};
        projection.addFaces(std::move(faces), extents, 2 / cells);
    }
    return projection;
}

LightProjection LightProjection::spot(const glm::dvec3& position, const glm::dvec3& to_light,
                                      double cos_outer, const WorldBox& box, std::uint32_t edge_pixels) {
    if (!(cos_outer >= kLeastPerspectiveCosine)) return point(position, box, edge_pixels);
    LightProjection projection(box, position, /*parallel=*/false);
    projection.measureDistances();
    Face face;
    face.forward = -to_light;
    const glm::dvec3 axis = std::abs(to_light.y) < 0.9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0);
    face.right = glm::normalize(glm::cross(face.forward, axis));
    face.up = glm::cross(face.right, face.forward);

    const double tangent = std::sqrt(std::max(0.0, 1 - cos_outer * cos_outer)) / cos_outer;
    Extent seen{1e300, -1e300, 1e300, -1e300};
    int in_front = 0;
    for (int c = 0; c < 8; ++c) {
        const glm::dvec3 corner = cornerOf(box, c) - position;
        const double depth = glm::dot(corner, face.forward);
        if (!(depth > 0)) continue;
        ++in_front;
        const double u = glm::dot(corner, face.right) / depth, v = glm::dot(corner, face.up) / depth;
        seen = {std::min(seen.low_u, u), std::max(seen.high_u, u), std::min(seen.low_v, v),
                std::max(seen.high_v, v)};
    }
    if (in_front == 0) return projection;
    // A box that reaches behind the light may be seen anywhere.
    if (in_front < 8) seen = {-tangent, tangent, -tangent, tangent};
    const Extent extent{std::max(seen.low_u, -tangent), std::min(seen.high_u, tangent),
                        std::max(seen.low_v, -tangent), std::min(seen.high_v, tangent)};
    if (extent.low_u > extent.high_u || extent.low_v > extent.high_v) return projection;
    projection.addFaces({face}, {extent},
                        pitchOf(extent.high_u - extent.low_u, extent.high_v - extent.low_v, edge_pixels));
    return projection;
}

WorldRay LightProjection::ray(std::uint32_t pixel) const {
    std::size_t at = faces_.size() - 1;
    while (faces_[at].first > pixel) --at;
    const Face& face = faces_[at];
    const std::uint32_t x = (pixel - face.first) % face.width, y = (pixel - face.first) / face.width;
    const glm::dvec3 aside =
        (face.low_u + face.step_u * x) * face.right + (face.low_v + face.step_v * y) * face.up;
    if (parallel_) return {origin_ + aside, face.forward};
    return {origin_, glm::normalize(face.forward + aside)};
}

RaySpan LightProjection::span(std::uint32_t pixel) const {
    const WorldRay along = ray(pixel);
    RaySpan span{0, std::numeric_limits<double>::infinity()};
    for (int a = 0; a < 3; ++a) {
        const double low = box_.low[a] - along.origin[a], high = box_.high[a] - along.origin[a];
        if (along.direction[a] == 0) {
            if (low > 0 || high < 0) return {0, 0};
            continue;
        }
        const double p = low / along.direction[a], q = high / along.direction[a];
        span.begin = std::max(span.begin, std::min(p, q));
        span.end = std::min(span.end, std::max(p, q));
    }
    return span.empty() ? RaySpan{0, 0} : span;
}

LightProjection::Place LightProjection::place(const glm::dvec3& world) const {
    Place place;
    const glm::dvec3 from = world - origin_;
    // Of a cube's faces the one ahead.
    const Face* ahead = nullptr;
    double depth = parallel_ ? -std::numeric_limits<double>::infinity() : 0;
    if (parallel_) {
        if (!faces_.empty()) ahead = &faces_[0];
        depth = ahead ? glm::dot(from, ahead->forward) : 0;
        place.distance = depth;
    } else {
        for (const Face& face : faces_)
            if (const double d = glm::dot(from, face.forward); d > depth) depth = d, ahead = &face;
        place.distance = glm::length(from);
    }
    if (!ahead) return place;
    const double scale = parallel_ ? 1 : 1 / depth;
    double x = (glm::dot(from, ahead->right) * scale - ahead->low_u) / ahead->step_u;
    double y = (glm::dot(from, ahead->up) * scale - ahead->low_v) / ahead->step_v;
    const double most_x = ahead->width - 1.0, most_y = ahead->height - 1.0;
    // A NaN is not covered.
    if (!(x >= -kBorder && x <= most_x + kBorder && y >= -kBorder && y <= most_y + kBorder)) return place;
    place.covered = true;
    x = std::clamp(x, 0.0, most_x);
    y = std::clamp(y, 0.0, most_y);
    const auto x0 = std::uint32_t(std::min(x, std::max(0.0, most_x - 1)));
    const auto y0 = std::uint32_t(std::min(y, std::max(0.0, most_y - 1)));
    const std::uint32_t x1 = std::min(x0 + 1, ahead->width - 1), y1 = std::min(y0 + 1, ahead->height - 1);
    const double s = x - x0, t = y - y0;
    auto at = [&](std::uint32_t i, std::uint32_t j) { return ahead->first + i + ahead->width * j; };
    place.pixel = {at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1)};
    place.weight = {(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t};
    return place;
}

}  // namespace brickyard

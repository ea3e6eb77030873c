// How a light sees a world box: the pixels of a map of light rays that covers all of the box and little else.
// Plain value, any thread.
//
// Pixels stand at the corners of a grid, the outermost on the border of what is covered: every point of the
// box is between four of them, and faces of a cube that meet share the rays of their edge.
#pragma once

#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <vector>

#include "client/cpu/index_ray.h"
#include "core/camera.h"

namespace brickyard {

struct WorldBox {
    glm::dvec3 low{0}, high{0};
};

class LightProjection {
public:
    // `edge_pixels` (one or two more, for a point light) along the longest side of what is covered; pixels
    // are square but for a rounding. A light that does not see the box has no pixels. REQUIRES: 2 <=
    // edge_pixels <= 16384; low <= high, all finite; unit directions.
    //
    // Orthographic, turned about the direction so that one edge of the box lies along a side.
    static LightProjection directional(const glm::dvec3& to_light, const WorldBox& box,
                                       std::uint32_t edge_pixels);
    // Faces of a cube about the position, cut down to the rectangles in which the box is seen: all six,
    // whole, where the light is inside.
    static LightProjection point(const glm::dvec3& position, const WorldBox& box, std::uint32_t edge_pixels);
    // Perspective about the axis, `to_light` against it, around the cone and the box; a cone wider than 120
    // degrees is covered as a point light.
    static LightProjection spot(const glm::dvec3& position, const glm::dvec3& to_light, double cos_outer,
                                const WorldBox& box, std::uint32_t edge_pixels);

    std::uint32_t pixelCount() const { return pixel_count_; }
    // From the light (directional: from a plane in front of the box) through a pixel.
    WorldRay ray(std::uint32_t pixel) const;
    // The part of that ray in the box; empty where it only touches, or passes.
    RaySpan span(std::uint32_t pixel) const;
    // No point of the box is nearer to a ray's origin, or farther.
    double nearest() const { return nearest_; }
    double farthest() const { return farthest_; }

    // A point between the pixels around it: the weights add up to 1. `distance` is that of the point from the
    // light, so along each of the four rays: shells about a point light, planes before a directional one.
    struct Place {
        bool covered = false;  // else the box is not seen in its direction, or it is behind, or at the light
        double distance = 0;
        std::array<std::uint32_t, 4> pixel{};
        std::array<double, 4> weight{};
    };
    Place place(const glm::dvec3& world) const;

    struct Face {
        glm::dvec3 forward{0}, right{0}, up{0};  // unit
        double low_u = 0, low_v = 0;             // of pixel (0, 0): world units, or tangents
        double step_u = 1, step_v = 1;
        std::uint32_t width = 0, height = 0;
        std::uint32_t first = 0;  // its pixels are [first, first + width * height), rows by v
    };
    const std::vector<Face>& faces() const { return faces_; }

private:
    LightProjection(const WorldBox& box, const glm::dvec3& origin, bool parallel)
        : box_(box), origin_(origin), parallel_(parallel) {}
    struct Extent {
        double low_u, high_u, low_v, high_v;
    };
    void addFaces(std::vector<Face> faces, const std::vector<Extent>& extents, double pitch);
    void measureDistances();

    WorldBox box_;
    glm::dvec3 origin_;  // the light, or the middle of the plane in front of the box
    bool parallel_;
    double nearest_ = 0, farthest_ = 0;
    std::vector<Face> faces_;
    std::uint32_t pixel_count_ = 0;
};

}  // namespace brickyard

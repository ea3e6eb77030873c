#include "client/cpu/pixel_packets.h"

#include <cmath>
#include <glm/geometric.hpp>

namespace brickyard {

namespace {

constexpr std::uint32_t kEdge = 4;  // pixels: compact packets meet the same bricks more often than rows do
constexpr double kNever = std::numeric_limits<double>::infinity();

// The camera in index space. Directions are linear in the pixel, so the transform is applied once, not per
// ray.
struct IndexCamera {
    glm::dvec3 eye, forward, right, up;
    double width, height, half_height;

    IndexCamera(const PinholeCamera& camera, const Affine& transform)
        : eye(transform.inversePoint(camera.eye())),
          forward(transform.inverseVector(camera.forward())),
          right(transform.inverseVector(camera.right())),
          up(transform.inverseVector(camera.up())),
          width(camera.width()),
          height(camera.height()),
          half_height(camera.halfHeight()) {}

    // Coordinates of a picture point on the plane at distance 1; pixel centres lie at + 0.5.
    double planeX(double x) const { return (2 * x / width - 1) * half_height * width / height; }
    double planeY(double y) const { return (1 - 2 * y / height) * half_height; }
    // Not of unit length.
    glm::dvec3 towards(double x, double y) const { return forward + right * planeX(x) + up * planeY(y); }
};

// Whether all rays of the box pass by the medium: its eight corners lie beyond one side of the box's pyramid.
// Errs on the side of no.
bool missesMedium(const IndexCamera& camera, const PagedChannel& channel, const PixelBox& box) {
    const glm::dvec3 corners[4] = {camera.towards(box.x0, box.y0), camera.towards(box.x1, box.y0),
                                   camera.towards(box.x1, box.y1), camera.towards(box.x0, box.y1)};
    const glm::dvec3 inside = corners[0] + corners[1] + corners[2] + corners[3];
    const glm::dvec3 low = channel.clipLow() - camera.eye, high = channel.clipHigh() - camera.eye;
    for (int side = 0; side < 4; ++side) {
        glm::dvec3 normal = glm::cross(corners[side], corners[(side + 1) % 4]);
        if (glm::dot(normal, inside) < 0) normal = -normal;
        double most = -kNever, size = 0;
        for (int corner = 0; corner < 8; ++corner) {
            const glm::dvec3 at(corner & 1 ? high.x : low.x, corner & 2 ? high.y : low.y,
                                corner & 4 ? high.z : low.z);
            most = std::max(most, glm::dot(normal, at));
            size = std::max(size, glm::length(at));
        }
        constexpr double kSlack = 1e-9;
        if (most < -kSlack * size * glm::length(normal)) return true;
    }
    return false;
}

// One packet's rays; false where none of them meets the medium.
bool fillPacket(const IndexCamera& camera, const PagedChannel& channel, const PixelBox& box, std::uint32_t x,
                std::uint32_t y, RayPacket& packet, PixelPackets::Lanes& lanes,
                std::vector<PixelPlace>& others) {
    constexpr int kRays = RayPacket::kRays;
    const glm::dvec3 low = channel.clipLow() - camera.eye, high = channel.clipHigh() - camera.eye;
    bool any = false;
    for (int lane = 0; lane < kRays; ++lane) {
        const double px = camera.planeX(x + std::uint32_t(lane) % kEdge + 0.5);
        const double py = camera.planeY(y + std::uint32_t(lane) / kEdge + 0.5);
        // Forward, right and up are perpendicular in the world, so this is the world direction's length.
        const double per_world = 1 / std::sqrt(1 + px * px + py * py);
        double square = 0, begin = 0, end = kNever;
        for (int a = 0; a < 3; ++a) {
            const double direction =
                (camera.forward[a] + camera.right[a] * px + camera.up[a] * py) * per_world;
            const double inverse = 1 / direction;
            packet.origin[a][lane] = camera.eye[a];
            packet.direction[a][lane] = direction;
            packet.inverse[a][lane] = inverse;
            square += direction * direction;
            const double p = low[a] * inverse, q = high[a] * inverse;
            begin = std::max(begin, std::min(p, q));
            end = std::min(end, std::max(p, q));
        }
        packet.begin[lane] = begin;
        packet.end[lane] = end;
        lanes.unit[lane] = 1 / std::sqrt(square);
    }
    for (int lane = 0; lane < kRays; ++lane) {
        const PixelPlace place{x + std::uint32_t(lane) % kEdge, y + std::uint32_t(lane) / kEdge};
        lanes.place[lane] = place;
        bool inside = place.x < box.x1 && place.y < box.y1;
        double longest = 0;
        for (int a = 0; a < 3; ++a) longest = std::max(longest, std::abs(packet.direction[a][lane]));
        for (int a = 0; a < 3 && inside; ++a)
            // As IndexRay has it; what is so nearly parallel has no finite inverse to compute with.
            if (!(std::abs(packet.direction[a][lane]) > longest * 1e-280)) {
                others.push_back(place);
                inside = false;
            }
        if (!inside || !(packet.begin[lane] < packet.end[lane])) {
            packet.begin[lane] = packet.end[lane] = kNever;
            for (int a = 0; a < 3; ++a) packet.direction[a][lane] = packet.inverse[a][lane] = 1;
            lanes.unit[lane] = 1;
            continue;
        }
        lanes.used = std::uint16_t(lanes.used | 1u << lane);
        any = true;
    }
    return any;
}

}  // namespace

PixelPackets packetsOf(const PinholeCamera& camera, const PagedChannel& channel, const PixelBox& box) {
    PixelPackets out;
    const IndexCamera index_camera(camera, channel.transform());
    if (missesMedium(index_camera, channel, box)) return out;
    const std::size_t most = (std::size_t(box.x1 - box.x0) + kEdge - 1) / kEdge *
                             ((std::size_t(box.y1 - box.y0) + kEdge - 1) / kEdge);
    out.packets.reserve(most);
    out.lanes.reserve(most);
    for (std::uint32_t y = box.y0; y < box.y1; y += kEdge)
        for (std::uint32_t x = box.x0; x < box.x1; x += kEdge) {
            RayPacket& packet = out.packets.emplace_back();
            PixelPackets::Lanes& lanes = out.lanes.emplace_back();
            if (fillPacket(index_camera, channel, box, x, y, packet, lanes, out.others)) continue;
            out.packets.pop_back();
            out.lanes.pop_back();
        }
    return out;
}

}  // namespace brickyard

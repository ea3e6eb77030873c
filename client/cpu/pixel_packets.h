// The rays of a box of pixels, sixteen to a packet. Pure functions, any thread.
#pragma once

#include <cstdint>
#include <vector>

#include "client/cpu/ray_packet.h"
#include "client/paged_channel.h"
#include "core/camera.h"

namespace brickyard {

// Pixels [x0, x1) x [y0, y1).
struct PixelBox {
    std::uint32_t x0 = 0, y0 = 0, x1 = 0, y1 = 0;
    std::uint64_t pixels() const { return std::uint64_t(x1 - x0) * (y1 - y0); }
};
struct PixelPlace {
    std::uint32_t x = 0, y = 0;
};

struct PixelPackets {
    std::vector<RayPacket> packets;
    // By packet: the pixel of each lane, which lanes have one, and the world length of an index unit along
    // each ray.
    struct Lanes {
        PixelPlace place[RayPacket::kRays];
        std::uint16_t used = 0;
        double unit[RayPacket::kRays] = {};
    };
    std::vector<Lanes> lanes;
    // Pixels whose rays run parallel to an axis plane: no packet takes them.
    std::vector<PixelPlace> others;
};

// Packets of 4 x 4 pixels whose rays meet the channel's medium; rays that miss it are in none, or are not
// live. REQUIRES: the channel is not empty.
PixelPackets packetsOf(const PinholeCamera& camera, const PagedChannel& channel, const PixelBox& box);

}  // namespace brickyard

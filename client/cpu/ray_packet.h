// Sixteen rays side by side, as the SIMD kernels take them. Plain value; one thread works on a packet.
#pragma once

#include <cstdint>

#include "client/cpu/index_ray.h"

namespace brickyard {

struct alignas(64) RayPacket {
    static constexpr int kRays = 16;
    // As IndexRay has them: index space; t is world distance. REQUIRES: no axis of a live ray is parallel.
    double origin[3][kRays] = {};
    double direction[3][kRays] = {};
    double inverse[3][kRays] = {};
    // What is left to walk of each ray, in world distances. A ray with begin >= end is not there.
    double begin[kRays] = {};
    double end[kRays] = {};

    void set(int lane, const IndexRay& ray, RaySpan span) {
        for (int a = 0; a < 3; ++a) {
            origin[a][lane] = ray.origin[a];
            direction[a][lane] = ray.direction[a];
            inverse[a][lane] = ray.inverse[a];
        }
        begin[lane] = span.begin;
        end[lane] = span.end;
    }
    bool live(int lane) const { return begin[lane] < end[lane]; }
};

}  // namespace brickyard

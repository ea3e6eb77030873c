// The range of a channel over a box, from topology alone. Any thread.
#pragma once

#include <algorithm>
#include <glm/vec3.hpp>
#include <limits>

#include "client/cpu/channel_ray.h"
#include "client/paged_channel.h"

namespace brickyard {

struct ValueRange {
    double low = std::numeric_limits<double>::infinity();
    double high = -std::numeric_limits<double>::infinity();
    bool empty() const { return !(low <= high); }
    void add(double value) {
        low = std::min(low, value);
        high = std::max(high, value);
    }
    void add(const ValueRange& other) {
        low = std::min(low, other.low);
        high = std::max(high, other.high);
    }
};

// Every value that a ChannelReader may give within [low, high] (index space) at levels of detail up to
// `level` with that square budget. Looks no deeper than nodes of `level`: what lies below a node is within
// its range. False where a tree block is missing (it is wanted): `out` is then no bound.
bool rangeOver(const PagedChannel& channel, const glm::dvec3& low, const glm::dvec3& high, int level,
               double square_budget, const RayContext& context, ValueRange& out);

}  // namespace brickyard

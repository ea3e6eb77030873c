// Boxes of integer positions in index space. 64 bits, so that extents of the whole int32 lattice do not
// overflow.
#pragma once

#include <array>
#include <cstdint>

namespace brickyard {

using Index3 = std::array<std::int64_t, 3>;

// Samples [begin, end) per axis; empty where any end <= begin.
struct IndexBox {
    Index3 begin{0, 0, 0};
    Index3 end{0, 0, 0};

    std::int64_t extent(int axis) const { return end[std::size_t(axis)] - begin[std::size_t(axis)]; }
    bool empty() const { return extent(0) <= 0 || extent(1) <= 0 || extent(2) <= 0; }
    bool contains(const Index3& p) const {
        for (std::size_t a = 0; a < 3; ++a)
            if (p[a] < begin[a] || p[a] >= end[a]) return false;
        return true;
    }
    bool operator==(const IndexBox&) const = default;
};

inline IndexBox intersect(const IndexBox& a, const IndexBox& b) {
    IndexBox r;
    for (std::size_t k = 0; k < 3; ++k) {
        r.begin[k] = a.begin[k] > b.begin[k] ? a.begin[k] : b.begin[k];
        r.end[k] = a.end[k] < b.end[k] ? a.end[k] : b.end[k];
    }
    return r;
}

}  // namespace brickyard

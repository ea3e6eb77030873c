#include "core/node_key.h"

#include <fmt/format.h>

namespace brickyard {

std::string toString(const NodeKey& key) {
    return fmt::format("L{}({},{},{})", key.level, key.x, key.y, key.z);
}

bool mortonLess(const NodeKey& a, const NodeKey& b) {
    if (a.level != b.level) return a.level < b.level;
    // The order is decided by the axis that differs in the highest bit; z stands above y above x in an
    // octant's number, so it wins a tie. The sign bit is flipped to put negative coordinates first. Chan,
    // Closest-Point Problems Simplified on the RAM, 2002: the highest bit of p is below q's iff p < q && p <
    // (p ^ q).
    const auto biased = [](std::int32_t v) { return std::uint32_t(v) ^ 0x80000000u; };
    const auto highestBitBelow = [](std::uint32_t p, std::uint32_t q) { return p < q && p < (p ^ q); };
    std::uint32_t p = biased(a.z), q = biased(b.z);
    if (highestBitBelow(p ^ q, biased(a.y) ^ biased(b.y))) p = biased(a.y), q = biased(b.y);
    if (highestBitBelow(p ^ q, biased(a.x) ^ biased(b.x))) p = biased(a.x), q = biased(b.x);
    return p < q;
}

}  // namespace brickyard

#include "tools/bake/lit_voxels.h"

#include <algorithm>

namespace brickyard {

namespace {

// Level-0 samples an edge that are looked at at once, about.
constexpr std::int64_t kPieceSamples = 64;

std::int64_t floorShift(std::int64_t value, int by) { return value >> by; }
std::int64_t ceilShift(std::int64_t value, int by) { return -(-value >> by); }

std::size_t countOf(const IndexBox& box) {
    return std::size_t(box.extent(0)) * std::size_t(box.extent(1)) * std::size_t(box.extent(2));
}

// Along one axis each `step`-th place becomes whether any within `step` of it is set. `size` is the box's,
// and is changed: n becomes (n - 1) / step - 1.
void spread(std::vector<std::uint8_t>& set, std::array<std::size_t, 3>& size, std::size_t axis,
            std::size_t step) {
    const std::array<std::size_t, 3> strides{1, size[0], size[0] * size[1]};
    std::array<std::size_t, 3> to = size;
    to[axis] = (size[axis] - 1) / step - 1;
    std::vector<std::uint8_t> out(to[0] * to[1] * to[2]);
    std::size_t at = 0;
    std::array<std::size_t, 3> p{};
    for (p[2] = 0; p[2] < to[2]; ++p[2])
        for (p[1] = 0; p[1] < to[1]; ++p[1])
            for (p[0] = 0; p[0] < to[0]; ++p[0], ++at) {
                std::size_t from = 0;
                for (std::size_t a = 0; a < 3; ++a) from += strides[a] * p[a] * (a == axis ? step : 1);
                for (std::size_t i = 0; i <= 2 * step && !out[at]; ++i)
                    out[at] = set[from + i * strides[axis]];
            }
    set = std::move(out);
    size = to;
}

// Calls body(piece) for pieces of `edge` voxels an edge that tile the box.
template <class Body>
Result<void> forEachPiece(const IndexBox& box, std::int64_t edge, Body body) {
    for (std::int64_t z = box.begin[2]; z < box.end[2]; z += edge)
        for (std::int64_t y = box.begin[1]; y < box.end[1]; y += edge)
            for (std::int64_t x = box.begin[0]; x < box.end[0]; x += edge)
                if (Result<void> done = body(intersect(box, {{x, y, z}, {x + edge, y + edge, z + edge}}));
                    !done)
                    return done;
    return {};
}

}  // namespace

LitVoxels::LitVoxels(const FieldReader& density, int level) : density_(density), level_(level) {
    const ChannelFooter& channel = density.channel();
    if (channel.active_min_size() == 3 && channel.active_max_size() == 3)
        for (int a = 0; a < 3; ++a) {
            medium_.begin[std::size_t(a)] = std::int64_t(channel.active_min(a)) - 1;
            medium_.end[std::size_t(a)] = std::int64_t(channel.active_max(a)) + 2;
        }
    background_counts_ = toDouble(density.type(), density.background()[0]) > 0;
}

// The level-0 samples that decide about a box.
IndexBox LitVoxels::reach(const IndexBox& box) const {
    const std::int64_t step = std::int64_t(1) << level_;
    IndexBox samples;
    for (std::size_t a = 0; a < 3; ++a) {
        samples.begin[a] = (box.begin[a] - 1) * step;
        samples.end[a] = box.end[a] * step + 1;
    }
    return samples;
}

bool LitVoxels::maySet(const FieldNode& node, const IndexBox& box) const {
    if (intersect(box, density_.ownedRegion(node.key)).empty()) return false;
    if (node.isLeaf() || node.key.level == 0) {
        if (node.record().hasBrick() || node.record().active) return true;
        return toDouble(density_.type(), node.tree->constant(node.node)[0]) > 0;
    }
    for (int octant = 0; octant < 8; ++octant) {
        if (!(node.validMask() >> octant & 1)) continue;
        if (intersect(box, density_.ownedRegion(node.key.child(octant))).empty()) continue;
        // What cannot be read is read()'s to tell.
        const auto child = density_.child(node, octant);
        if (!child || maySet(*child, box)) return true;
    }
    return false;
}

bool LitVoxels::anyIn(const IndexBox& box) const {
    const IndexBox samples = intersect(reach(box), medium_);
    if (samples.empty()) return false;
    if (background_counts_) return true;
    const auto roots = density_.roots();
    if (!roots) return true;
    return std::any_of(roots->begin(), roots->end(),
                       [&](const FieldNode& root) { return maySet(root, samples); });
}

Result<void> LitVoxels::maskPiece(const IndexBox& piece, std::vector<std::uint8_t>& out) const {
    const IndexBox samples = reach(piece);
    SampleBlock block;
    if (Result<void> read = density_.read(samples, block); !read) return read;
    std::vector<std::uint8_t> set = std::move(block.active);
    std::size_t at = 0;
    for (std::int64_t z = samples.begin[2]; z < samples.end[2]; ++z)
        for (std::int64_t y = samples.begin[1]; y < samples.end[1]; ++y)
            for (std::int64_t x = samples.begin[0]; x < samples.end[0]; ++x, ++at)
                if (!set[at] && medium_.contains({x, y, z}))
                    set[at] = toDouble(density_.type(), sampleBits(density_.type(), block.values, at)) > 0;
    std::array<std::size_t, 3> size{};
    for (int a = 0; a < 3; ++a) size[std::size_t(a)] = std::size_t(samples.extent(a));
    for (std::size_t axis = 0; axis < 3; ++axis) spread(set, size, axis, std::size_t(1) << level_);
    out = std::move(set);
    return {};
}

Result<void> LitVoxels::mask(const IndexBox& box, std::vector<std::uint8_t>& out) const {
    out.assign(countOf(box), 0);
    std::vector<std::uint8_t> part;
    const std::int64_t edge = std::max<std::int64_t>(1, kPieceSamples >> level_);
    return forEachPiece(box, edge, [&](const IndexBox& piece) -> Result<void> {
        if (!anyIn(piece)) return {};
        if (Result<void> masked = maskPiece(piece, part); !masked) return masked;
        const std::size_t row = std::size_t(piece.extent(0));
        std::size_t from = 0;
        for (std::int64_t z = piece.begin[2]; z < piece.end[2]; ++z)
            for (std::int64_t y = piece.begin[1]; y < piece.end[1]; ++y, from += row) {
                const std::int64_t to =
                    piece.begin[0] - box.begin[0] +
                    box.extent(0) * (y - box.begin[1] + box.extent(1) * (z - box.begin[2]));
                std::copy_n(part.begin() + std::ptrdiff_t(from), row, out.begin() + std::ptrdiff_t(to));
            }
        return {};
    });
}

Result<void> LitVoxels::count() {
    box_ = {};
    voxels_ = 0;
    if (medium_.empty()) return {};
    IndexBox all;
    for (std::size_t a = 0; a < 3; ++a) {
        all.begin[a] = floorShift(medium_.begin[a], level_) - 1;
        all.end[a] = ceilShift(medium_.end[a] - 1, level_) + 2;
    }
    std::vector<std::uint8_t> part;
    const std::int64_t edge = std::max<std::int64_t>(1, kPieceSamples >> level_);
    return forEachPiece(all, edge, [&](const IndexBox& piece) -> Result<void> {
        if (!anyIn(piece)) return {};
        if (Result<void> masked = maskPiece(piece, part); !masked) return masked;
        std::size_t at = 0;
        for (std::int64_t z = piece.begin[2]; z < piece.end[2]; ++z)
            for (std::int64_t y = piece.begin[1]; y < piece.end[1]; ++y)
                for (std::int64_t x = piece.begin[0]; x < piece.end[0]; ++x, ++at) {
                    if (!part[at]) continue;
                    const Index3 p{x, y, z};
                    for (std::size_t a = 0; a < 3; ++a) {
                        box_.begin[a] = voxels_ ? std::min(box_.begin[a], p[a]) : p[a];
                        box_.end[a] = voxels_ ? std::max(box_.end[a], p[a] + 1) : p[a] + 1;
                    }
                    ++voxels_;
                }
        return {};
    });
}

}  // namespace brickyard

#include "tools/field_walk.h"

#include <cmath>
#include <cstring>

namespace brickyard {
namespace {

// Every position that an int32 lattice and its coarser levels have, and room for one brick more.
constexpr std::int64_t kFar = std::int64_t(1) << 40;
constexpr IndexBox kEverywhere{{-kFar, -kFar, -kFar}, {kFar, kFar, kFar}};

class LevelWalk {
public:
    LevelWalk(const FieldReader& reader, int level, const IndexBox& box, VoxelSink& sink)
        : reader_(reader),
          level_(level),
          box_(intersect(box, kEverywhere)),
          sink_(sink),
          background_(walkedBackground(reader, level)) {}

    Result<void> visit(const FieldNode& node) {
        const IndexBox region = levelBox(reader_.ownedRegion(node.key), level_);
        const IndexBox part = intersect(region, box_);
        if (part.empty()) return {};
        if (!node.isLeaf() && node.key.level > level_) {
            for (int octant = 0; octant < 8; ++octant) {
                if (!(node.validMask() >> octant & 1)) continue;
                const auto child = reader_.child(node, octant);
                if (!child) return tl::unexpected(child.error());
                if (auto visited = visit(*child); !visited) return visited;
            }
            return {};
        }
        if (!node.record().hasBrick()) {
            fillConstant(node, part);
            return {};
        }
        return visitBricks(node, region, part);
    }

private:
    void fillConstant(const FieldNode& node, const IndexBox& part) {
        const std::span<const ValueBits> stored = node.tree->constant(node.node);
        if (level_ == 0) {
            sink_.fill(part, stored, node.record().active);
            return;
        }
        std::vector<ValueBits> value(background_.size());
        for (std::size_t c = 0; c < value.size(); ++c)
            value[c] = fromDouble(SampleType::kFloat32, double(toFloat(reader_.type(), stored[c])));
        sink_.fill(part, value, value != background_);
    }

    // A coarse leaf stands for all the bricks below it.
    Result<void> visitBricks(const FieldNode& node, const IndexBox& region, const IndexBox& part) {
        const std::int64_t edge = reader_.shape().edge_cells;
        const auto first = [&](std::size_t a) {
            return region.begin[a] + (part.begin[a] - region.begin[a]) / edge * edge;
        };
        SampleBlock block;
        for (std::int64_t z = first(2); z < part.end[2]; z += edge)
            for (std::int64_t y = first(1); y < part.end[1]; y += edge)
                for (std::int64_t x = first(0); x < part.end[0]; x += edge) {
                    const IndexBox box = intersect({{x, y, z}, {x + edge, y + edge, z + edge}}, region);
                    auto read = level_ == 0 ? reader_.read(box, block) : interpolate(node, box, block);
                    if (!read) return read;
                    sink_.copy(box, intersect(box, part), block.values, block.active);
                }
        return {};
    }

    Result<void> interpolate(const FieldNode& node, const IndexBox& box, SampleBlock& out) {
        const auto brick = reader_.brick(node);
        if (!brick) return tl::unexpected(brick.error());
        const std::size_t components = background_.size(), nx = std::size_t(box.extent(0)),
                          ny = std::size_t(box.extent(1)), count = nx * ny * std::size_t(box.extent(2));
        out.values.resize(components * count * sizeof(float));
        out.active.assign(count, 0);
        const double spacing = std::ldexp(1.0, level_);
        for (std::size_t i = 0; i < count; ++i) {
            const glm::dvec3 at(double(box.begin[0]) + double(i % nx),
                                double(box.begin[1]) + double(i / nx % ny),
                                double(box.begin[2]) + double(i / nx / ny));
            const auto value = reader_.interpolate(node, **brick, at * spacing);
            for (std::size_t c = 0; c < components; ++c) {
                const float rounded =
                    toFloat(SampleType::kFloat64, fromDouble(SampleType::kFloat64, value[c]));
                std::memcpy(out.values.data() + (c * count + i) * sizeof rounded, &rounded, sizeof rounded);
                // Compared as numbers: +0 and -0 are one background.
                if (double(rounded) != toDouble(SampleType::kFloat32, background_[c])) out.active[i] = 1;
            }
        }
        return {};
    }

    const FieldReader& reader_;
    int level_;
    IndexBox box_;
    VoxelSink& sink_;
    std::vector<ValueBits> background_;
};

class DenseSink final : public VoxelSink {
public:
    DenseSink(const IndexBox& box, SampleType type, std::span<const ValueBits> background, SampleBlock& out)
        : box_(box), bytes_(sampleBytes(type)), out_(out) {
        count_ = std::size_t(box.extent(0)) * std::size_t(box.extent(1)) * std::size_t(box.extent(2));
        out.values.resize(count_ * bytes_ * background.size());
        out.active.resize(count_);
        fill(box, background, false);
    }

    void fill(const IndexBox& whole, std::span<const ValueBits> value, bool active) override {
        forEachRow(intersect(whole, box_), [&](std::size_t to, std::size_t row, std::int64_t, std::int64_t) {
            std::fill_n(out_.active.begin() + std::ptrdiff_t(to), row, std::uint8_t(active));
            for (std::size_t c = 0; c < value.size(); ++c)
                for (std::size_t i = 0; i < row; ++i)
                    std::memcpy(out_.values.data() + (c * count_ + to + i) * bytes_, &value[c], bytes_);
        });
    }

    void copy(const IndexBox& box, const IndexBox& part, std::span<const std::byte> values,
              std::span<const std::uint8_t> active) override {
        const IndexBox wanted = intersect(part, box_);
        const std::size_t nx = std::size_t(box.extent(0)), ny = std::size_t(box.extent(1));
        const std::size_t components = values.size() / bytes_ / active.size();
        forEachRow(wanted, [&](std::size_t to, std::size_t row, std::int64_t y, std::int64_t z) {
            const std::size_t from =
                std::size_t(wanted.begin[0] - box.begin[0]) +
                nx * (std::size_t(y - box.begin[1]) + ny * std::size_t(z - box.begin[2]));
            std::memcpy(out_.active.data() + to, active.data() + from, row);
            for (std::size_t c = 0; c < components; ++c)
                std::memcpy(out_.values.data() + (c * count_ + to) * bytes_,
                            values.data() + (c * active.size() + from) * bytes_, row * bytes_);
        });
    }

private:
    template <class Body>
    void forEachRow(const IndexBox& part, const Body& body) const {
        if (part.empty()) return;
        const std::size_t nx = std::size_t(box_.extent(0)), ny = std::size_t(box_.extent(1));
        for (std::int64_t z = part.begin[2]; z < part.end[2]; ++z)
            for (std::int64_t y = part.begin[1]; y < part.end[1]; ++y)
                body(std::size_t(part.begin[0] - box_.begin[0]) +
                         nx * (std::size_t(y - box_.begin[1]) + ny * std::size_t(z - box_.begin[2])),
                     std::size_t(part.extent(0)), y, z);
    }

    IndexBox box_;
    std::size_t bytes_, count_ = 0;
    SampleBlock& out_;
};

}  // namespace

SampleType walkedType(SampleType type, int level) { return level == 0 ? type : SampleType::kFloat32; }

std::vector<ValueBits> walkedBackground(const FieldReader& reader, int level) {
    std::vector<ValueBits> background(reader.background().begin(), reader.background().end());
    if (level > 0)
        for (ValueBits& bits : background)
            bits = fromDouble(SampleType::kFloat32, double(toFloat(reader.type(), bits)));
    return background;
}

IndexBox levelBox(const IndexBox& finest, int level) {
    const std::int64_t spacing = std::int64_t(1) << level;
    IndexBox coarse;
    for (std::size_t a = 0; a < 3; ++a) {
        // Shifting down rounds towards minus infinity: the first position at or above, and behind the last
        // below.
        coarse.begin[a] = (finest.begin[a] + spacing - 1) >> level;
        coarse.end[a] = (finest.end[a] + spacing - 1) >> level;
    }
    return coarse;
}

Result<void> walkField(const FieldReader& reader, int level, const IndexBox& box, VoxelSink& sink) {
    const auto roots = reader.roots();
    if (!roots) return tl::unexpected(roots.error());
    LevelWalk walk(reader, level, box, sink);
    for (const FieldNode& root : *roots)
        if (auto visited = walk.visit(root); !visited) return visited;
    return {};
}

Result<void> readLevel(const FieldReader& reader, int level, const IndexBox& box, SampleBlock& out) {
    DenseSink sink(box, walkedType(reader.type(), level), walkedBackground(reader, level), out);
    return walkField(reader, level, box, sink);
}

}  // namespace brickyard

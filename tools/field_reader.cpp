#include "tools/field_reader.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstring>

#include "core/printable_name.h"

namespace brickyard {
namespace {

void storeBits(SampleType type, ValueBits bits, std::byte* out) {
    std::memcpy(out, &bits, sampleBytes(type));
}

}  // namespace

ValueBits sampleBits(SampleType type, std::span<const std::byte> values, std::size_t at) {
    ValueBits bits = 0;
    std::memcpy(&bits, values.data() + at * sampleBytes(type), sampleBytes(type));
    return bits;
}

FieldReader::FieldReader(std::shared_ptr<const BrickStore> store, std::uint32_t channel,
                         std::size_t cache_bytes)
    : store_(std::move(store)), channel_(channel), cache_bytes_(cache_bytes) {
    const ChannelFooter& footer = this->channel();
    // An open store has checked the transform.
    index_to_world_ =
        *Affine::fromColumns({footer.index_to_world().data(), std::size_t(footer.index_to_world_size())});
    background_.assign(footer.background().begin(), footer.background().end());
}

std::string FieldReader::describe(const NodeKey& key) const {
    return fmt::format("channel '{}', node {}", printableName(channel().name()), toString(key));
}

IndexBox FieldReader::ownedRegion(const NodeKey& key) const {
    const std::int64_t edge = std::int64_t(shape().edge_cells) << key.level;
    return {{key.x * edge, key.y * edge, key.z * edge},
            {(key.x + 1) * edge, (key.y + 1) * edge, (key.z + 1) * edge}};
}

Result<std::shared_ptr<const TreeBlock>> FieldReader::loadBlock(std::uint32_t block) const {
    {
        const std::lock_guard lock(mutex_);
        if (const auto found = blocks_.find(block); found != blocks_.end()) return found->second;
    }
    auto loaded = store_->loadBlock(channel_, block);
    if (!loaded) return tl::unexpected(loaded.error());
    auto shared = std::make_shared<const TreeBlock>(std::move(*loaded));
    const std::lock_guard lock(mutex_);
    return blocks_.emplace(block, std::move(shared)).first->second;
}

Result<std::vector<FieldNode>> FieldReader::roots() const {
    std::vector<FieldNode> nodes;
    for (int i = 0; i < channel().roots_size(); ++i) {
        auto tree = loadBlock(0);
        if (!tree) return tl::unexpected(tree.error());
        if (std::uint32_t(i) >= (*tree)->headNodes())
            return fail(ErrorCode::kCorrupt,
                        fmt::format("{}: channel '{}' has {} roots, its tree only {}; convert this "
                                    "frame again",
                                    store_->path().string(), printableName(channel().name()),
                                    channel().roots_size(), (*tree)->headNodes()));
        const RootNode& root = channel().roots(i);
        nodes.push_back(
            {{std::int32_t(root.level()), root.x(), root.y(), root.z()}, *tree, 0, std::uint32_t(i)});
    }
    return nodes;
}

Result<FieldNode> FieldReader::child(const FieldNode& parent, int octant) const {
    assert(parent.validMask() >> octant & 1);
    const auto corrupt = [&](const char* what) {
        return fail(ErrorCode::kCorrupt, fmt::format("{}: {} {}; convert this frame again",
                                                     store_->path().string(), describe(parent.key), what));
    };
    if (parent.key.level == 0) return corrupt("has children below level 0");
    const ChildrenRef ref = parent.tree->children(parent.node);
    auto tree = ref.block == parent.block ? Result<std::shared_ptr<const TreeBlock>>(parent.tree)
                                          : loadBlock(ref.block);
    if (!tree) return tl::unexpected(tree.error());
    // Children stand in octant order of the valid mask.
    const unsigned before = unsigned(parent.validMask()) & ((1u << octant) - 1);
    const std::uint32_t node = ref.first + std::uint32_t(std::popcount(before));
    if (node >= (*tree)->nodeCount()) return corrupt("has children past the end of their tree block");
    return FieldNode{parent.key.child(octant), *tree, ref.block, node};
}

Result<std::optional<FieldNode>> FieldReader::find(const Index3& position, int level) const {
    auto nodes = roots();
    if (!nodes) return tl::unexpected(nodes.error());
    for (FieldNode& root : *nodes) {
        if (!ownedRegion(root.key).contains(position)) continue;
        FieldNode node = std::move(root);
        while (node.key.level > level && !node.isLeaf()) {
            const std::int64_t half = std::int64_t(shape().edge_cells) << (node.key.level - 1);
            const IndexBox region = ownedRegion(node.key);
            int octant = 0;
            for (std::size_t a = 0; a < 3; ++a)
                if (position[a] >= region.begin[a] + half) octant |= 1 << a;
            if (!(node.validMask() >> octant & 1)) return std::nullopt;
            auto next = child(node, octant);
            if (!next) return tl::unexpected(next.error());
            node = std::move(*next);
        }
        return node;
    }
    return std::nullopt;
}

Result<std::shared_ptr<const DecodedBrick>> FieldReader::brick(const FieldNode& node) const {
    const PageAddress page{channel_, node.block, node.node};
    {
        const std::lock_guard lock(mutex_);
        if (const auto found = index_.find(page); found != index_.end()) {
            bricks_.splice(bricks_.begin(), bricks_, found->second);
            return found->second->brick;
        }
    }
    const auto payload = store_->readPayload(node.record(), describe(node.key));
    if (!payload) return tl::unexpected(payload.error());
    // Only level 0 has states, and codes them against the background.
    static constexpr std::array<ValueBits, 3> kZero{};
    const std::span<const ValueBits> background =
        node.key.level == 0 ? std::span<const ValueBits>(background_)
                            : std::span<const ValueBits>(kZero).first(background_.size());
    auto decoded =
        decodeBrick(*payload, shape(), levelType(type(), node.key.level), components(), background);
    if (!decoded)
        return fail(
            decoded.error().code,
            fmt::format("{}: {}, bytes [{}, {}): {}; convert this frame again", store_->path().string(),
                        describe(node.key), node.record().payload_offset,
                        node.record().payload_offset + node.record().payload_bytes, decoded.error().message));
    auto shared = std::make_shared<const DecodedBrick>(std::move(*decoded));
    const std::size_t bytes = shared->values.size() + shared->active.size();
    const std::lock_guard lock(mutex_);
    if (!index_.contains(page)) {
        bricks_.push_front({page, shared});
        index_[page] = bricks_.begin();
        used_bytes_ += bytes;
        while (used_bytes_ > cache_bytes_ && bricks_.size() > 1) {
            const CachedBrick& oldest = bricks_.back();
            used_bytes_ -= oldest.brick->values.size() + oldest.brick->active.size();
            index_.erase(oldest.page);
            bricks_.pop_back();
        }
    }
    return shared;
}

std::array<double, 3> FieldReader::interpolate(const FieldNode& node, const DecodedBrick& decoded,
                                               const glm::dvec3& index) const {
    const IndexBox region = ownedRegion(node.key);
    const BrickShape n = shape();
    const double per_voxel = std::ldexp(1.0, -node.key.level);
    std::array<int, 3> corner{};
    std::array<double, 3> t{};
    for (std::size_t a = 0; a < 3; ++a) {
        // Scaling by a power of two and taking the fraction are exact; a subtraction of the brick's origin
        // would not be.
        const double at = index[int(a)] * per_voxel, first = double(region.begin[a]) * per_voxel;
        const double cell = std::clamp(std::floor(at), first, first + n.edge_cells - 1);
        corner[a] = int(cell - first);
        t[a] = at - cell;
    }
    std::array<double, 3> result{};
    for (int c = 0; c < components(); ++c) {
        const auto at = [&](int i, int j, int k) {
            return toDouble(decoded.type,
                            sampleBits(decoded.type, decoded.values,
                                       std::size_t(c) * n.samples() +
                                           n.sampleAt(corner[0] + i, corner[1] + j, corner[2] + k)));
        };
        // a * (1 - t) + b * t, not a + (b - a) * t: exact at both ends, and no overflow between 1e308 and
        // -1e308.
        const auto mix = [](double a, double b, double w) { return a * (1 - w) + b * w; };
        const auto row = [&](int j, int k) { return mix(at(0, j, k), at(1, j, k), t[0]); };
        const auto face = [&](int k) { return mix(row(0, k), row(1, k), t[1]); };
        result[std::size_t(c)] = mix(face(0), face(1), t[2]);
    }
    return result;
}

Result<std::array<double, 3>> FieldReader::sample(const glm::dvec3& index, int level) const {
    std::array<double, 3> result{};
    const auto constant = [&](std::span<const ValueBits> value) {
        for (std::size_t c = 0; c < value.size(); ++c) result[c] = toDouble(type(), value[c]);
        return result;
    };
    Index3 position{};
    for (std::size_t a = 0; a < 3; ++a) {
        const double at = std::floor(index[int(a)]);
        if (!(std::abs(at) < 0x1p34)) return constant(background_);
        position[a] = std::int64_t(at);
    }
    const auto node = find(position, level);
    if (!node) return tl::unexpected(node.error());
    if (!*node) return constant(background_);
    if (!(*node)->record().hasBrick()) return constant((*node)->tree->constant((*node)->node));
    const auto decoded = brick(**node);
    if (!decoded) return tl::unexpected(decoded.error());
    return interpolate(**node, **decoded, index);
}

void FieldReader::fill(const IndexBox& box, const IndexBox& part, std::span<const ValueBits> value,
                       bool active, SampleBlock& out) const {
    const std::size_t bytes = sampleBytes(type());
    const std::size_t nx = std::size_t(box.extent(0)), ny = std::size_t(box.extent(1)),
                      nz = std::size_t(box.extent(2));
    for (std::int64_t z = part.begin[2]; z < part.end[2]; ++z)
        for (std::int64_t y = part.begin[1]; y < part.end[1]; ++y) {
            const std::size_t at = std::size_t(part.begin[0] - box.begin[0]) +
                                   nx * (std::size_t(y - box.begin[1]) + ny * std::size_t(z - box.begin[2]));
            const std::size_t row = std::size_t(part.extent(0));
            std::fill_n(out.active.begin() + std::ptrdiff_t(at), row, std::uint8_t(active));
            for (std::size_t c = 0; c < value.size(); ++c)
                for (std::size_t i = 0; i < row; ++i)
                    storeBits(type(), value[c], out.values.data() + (c * nx * ny * nz + at + i) * bytes);
        }
}

Result<void> FieldReader::read(const IndexBox& box, SampleBlock& out) const {
    const std::size_t samples =
        std::size_t(box.extent(0)) * std::size_t(box.extent(1)) * std::size_t(box.extent(2));
    out.values.resize(samples * sampleBytes(type()) * std::size_t(components()));
    out.active.resize(samples);
    fill(box, box, background_, false, out);
    const auto nodes = roots();
    if (!nodes) return tl::unexpected(nodes.error());
    for (const FieldNode& root : *nodes)
        if (auto read = readNode(root, box, out); !read) return read;
    return {};
}

Result<void> FieldReader::readNode(const FieldNode& node, const IndexBox& box, SampleBlock& out) const {
    const IndexBox region = ownedRegion(node.key);
    const IndexBox part = intersect(box, region);
    if (part.empty()) return {};
    if (!node.isLeaf()) {
        for (int octant = 0; octant < 8; ++octant) {
            if (!(node.validMask() >> octant & 1)) continue;
            if (intersect(box, ownedRegion(node.key.child(octant))).empty()) continue;
            const auto next = child(node, octant);
            if (!next) return tl::unexpected(next.error());
            if (auto read = readNode(*next, box, out); !read) return read;
        }
        return {};
    }
    if (!node.record().hasBrick()) {
        fill(box, part, node.tree->constant(node.node), node.record().active, out);
        return {};
    }

    const auto decoded = brick(node);
    if (!decoded) return tl::unexpected(decoded.error());
    const DecodedBrick& values = **decoded;
    const BrickShape n = shape();
    const std::size_t bytes = sampleBytes(type());
    const std::size_t nx = std::size_t(box.extent(0)), ny = std::size_t(box.extent(1)),
                      nz = std::size_t(box.extent(2));
    for (std::int64_t z = part.begin[2]; z < part.end[2]; ++z)
        for (std::int64_t y = part.begin[1]; y < part.end[1]; ++y)
            for (std::int64_t x = part.begin[0]; x < part.end[0]; ++x) {
                const std::size_t at =
                    std::size_t(x - box.begin[0]) +
                    nx * (std::size_t(y - box.begin[1]) + ny * std::size_t(z - box.begin[2]));
                std::byte* const to = out.values.data() + at * bytes;
                if (node.key.level > 0) {
                    const auto value = interpolate(node, values, glm::dvec3(double(x), double(y), double(z)));
                    for (std::size_t c = 0; c < std::size_t(components()); ++c)
                        storeBits(type(), fromDouble(type(), value[c]), to + c * nx * ny * nz * bytes);
                    out.active[at] = node.record().active;
                    continue;
                }
                const int i = int(x - region.begin[0]), j = int(y - region.begin[1]),
                          k = int(z - region.begin[2]);
                for (std::size_t c = 0; c < std::size_t(components()); ++c)
                    std::memcpy(to + c * nx * ny * nz * bytes,
                                values.values.data() + (c * n.samples() + n.sampleAt(i, j, k)) * bytes,
                                bytes);
                out.active[at] =
                    values.active.empty() ? node.record().active : values.active[n.cellAt(i, j, k)];
            }
    return {};
}

Result<std::uint32_t> findChannel(const BrickStore& store, const std::string& name) {
    std::string names;
    for (int i = 0; i < store.footer().channels_size(); ++i) {
        const std::string& other = store.footer().channels(i).name();
        if (other == name) return std::uint32_t(i);
        // The list is for a person: a few hundred names help nobody.
        if (names.size() < 200) names += fmt::format("{}{}", names.empty() ? "" : ", ", printableName(other));
    }
    return fail(ErrorCode::kNotFound, fmt::format("{}: has no channel '{}'; it has {}", store.path().string(),
                                                  printableName(name), names));
}

}  // namespace brickyard

// One OpenVDB tree as a FieldSource. Only openvdb_source.cpp includes this.
#pragma once

#include <openvdb/openvdb.h>
#include <openvdb/tools/Interpolation.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <vector>

#include "tools/importers/openvdb_source.h"

namespace brickyard {

// How a grid's value is split into our components.
template <class T>
struct VdbValue {
    using Component = T;
    static constexpr int kComponents = 1;
    static T component(const T& value, int) { return value; }
};
template <class T>
struct VdbValue<openvdb::math::Vec3<T>> {
    using Component = T;
    static constexpr int kComponents = 3;
    static T component(const openvdb::math::Vec3<T>& value, int c) { return value[c]; }
};

template <class T>
constexpr SampleType vdbSampleType() {
    if constexpr (std::is_same_v<T, float>) return SampleType::kFloat32;
    if constexpr (std::is_same_v<T, double>) return SampleType::kFloat64;
    if constexpr (std::is_same_v<T, std::int32_t>) return SampleType::kInt32;
    if constexpr (std::is_same_v<T, std::int64_t>) return SampleType::kInt64;
    if constexpr (std::is_same_v<T, bool>) return SampleType::kBool;
}

template <class T>
ValueBits vdbBits(T value) {
    if constexpr (std::is_same_v<T, bool>)
        return value ? 1 : 0;
    else if constexpr (sizeof(T) == 4)
        return std::bit_cast<std::uint32_t>(value);
    else
        return std::bit_cast<std::uint64_t>(value);
}

template <class GridT>
class TreeField final : public VdbField {
    using Tree = typename GridT::TreeType;
    using Leaf = typename Tree::LeafNodeType;
    using RootChild = typename Tree::RootNodeType::ChildNodeType;
    using Value = typename Tree::ValueType;
    using Traits = VdbValue<Value>;
    using Component = typename Traits::Component;
    using Coord = openvdb::Coord;
    using CoordBox = openvdb::CoordBBox;
    static constexpr int kComponents = Traits::kComponents;

public:
    // `info` has everything but what is found in the tree here: background, active box and active voxels.
    // Errors: kCorrupt (a tree that OpenVDB could not address either).
    static Result<std::unique_ptr<VdbField>> create(typename GridT::ConstPtr grid, ChannelInfo info) {
        auto field = std::unique_ptr<TreeField>(new TreeField(std::move(grid), std::move(info)));
        const Tree& tree = field->grid_->tree();
        for (auto it = tree.root().cbeginChildOn(); it; ++it)
            field->entries_.push_back({it.getCoord(), &*it, Value(), false});
        for (auto it = tree.root().cbeginValueAll(); it; ++it)
            field->entries_.push_back({it.getCoord(), nullptr, *it, it.isValueOn()});
        std::sort(field->entries_.begin(), field->entries_.end(),
                  [](const RootEntry& a, const RootEntry& b) { return a.origin < b.origin; });
        // A position finds its entry by masking: an entry anywhere else would be counted, but never found.
        for (const RootEntry& entry : field->entries_)
            if ((entry.origin & ~(std::int32_t(RootChild::DIM) - 1)) != entry.origin)
                return fail(ErrorCode::kCorrupt, "its tree has a branch at an impossible position");
        field->measure();
        return field;
    }

    const ChannelInfo& info() const override { return info_; }

    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override {
        Uniformity found;
        const IndexBox inside = intersect(box, kInt32Box);
        if (inside != box && !found.add(background_, false)) return std::nullopt;
        if (!inside.empty() && !rootUniform(toCoords(inside), found)) return std::nullopt;
        if (!found.any) found.add(background_, false);
        UniformRegion region;
        for (int c = 0; c < kComponents; ++c)
            region.value.push_back(vdbBits(Traits::component(found.value, c)));
        region.active = found.active;
        return region;
    }

    Result<void> read(const IndexBox& box, SampleBlock& out) const override {
        Window window{
            box, std::size_t(box.extent(0)), std::size_t(box.extent(1)), std::size_t(box.extent(2)), {}, {}};
        const std::size_t samples = window.nx * window.ny * window.nz;
        out.values.resize(samples * sizeof(Component) * std::size_t(kComponents));
        out.active.resize(samples);
        for (int c = 0; c < kComponents; ++c)
            window.values[std::size_t(c)] =
                reinterpret_cast<Component*>(out.values.data()) + std::size_t(c) * samples;
        window.active = out.active.data();

        const IndexBox inside = intersect(box, kInt32Box);
        if (inside != box) fillBox(window, box, background_, false);
        if (inside.empty()) return {};
        const CoordBox coords = toCoords(inside);
        openvdb::tree::ValueAccessor<const Tree, /*IsSafe=*/false> accessor(grid_->constTree());
        // Block by block of 8^3, each a leaf or of one value. 64-bit counters: the last block may end at
        // INT32_MAX.
        constexpr std::int64_t kEdge = Leaf::DIM;
        for (std::int64_t z = coords.min().z() & ~(kEdge - 1); z <= coords.max().z(); z += kEdge)
            for (std::int64_t y = coords.min().y() & ~(kEdge - 1); y <= coords.max().y(); y += kEdge)
                for (std::int64_t x = coords.min().x() & ~(kEdge - 1); x <= coords.max().x(); x += kEdge) {
                    const Coord origin{std::int32_t(x), std::int32_t(y), std::int32_t(z)};
                    const IndexBox part = intersect(inside, {{x, y, z}, {x + kEdge, y + kEdge, z + kEdge}});
                    if (const Leaf* leaf = accessor.probeConstLeaf(origin)) {
                        copyLeaf(window, part, *leaf, origin);
                    } else {
                        Value value = background_;
                        const bool active = accessor.probeValue(origin, value);
                        fillBox(window, part, value, active);
                    }
                }
        return {};
    }

    std::optional<std::array<double, 3>> boxSample(const glm::dvec3& index) const override {
        if constexpr (!std::is_floating_point_v<Component>) {
            return std::nullopt;
        } else {
            for (int axis = 0; axis < 3; ++axis)
                if (!(std::abs(index[axis]) < double(std::numeric_limits<std::int32_t>::max()) - 2))
                    return std::nullopt;
            openvdb::tree::ValueAccessor<const Tree, /*IsSafe=*/false> accessor(grid_->constTree());
            const Value value =
                openvdb::tools::BoxSampler::sample(accessor, openvdb::Vec3R(index.x, index.y, index.z));
            std::array<double, 3> result{};
            for (int c = 0; c < kComponents; ++c)
                result[std::size_t(c)] = double(Traits::component(value, c));
            return result;
        }
    }

private:
    struct RootEntry {
        Coord origin;
        const RootChild* child;  // null: one value
        Value value;
        bool active;
    };
    struct Uniformity {
        bool any = false, active = false;
        Value value{};
        // False once two samples differ, in a single bit or in state.
        bool add(const Value& other, bool other_active) {
            if (!any) {
                any = true;
                value = other;
                active = other_active;
                return true;
            }
            return active == other_active && sameBits(value, other);
        }
    };
    // The output of read(): where each sample of `box` goes.
    struct Window {
        IndexBox box;
        std::size_t nx, ny, nz;
        std::array<Component*, 3> values;
        std::uint8_t* active;
        std::size_t at(std::int64_t x, std::int64_t y, std::int64_t z) const {
            return std::size_t(x - box.begin[0]) +
                   nx * (std::size_t(y - box.begin[1]) + ny * std::size_t(z - box.begin[2]));
        }
    };

    static constexpr std::int64_t kMin = std::numeric_limits<std::int32_t>::min();
    static constexpr std::int64_t kEnd = std::int64_t(std::numeric_limits<std::int32_t>::max()) + 1;
    static constexpr IndexBox kInt32Box{{kMin, kMin, kMin}, {kEnd, kEnd, kEnd}};

    TreeField(typename GridT::ConstPtr grid, ChannelInfo info)
        : grid_(std::move(grid)), info_(std::move(info)), background_(grid_->background()) {
        info_.type = vdbSampleType<Component>();
        info_.components = kComponents;
        info_.background.clear();
        for (int c = 0; c < kComponents; ++c)
            info_.background.push_back(vdbBits(Traits::component(background_, c)));
    }

    static bool sameBits(const Value& a, const Value& b) {
        for (int c = 0; c < kComponents; ++c)
            if (vdbBits(Traits::component(a, c)) != vdbBits(Traits::component(b, c))) return false;
        return true;
    }

    // REQUIRES: not empty and inside int32. CoordBBox is inclusive.
    static CoordBox toCoords(const IndexBox& box) {
        return {
            Coord(std::int32_t(box.begin[0]), std::int32_t(box.begin[1]), std::int32_t(box.begin[2])),
            Coord(std::int32_t(box.end[0] - 1), std::int32_t(box.end[1] - 1), std::int32_t(box.end[2] - 1))};
    }

    static CoordBox regionOf(const Coord& origin, std::int32_t edge) {
        return {origin, origin.offsetBy(edge - 1)};
    }
    static CoordBox overlap(const CoordBox& a, const CoordBox& b) {
        return {Coord::maxComponent(a.min(), b.min()), Coord::minComponent(a.max(), b.max())};
    }

    bool entryUniform(const RootEntry& entry, const CoordBox& box, Uniformity& found) const {
        const CoordBox part = overlap(box, regionOf(entry.origin, std::int32_t(RootChild::DIM)));
        if (part.empty()) return true;
        return entry.child ? nodeUniform(*entry.child, entry.origin, part, found)
                           : found.add(entry.value, entry.active);
    }

    bool rootUniform(const CoordBox& box, Uniformity& found) const {
        // Positions of the root's table that the box touches: at most 2^20 per axis.
        constexpr int kLog2Edge = int(RootChild::TOTAL);
        std::array<std::int64_t, 3> first{}, last{};
        std::uint64_t positions = 1;
        for (int axis = 0; axis < 3; ++axis) {
            const std::size_t a = std::size_t(axis);
            first[a] = std::int64_t(box.min()[axis]) >> kLog2Edge;
            last[a] = std::int64_t(box.max()[axis]) >> kLog2Edge;
            positions *= std::uint64_t(last[a] - first[a] + 1);
        }
        std::uint64_t present = 0;
        if (positions > entries_.size()) {
            for (const RootEntry& entry : entries_) {
                if (!box.hasOverlap(regionOf(entry.origin, std::int32_t(RootChild::DIM)))) continue;
                ++present;
                if (!entryUniform(entry, box, found)) return false;
            }
        } else {
            for (std::int64_t x = first[0]; x <= last[0]; ++x)
                for (std::int64_t y = first[1]; y <= last[1]; ++y)
                    for (std::int64_t z = first[2]; z <= last[2]; ++z) {
                        constexpr std::int64_t kEdge = std::int64_t(1) << kLog2Edge;
                        const Coord origin{std::int32_t(x * kEdge), std::int32_t(y * kEdge),
                                           std::int32_t(z * kEdge)};
                        const auto at = std::lower_bound(
                            entries_.begin(), entries_.end(), origin,
                            [](const RootEntry& entry, const Coord& key) { return entry.origin < key; });
                        if (at == entries_.end() || at->origin != origin) continue;
                        ++present;
                        if (!entryUniform(*at, box, found)) return false;
                    }
        }
        return present == positions || found.add(background_, false);
    }

    template <class Node>
    static bool nodeUniform(const Node& node, const Coord& origin, const CoordBox& box, Uniformity& found) {
        constexpr std::int32_t kLog2Child = std::int32_t(Node::ChildNodeType::TOTAL);
        constexpr std::int32_t kLog2Slots = std::int32_t(Node::LOG2DIM);
        const Coord first = box.min() - origin, last = box.max() - origin;
        for (std::int32_t x = first.x() >> kLog2Child; x <= last.x() >> kLog2Child; ++x)
            for (std::int32_t y = first.y() >> kLog2Child; y <= last.y() >> kLog2Child; ++y)
                for (std::int32_t z = first.z() >> kLog2Child; z <= last.z() >> kLog2Child; ++z) {
                    const auto slot = openvdb::Index((x << 2 * kLog2Slots) | (y << kLog2Slots) | z);
                    if (node.isChildMaskOff(slot)) {
                        if (!found.add(node.getTable()[slot].getValue(), node.isValueMaskOn(slot)))
                            return false;
                        continue;
                    }
                    const Coord child_origin =
                        origin + Coord(x << kLog2Child, y << kLog2Child, z << kLog2Child);
                    const CoordBox part = overlap(box, regionOf(child_origin, 1 << kLog2Child));
                    if (!nodeUniform(*node.getTable()[slot].getChild(), child_origin, part, found))
                        return false;
                }
        return true;
    }

    static bool nodeUniform(const Leaf& leaf, const Coord& origin, const CoordBox& box, Uniformity& found) {
        const Coord first = box.min() - origin, last = box.max() - origin;
        for (std::int32_t x = first.x(); x <= last.x(); ++x)
            for (std::int32_t y = first.y(); y <= last.y(); ++y)
                for (std::int32_t z = first.z(); z <= last.z(); ++z) {
                    const auto n = openvdb::Index((x << 2 * Leaf::LOG2DIM) | (y << Leaf::LOG2DIM) | z);
                    if (!found.add(leaf.getValue(n), leaf.isValueOn(n))) return false;
                }
        return true;
    }

    static void fillBox(const Window& window, const IndexBox& box, const Value& value, bool active) {
        const std::size_t row = std::size_t(box.extent(0));
        for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
            for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y) {
                const std::size_t at = window.at(box.begin[0], y, z);
                for (int c = 0; c < kComponents; ++c)
                    std::fill_n(window.values[std::size_t(c)] + at, row, Traits::component(value, c));
                std::fill_n(window.active + at, row, std::uint8_t(active));
            }
    }

    static void copyLeaf(const Window& window, const IndexBox& box, const Leaf& leaf, const Coord& origin) {
        const auto x0 = openvdb::Index(box.begin[0] - origin.x());
        const std::size_t row = std::size_t(box.extent(0));
        constexpr openvdb::Index kStride = 1 << 2 * Leaf::LOG2DIM;  // leaves run z fastest, bricks x
        for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
            for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y) {
                const std::size_t at = window.at(box.begin[0], y, z);
                openvdb::Index n = x0 * kStride + openvdb::Index((y - origin.y()) << Leaf::LOG2DIM) +
                                   openvdb::Index(z - origin.z());
                for (std::size_t i = 0; i < row; ++i, n += kStride) {
                    const auto& value = leaf.getValue(n);
                    for (int c = 0; c < kComponents; ++c)
                        window.values[std::size_t(c)][at + i] = Traits::component(value, c);
                    window.active[at + i] = leaf.isValueOn(n);
                }
            }
    }

    // Active voxels and their tight box, tiles included. Not OpenVDB's own count: that starts threads.
    void measure() {
        Extent extent;
        for (const RootEntry& entry : entries_) {
            if (entry.child)
                measureNode(*entry.child, entry.origin, extent);
            else if (entry.active)
                extent.add(entry.origin, std::int64_t(RootChild::DIM));
        }
        info_.active_voxels = extent.voxels;
        if (extent.voxels > 0) info_.active_box = {extent.begin, extent.end};
    }
    struct Extent {
        std::uint64_t voxels = 0;
        Index3 begin{kEnd, kEnd, kEnd}, end{kMin, kMin, kMin};
        void add(const Coord& origin, std::int64_t edge) {
            voxels += std::uint64_t(edge * edge * edge);
            for (std::size_t a = 0; a < 3; ++a) {
                begin[a] = std::min(begin[a], std::int64_t(origin[int(a)]));
                end[a] = std::max(end[a], std::int64_t(origin[int(a)]) + edge);
            }
        }
    };
    template <class Node>
    static void measureNode(const Node& node, const Coord& origin, Extent& extent) {
        constexpr std::int32_t kLog2Child = std::int32_t(Node::ChildNodeType::TOTAL);
        constexpr openvdb::Index kLog2Slots = Node::LOG2DIM, kMask = (1u << kLog2Slots) - 1;
        const auto originOf = [&](openvdb::Index slot) {
            return origin + Coord(std::int32_t(slot >> 2 * kLog2Slots) << kLog2Child,
                                  std::int32_t(slot >> kLog2Slots & kMask) << kLog2Child,
                                  std::int32_t(slot & kMask) << kLog2Child);
        };
        for (auto it = node.getChildMask().beginOn(); it; ++it)
            measureNode(*node.getTable()[it.pos()].getChild(), originOf(it.pos()), extent);
        for (auto it = node.getValueMask().beginOn(); it; ++it)
            if (node.isChildMaskOff(it.pos())) extent.add(originOf(it.pos()), std::int64_t(1) << kLog2Child);
    }
    static void measureNode(const Leaf& leaf, const Coord& origin, Extent& extent) {
        for (auto it = leaf.getValueMask().beginOn(); it; ++it)
            extent.add(origin + Leaf::offsetToLocalCoord(it.pos()), 1);
    }

    typename GridT::ConstPtr grid_;
    ChannelInfo info_;
    Value background_;
    std::vector<RootEntry> entries_;  // by origin
};

}  // namespace brickyard

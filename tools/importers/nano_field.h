// One NanoVDB tree as a FieldSource: checked node by node when it is made, then read leaf by leaf. Only
// nano_source.cpp includes this.
#pragma once

#include <fmt/format.h>
#include <nanovdb/NanoVDB.h>

#include <cstring>

#include "core/field_source.h"
#include "tools/importers/nano_file.h"
#include "tools/importers/nano_tree.h"
#include "tools/importers/nano_value.h"

namespace brickyard {

template <class Build>
class NanoField final : public FieldSource {
    using Value = NanoValue<Build>;
    using Component = typename Value::Component;
    using Stored = typename Value::Stored;
    static constexpr int kComponents = Value::kComponents;
    using Bits = std::array<ValueBits, std::size_t(kComponents)>;
    using Tree = NanoTree<Bits>;
    using Upper = typename Tree::Upper;
    using Lower = typename Tree::Lower;
    using NanoRoot = typename nanovdb::NanoRoot<Build>::DataType;
    using NanoUpper = typename nanovdb::NanoUpper<Build>::DataType;
    using NanoLower = typename nanovdb::NanoLower<Build>::DataType;
    using NanoLeaf = typename nanovdb::NanoLeaf<Build>::DataType;
    static constexpr bool kVariableLeaf = std::is_same_v<Build, nanovdb::FpN>;
    static constexpr bool kMask = std::is_same_v<Build, nanovdb::ValueMask>;

public:
    // Errors without file and grid: the caller knows them.
    static Result<std::unique_ptr<FieldSource>> create(NanoGridBytes bytes, ChannelInfo info,
                                                       std::uint64_t memory_bytes) {
        auto field = std::unique_ptr<NanoField>(new NanoField(std::move(bytes), std::move(info)));
        field->memory_bytes_ = memory_bytes;
        if (auto walked = field->walk(); !walked) return tl::unexpected(walked.error());
        return field;
    }

    const ChannelInfo& info() const override { return info_; }

    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override {
        Uniformity found;
        const IndexBox inside = intersect(box, kEverywhere);
        if (inside != box) found.add(tree_.background, false);
        if (!inside.empty() && !rootsUniform(inside, found)) return std::nullopt;
        if (found.differs || !found.any) return std::nullopt;
        return UniformRegion{{found.value.begin(), found.value.end()}, found.active};
    }

    Result<void> read(const IndexBox& box, SampleBlock& out) const override {
        Window window{
            box,    std::size_t(box.extent(0)), std::size_t(box.extent(1)), std::size_t(box.extent(2)), {},
            nullptr};
        const std::size_t samples = window.nx * window.ny * window.nz;
        out.values.resize(samples * sizeof(Component) * std::size_t(kComponents));
        out.active.resize(samples);
        for (int c = 0; c < kComponents; ++c)
            window.values[std::size_t(c)] = out.values.data() + std::size_t(c) * samples * sizeof(Component);
        window.active = out.active.data();
        fill(window, box, tree_.background, false);

        std::vector<WantedLeaf> wanted;
        const IndexBox inside = intersect(box, kEverywhere);
        if (!inside.empty()) {
            const Index3 first = rootOf(inside.begin);
            for (auto entry = firstRoot(first[0]);
                 entry != tree_.roots.end() && entry->origin[0] < inside.end[0]; ++entry)
                collect(*entry, inside, window, wanted);
        }
        // In the file's order, several at once where they follow each other.
        std::ranges::sort(wanted, {}, &WantedLeaf::at);
        thread_local NodeBuffer buffer;
        for (std::size_t i = 0; i < wanted.size();) {
            std::size_t count = 0;
            const std::uint64_t begin = offsetOf(wanted[i].at);
            std::uint64_t end = begin;
            while (i + count < wanted.size() && offsetOf(wanted[i + count].at) == end &&
                   end - begin < kRunBytes) {
                end += leafBytes(wanted[i + count].at);
                ++count;
            }
            const auto bytes = buffer.of(std::size_t(end - begin));
            if (auto got = grid_.read(begin, bytes); !got) return got;
            for (std::size_t k = i; k < i + count; ++k)
                copyLeaf(window, wanted[k], bytes.data() + (offsetOf(wanted[k].at) - begin));
            i += count;
        }
        return {};
    }

private:
    static constexpr IndexBox kEverywhere{{kInt32Min, kInt32Min, kInt32Min},
                                          {kInt32End, kInt32End, kInt32End}};
    static constexpr std::uint64_t kRunBytes = 256u << 10;

    struct Window {
        IndexBox box;
        std::size_t nx, ny, nz;
        std::array<std::byte*, 3> values;
        std::uint8_t* active;
        std::size_t at(std::int64_t x, std::int64_t y, std::int64_t z) const {
            return std::size_t(x - box.begin[0]) +
                   nx * (std::size_t(y - box.begin[1]) + ny * std::size_t(z - box.begin[2]));
        }
    };
    struct WantedLeaf {
        std::uint64_t at;
        Index3 origin;
        IndexBox part;
    };
    struct Uniformity {
        bool any = false, active = false, differs = false;
        Bits value{};
        bool add(const Bits& other, bool other_active) {
            if (!any) {
                any = true;
                value = other;
                active = other_active;
                return true;
            }
            differs = differs || active != other_active || value != other;
            return !differs;
        }
    };
    // Active voxels and their tight box.
    struct Extent {
        std::uint64_t voxels = 0;
        Index3 begin{kInt32End, kInt32End, kInt32End}, end{kInt32Min, kInt32Min, kInt32Min};
        void add(const IndexBox& box, std::uint64_t count) {
            voxels += count;
            for (std::size_t a = 0; a < 3; ++a) {
                begin[a] = std::min(begin[a], box.begin[a]);
                end[a] = std::max(end[a], box.end[a]);
            }
        }
        void addCube(const Index3& corner, std::int64_t edge) {
            add({corner, {corner[0] + edge, corner[1] + edge, corner[2] + edge}},
                std::uint64_t(edge * edge * edge));
        }
    };

    NanoField(NanoGridBytes bytes, ChannelInfo info) : grid_(std::move(bytes)), info_(std::move(info)) {
        info_.type = sampleTypeFor<Component>();
        info_.components = kComponents;
        if (kComponents == 3) info_.vector_type = "invariant";
        if constexpr (std::is_same_v<Build, std::int16_t>) info_.source_type = "int16";
        if constexpr (std::is_same_v<Build, std::uint32_t>) info_.source_type = "uint32";
    }

    // A value where it stands; a bool may be any byte there.
    static Bits bitsAt(const void* at) {
        Bits bits{};
        if constexpr (std::is_same_v<Stored, bool>) {
            bits[0] = *static_cast<const unsigned char*>(at) != 0;
        } else if constexpr (kComponents == 3) {
            for (std::size_t c = 0; c < 3; ++c)
                std::memcpy(&bits[c], static_cast<const std::byte*>(at) + c * sizeof(Component),
                            sizeof(Component));
        } else {
            Stored stored;
            std::memcpy(&stored, at, sizeof stored);
            const Component value = static_cast<Component>(stored);
            std::memcpy(&bits[0], &value, sizeof value);
        }
        return bits;
    }

    static std::uint64_t offsetOf(std::uint64_t leaf) { return leaf & ~std::uint64_t(kAlignment - 1); }
    // Of FpN leaves the low bits are the logarithm of the bits per value.
    static std::uint64_t leafBytes(std::uint64_t leaf) {
        if constexpr (kVariableLeaf)
            return sizeof(NanoLeaf) + (std::uint64_t(64) << (leaf & (kAlignment - 1)));
        return sizeof(NanoLeaf);
    }

    // ---- Checking, once: every offset is compared with the grid's size, every count with the bytes it
    // needs.

    static tl::unexpected<Error> corrupt(const std::string& what) {
        return fail(ErrorCode::kCorrupt, fmt::format("{}; write the file again", what));
    }

    // `base` + `offset`, where a node of `bytes` is to be.
    Result<std::uint64_t> place(std::uint64_t base, std::int64_t offset, std::uint64_t bytes,
                                const char* what) const {
        const auto at = static_cast<__int128>(base) + offset;
        if (at < 0 || at > static_cast<__int128>(grid_.size) || bytes > grid_.size - std::uint64_t(at) ||
            at % kAlignment != 0)
            return corrupt(fmt::format("has a {} {:+} bytes from byte {}, which is no place in its {}", what,
                                       offset, base, grid_.size));
        return std::uint64_t(at);
    }

    template <class Node>
    Result<const Node*> load(NodeBuffer& buffer, std::uint64_t at) const {
        const auto bytes = buffer.of(sizeof(Node));
        if (auto read = grid_.read(at, bytes); !read) return tl::unexpected(read.error());
        return reinterpret_cast<const Node*>(bytes.data());
    }

    Result<void> walk() {
        NodeBuffer buffer;
        const std::uint64_t tree_at = sizeof(nanovdb::GridData);
        if (grid_.size < tree_at + sizeof(nanovdb::TreeData<3>))
            return corrupt(fmt::format("has only {} bytes", grid_.size));
        const auto tree = load<nanovdb::TreeData<3>>(buffer, tree_at);
        if (!tree) return tl::unexpected(tree.error());
        // No tree has more nodes than fit: what follows is bounded by the file's size, however often a node
        // is named.
        const std::uint64_t leaf_least = sizeof(NanoLeaf);
        for (const auto& [count, bytes] : {std::pair((*tree)->mNodeCount[0], leaf_least),
                                           {(*tree)->mNodeCount[1], std::uint64_t(sizeof(NanoLower))},
                                           {(*tree)->mNodeCount[2], std::uint64_t(sizeof(NanoUpper))}})
            if (count > grid_.size / bytes)
                return corrupt(
                    fmt::format("claims {} nodes of {} bytes in its {}", count, bytes, grid_.size));
        leaf_limit_ = (*tree)->mNodeCount[0];
        lower_limit_ = (*tree)->mNodeCount[1];
        upper_limit_ = (*tree)->mNodeCount[2];
        const auto root_at = place(tree_at, std::int64_t((*tree)->mNodeOffset[3]), sizeof(NanoRoot), "root");
        if (!root_at) return tl::unexpected(root_at.error());
        if (auto read = readRoot(*root_at); !read) return read;
        if (auto checked = checkMemory(); !checked) return checked;

        Extent extent;
        for (const auto& entry : tree_.roots)
            if (entry.upper == Tree::kNoNode && entry.active) extent.addCube(entry.origin, Tree::kRootEdge);
        for (const auto& entry : tree_.roots)
            if (entry.upper != Tree::kNoNode)
                if (auto measured = measure(tree_.uppers[entry.upper], entry.origin, extent); !measured)
                    return measured;
        info_.active_voxels = extent.voxels;
        if (extent.voxels > 0) info_.active_box = {extent.begin, extent.end};
        info_.background.assign(tree_.background.begin(), tree_.background.end());
        return {};
    }

    Result<void> checkMemory() const {
        // Half: the other half is for what is read.
        if (memory_bytes_ > 0 && tree_.bytes() > memory_bytes_ / 2 && tree_.bytes() > (64u << 20))
            return fail(ErrorCode::kInvalid,
                        fmt::format("has so many nodes that their places take more than half of the {} bytes "
                                    "allowed; allow more with --memory",
                                    memory_bytes_));
        return {};
    }

    Result<void> readRoot(std::uint64_t root_at) {
        NodeBuffer buffer;
        const auto root = load<NanoRoot>(buffer, root_at);
        if (!root) return tl::unexpected(root.error());
        tree_.background = bitsAt(&(*root)->mBackground);
        using Tile = typename NanoRoot::Tile;
        const std::uint64_t count = (*root)->mTableSize;
        if (count > (grid_.size - root_at - sizeof(NanoRoot)) / sizeof(Tile))
            return corrupt(fmt::format("claims {} root tiles in its {} bytes", count, grid_.size));
        for (std::uint64_t i = 0; i < count; ++i) {
            const auto tile = load<Tile>(buffer, root_at + sizeof(NanoRoot) + i * sizeof(Tile));
            if (!tile) return tl::unexpected(tile.error());
            const nanovdb::Coord at = (*tile)->origin();
            typename Tree::RootEntry entry{
                {at[0], at[1], at[2]}, Tree::kNoNode, bitsAt(&(*tile)->value), ((*tile)->state & 1) != 0};
            if constexpr (kMask) entry.value[0] = entry.active;
            for (const std::int64_t c : entry.origin)
                if (c % Tree::kRootEdge != 0) return corrupt("has a root tile at an impossible position");
            if (const std::int64_t child = (*tile)->child; child != 0) {
                if (tree_.uppers.size() == upper_limit_) return corrupt("has more upper nodes than it says");
                const auto upper_at = place(root_at, child, sizeof(NanoUpper), "upper node");
                if (!upper_at) return tl::unexpected(upper_at.error());
                entry.upper = tree_.uppers.size();
                if (auto read = readUpper(*upper_at); !read) return read;
            }
            tree_.roots.push_back(entry);
        }
        std::ranges::sort(tree_.roots, {}, &Tree::RootEntry::origin);
        if (std::ranges::adjacent_find(tree_.roots, {}, &Tree::RootEntry::origin) != tree_.roots.end())
            return corrupt("has two root tiles at one position");
        return {};
    }

    // Masks and tiles of an inner node.
    template <class Nano, class Node>
    void copyNode(const Nano& nano, Node& node) {
        static_assert(sizeof nano.mChildMask == sizeof node.child_mask);
        std::memcpy(node.child_mask.data(), &nano.mChildMask, sizeof node.child_mask);
        std::memcpy(node.value_mask.data(), &nano.mValueMask, sizeof node.value_mask);
        for (std::uint32_t slot = 0; slot < Node::kWords * 64; ++slot) {
            if (node.hasChild(slot)) continue;
            Bits value = bitsAt(&nano.mTable[slot].value);
            if constexpr (kMask) value[0] = node.isActive(slot);
            if (value != tree_.background) node.tiles.push_back({slot, value});
        }
        node.tiles.shrink_to_fit();
        tree_.tile_bytes += node.tiles.capacity() * sizeof(typename Node::Tile);
    }
    template <class Node, class Nano, class Visit>
    static Result<void> forChildren(const Node& node, const Nano& nano, const Visit& visit) {
        for (std::uint32_t slot = 0; slot < Node::kWords * 64; ++slot)
            if (node.hasChild(slot))
                if (auto visited = visit(std::int64_t(nano.mTable[slot].child)); !visited) return visited;
        return {};
    }

    Result<void> readUpper(std::uint64_t at) {
        NodeBuffer buffer;
        const auto nano = load<NanoUpper>(buffer, at);
        if (!nano) return tl::unexpected(nano.error());
        Upper& node = tree_.uppers.emplace_back();
        copyNode(**nano, node);
        node.first_child = tree_.lowers.size();
        if (node.countChildren() > lower_limit_ - tree_.lowers.size())
            return corrupt("has more lower nodes than it says");
        return forChildren(node, **nano, [&](std::int64_t child) -> Result<void> {
            const auto lower_at = place(at, child, sizeof(NanoLower), "lower node");
            if (!lower_at) return tl::unexpected(lower_at.error());
            return readLower(*lower_at);
        });
    }

    Result<void> readLower(std::uint64_t at) {
        NodeBuffer buffer;
        const auto nano = load<NanoLower>(buffer, at);
        if (!nano) return tl::unexpected(nano.error());
        Lower& node = tree_.lowers.emplace_back();
        copyNode(**nano, node);
        node.first_child = tree_.leaves.size();
        if (node.countChildren() > leaf_limit_ - tree_.leaves.size())
            return corrupt("has more leaves than it says");
        if (tree_.lowers.size() % 1024 == 0)
            if (auto checked = checkMemory(); !checked) return checked;
        return forChildren(node, **nano, [&](std::int64_t child) -> Result<void> {
            const auto leaf_at = place(at, child, sizeof(NanoLeaf), "leaf");
            if (!leaf_at) return tl::unexpected(leaf_at.error());
            tree_.leaves.push_back(*leaf_at);
            return {};
        });
    }

    Result<void> measure(const Upper& upper, const Index3& origin, Extent& extent) {
        for (std::uint32_t slot = 0; slot < Upper::kWords * 64; ++slot) {
            const Index3 corner = Upper::cornerOf(origin, slot);
            if (upper.hasChild(slot)) {
                if (auto measured = measure(tree_.lowers[upper.childOf(slot)], corner, extent); !measured)
                    return measured;
            } else if (upper.isActive(slot)) {
                extent.addCube(corner, 128);
            }
        }
        return {};
    }

    // Leaves are read here once, for their masks: the counts that the file has might be anything.
    Result<void> measure(const Lower& lower, const Index3& origin, Extent& extent) {
        struct Place {
            std::uint64_t* leaf;
            Index3 corner;
        };
        std::vector<Place> places;
        for (std::uint32_t slot = 0; slot < Lower::kWords * 64; ++slot) {
            const Index3 corner = Lower::cornerOf(origin, slot);
            if (lower.hasChild(slot))
                places.push_back({&tree_.leaves[lower.childOf(slot)], corner});
            else if (lower.isActive(slot))
                extent.addCube(corner, 8);
        }
        // Most lie behind each other: one read for many.
        thread_local NodeBuffer buffer;
        for (std::size_t i = 0; i < places.size();) {
            const std::uint64_t begin = *places[i].leaf;
            std::uint64_t end = begin + sizeof(NanoLeaf);
            std::size_t count = 1;
            while (i + count < places.size() && *places[i + count].leaf >= begin &&
                   *places[i + count].leaf - begin < kRunBytes) {
                end = std::max(end, *places[i + count].leaf + sizeof(NanoLeaf));
                ++count;
            }
            const auto bytes = buffer.of(std::size_t(end - begin));
            if (auto got = grid_.read(begin, bytes); !got) return got;
            for (std::size_t k = i; k < i + count; ++k)
                if (auto measured = measureLeaf(*places[k].leaf, bytes.data() + (*places[k].leaf - begin),
                                                places[k].corner, extent);
                    !measured)
                    return measured;
            i += count;
        }
        return {};
    }

    Result<void> measureLeaf(std::uint64_t& leaf, const std::byte* bytes, const Index3& corner,
                             Extent& extent) {
        const auto& nano = *reinterpret_cast<const NanoLeaf*>(bytes);
        if constexpr (kVariableLeaf) {
            const unsigned log2_bits = nano.mFlags >> 5;
            if (log2_bits > 4)
                return corrupt(fmt::format("has a leaf at byte {} of 2^{} bits a value", leaf, log2_bits));
            leaf |= log2_bits;
            if (leafBytes(leaf) > grid_.size - offsetOf(leaf))
                return corrupt(fmt::format("has a leaf at byte {} that it does not hold", offsetOf(leaf)));
        }
        std::array<std::uint64_t, 8> mask;
        static_assert(sizeof nano.mValueMask == sizeof mask);
        std::memcpy(mask.data(), &nano.mValueMask, sizeof mask);
        std::uint64_t all = 0, count = 0;
        unsigned along[3] = {};
        for (std::size_t x = 0; x < 8; ++x) {
            count += std::uint64_t(std::popcount(mask[x]));
            all |= mask[x];
            along[0] |= unsigned(mask[x] != 0) << x;
        }
        if (count == 0) return {};
        for (std::size_t y = 0; y < 8; ++y) {
            const auto row = unsigned(all >> 8 * y & 255);
            along[1] |= unsigned(row != 0) << y;
            along[2] |= row;
        }
        IndexBox box;
        for (std::size_t a = 0; a < 3; ++a) {
            if ((std::int64_t(nano.mBBoxMin[int(a)]) & ~std::int64_t(7)) != corner[a])
                return corrupt(
                    fmt::format("has a leaf at byte {} that says it lies elsewhere than its parent says",
                                offsetOf(leaf)));
            box.begin[a] = corner[a] + std::countr_zero(along[a]);
            box.end[a] = corner[a] + std::bit_width(along[a]);
        }
        extent.add(box, count);
        return {};
    }

    // ---- Asking: only what was checked and copied is followed.

    static Index3 rootOf(const Index3& at) {
        return {at[0] & ~(Tree::kRootEdge - 1), at[1] & ~(Tree::kRootEdge - 1),
                at[2] & ~(Tree::kRootEdge - 1)};
    }
    auto firstRoot(std::int64_t x) const {
        return std::ranges::lower_bound(tree_.roots, Index3{x, kInt32Min, kInt32Min}, {},
                                        &Tree::RootEntry::origin);
    }
    static IndexBox rootBox(const Index3& origin) {
        return {origin,
                {origin[0] + Tree::kRootEdge, origin[1] + Tree::kRootEdge, origin[2] + Tree::kRootEdge}};
    }

    bool rootsUniform(const IndexBox& box, Uniformity& found) const {
        const Index3 first = rootOf(box.begin);
        // Whether there is anything besides the roots: by volume, in units of 2^36 voxels at most 2^60 of
        // them.
        unsigned __int128 covered = 0, volume = 1;
        for (int axis = 0; axis < 3; ++axis) volume *= std::uint64_t(box.extent(axis));
        for (auto entry = firstRoot(first[0]); entry != tree_.roots.end() && entry->origin[0] < box.end[0];
             ++entry) {
            const IndexBox part = intersect(box, rootBox(entry->origin));
            if (part.empty()) continue;
            covered += static_cast<unsigned __int128>(part.extent(0)) * std::uint64_t(part.extent(1)) *
                       std::uint64_t(part.extent(2));
            const bool same = entry->upper == Tree::kNoNode
                                  ? found.add(entry->value, entry->active)
                                  : nodeUniform(tree_.uppers[entry->upper], entry->origin, part, found);
            if (!same) return false;
        }
        return covered == volume || found.add(tree_.background, false);
    }
    template <class Node>
    bool nodeUniform(const Node& node, const Index3& origin, const IndexBox& box, Uniformity& found) const {
        return Node::visitSlots(
            origin, box, [&](std::uint32_t slot, const Index3& corner, const IndexBox& part) {
                if (!node.hasChild(slot))
                    return found.add(node.valueOf(slot, tree_.background), node.isActive(slot));
                // What a leaf holds is not known without reading it.
                if constexpr (std::is_same_v<Node, Upper>)
                    return nodeUniform(tree_.lowers[node.childOf(slot)], corner, part, found);
                return false;
            });
    }

    void collect(const typename Tree::RootEntry& entry, const IndexBox& box, const Window& window,
                 std::vector<WantedLeaf>& wanted) const {
        const IndexBox part = intersect(box, rootBox(entry.origin));
        if (part.empty()) return;
        if (entry.upper == Tree::kNoNode)
            fill(window, part, entry.value, entry.active);
        else
            collect(tree_.uppers[entry.upper], entry.origin, part, window, wanted);
    }
    template <class Node>
    void collect(const Node& node, const Index3& origin, const IndexBox& box, const Window& window,
                 std::vector<WantedLeaf>& wanted) const {
        Node::visitSlots(origin, box, [&](std::uint32_t slot, const Index3& corner, const IndexBox& part) {
            if (!node.hasChild(slot)) {
                const Bits value = node.valueOf(slot, tree_.background);
                if (value != tree_.background || node.isActive(slot))
                    fill(window, part, value, node.isActive(slot));
            } else if constexpr (std::is_same_v<Node, Upper>) {
                collect(tree_.lowers[node.childOf(slot)], corner, part, window, wanted);
            } else {
                wanted.push_back({tree_.leaves[node.childOf(slot)], corner, part});
            }
            return true;
        });
    }

    static void fill(const Window& window, const IndexBox& box, const Bits& value, bool active) {
        const std::size_t row = std::size_t(box.extent(0));
        for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
            for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y) {
                const std::size_t at = window.at(box.begin[0], y, z);
                for (std::size_t c = 0; c < std::size_t(kComponents); ++c) {
                    Component component;
                    std::memcpy(&component, &value[c], sizeof component);
                    std::fill_n(reinterpret_cast<Component*>(window.values[c]) + at, row, component);
                }
                std::fill_n(window.active + at, row, std::uint8_t(active));
            }
    }

    static void copyLeaf(const Window& window, const WantedLeaf& leaf, std::byte* bytes) {
        auto& nano = *reinterpret_cast<NanoLeaf*>(bytes);
        // As it was when its size was checked.
        if constexpr (kVariableLeaf) nano.mFlags = std::uint8_t((leaf.at & (kAlignment - 1)) << 5);
        const IndexBox& part = leaf.part;
        const auto x0 = std::uint32_t(part.begin[0] - leaf.origin[0]);
        const std::size_t row = std::size_t(part.extent(0));
        for (std::int64_t z = part.begin[2]; z < part.end[2]; ++z)
            for (std::int64_t y = part.begin[1]; y < part.end[1]; ++y) {
                const std::size_t at = window.at(part.begin[0], y, z);
                // Leaves run z fastest, blocks x.
                auto n = std::uint32_t((x0 << 6) | std::uint32_t(y - leaf.origin[1]) << 3 |
                                       std::uint32_t(z - leaf.origin[2]));
                for (std::size_t i = 0; i < row; ++i, n += 64) {
                    if constexpr (kComponents == 3) {
                        for (std::size_t c = 0; c < 3; ++c)
                            reinterpret_cast<Component*>(window.values[c])[at + i] = nano.mValues[n][int(c)];
                    } else {
                        reinterpret_cast<Component*>(window.values[0])[at + i] =
                            static_cast<Component>(nano.getValue(n));
                    }
                    window.active[at + i] = nano.mValueMask.isOn(n);
                }
            }
    }

    NanoGridBytes grid_;
    ChannelInfo info_;
    Tree tree_;
    std::uint64_t memory_bytes_ = 0;
    std::uint64_t leaf_limit_ = 0, lower_limit_ = 0, upper_limit_ = 0;
};

}  // namespace brickyard

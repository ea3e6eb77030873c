// The pass over a tree's bytes that makes a VdbTree.
#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>

#include "tools/importers/vdb_tree.h"

namespace brickyard {

class VdbTreeBuilder {
public:
    VdbTreeBuilder(const VdbBytes& file, std::uint64_t begin, std::uint64_t end, VdbCoding coding,
                   const std::string& where)
        : file_(file), cursor_(file, begin, end, VdbCursor::kLongRun), where_(where) {
        tree_.coding_ = coding;
        // What a sound file stores of tiles is about as large here; see addRuns.
        most_tile_bytes_ = (std::uint64_t(64) << 20) + 16 * file.size();
    }

    Result<VdbTree> build() {
        if (auto read = readRoot(); !read) return tl::unexpected(read.error());
        if (auto read = placeLeaves(); !read) return tl::unexpected(read.error());
        tree_.end_ = cursor_.position();
        if (tree_.active_voxels_ > 0) tree_.active_box_ = box_;
        shrink();
        return std::move(tree_);
    }

private:
    static constexpr std::size_t kLeafMaskBytes = 64;

    tl::unexpected<Error> damaged(const std::string& what) const {
        if (cursor_.error()) return tl::unexpected(*cursor_.error());
        return fail(ErrorCode::kCorrupt, fmt::format("{}: {}, at byte {}; write the file again", where_, what,
                                                     cursor_.position()));
    }
    tl::unexpected<Error> cutOff() const { return damaged("its tree is cut off or damaged"); }

    // Background, then the table: tiles, then children, each with its origin.
    Result<void> readRoot() {
        VdbCoding& coding = tree_.coding_;
        const std::size_t value_bytes = coding.type.bytes();
        cursor_.skip(4);  // a number of buffers that is 1 since 2012
        const auto background = cursor_.take(value_bytes);
        if (background.empty()) return cutOff();
        coding.setBackground(background);
        tree_.values_.assign(coding.background.begin(), coding.background.begin() + value_bytes);
        const auto tiles = cursor_.number<std::uint32_t>(), children = cursor_.number<std::uint32_t>();
        for (std::uint32_t i = 0; i < tiles; ++i) {
            VdbTree::RootEntry entry;
            entry.origin = cursor_.number<std::array<std::int32_t, 3>>();
            const auto value = cursor_.take(value_bytes);
            if (value.empty()) return cutOff();
            VdbCoding as_value = coding;  // brings a bool to 0 or 1
            as_value.setBackground(value);
            entry.value = valueNumber(as_value.background.data());
            entry.active = cursor_.number<std::uint8_t>() != 0;
            if (!cursor_.ok()) return cutOff();
            tree_.root_.push_back(entry);
            if (entry.active) addActive(originOf(entry), VdbTree::kUpperLog2);
        }
        for (std::uint32_t i = 0; i < children; ++i) {
            VdbTree::RootEntry entry;
            entry.origin = cursor_.number<std::array<std::int32_t, 3>>();
            entry.upper = std::uint32_t(tree_.uppers_.size());
            if (!cursor_.ok()) return cutOff();
            tree_.root_.push_back(entry);
            if (auto read = readUpper(originOf(entry)); !read) return read;
        }

        // A position finds its entry by masking and searching: one anywhere else, or twice, would never be
        // found.
        std::ranges::sort(tree_.root_, {}, &VdbTree::RootEntry::origin);
        for (std::size_t i = 0; i < tree_.root_.size(); ++i) {
            constexpr std::int32_t kInside = (1 << VdbTree::kUpperLog2) - 1;
            const auto& origin = tree_.root_[i].origin;
            if (((origin[0] | origin[1] | origin[2]) & kInside) != 0 ||
                (i > 0 && tree_.root_[i - 1].origin == origin))
                return damaged("its tree has a branch at an impossible position");
        }
        return {};
    }

    static Index3 originOf(const VdbTree::RootEntry& entry) {
        return {entry.origin[0], entry.origin[1], entry.origin[2]};
    }
    static Index3 childOrigin(const Index3& origin, std::size_t slot, int log2_slots, int log2_child) {
        const std::size_t inside = (std::size_t(1) << log2_slots) - 1;
        return {origin[0] + std::int64_t(slot >> 2 * log2_slots << log2_child),
                origin[1] + std::int64_t((slot >> log2_slots & inside) << log2_child),
                origin[2] + std::int64_t((slot & inside) << log2_child)};
    }

    // A node's two masks and its tiles; `children` receives the child mask. `kLog2Slots` is 5 or 4.
    template <int kLog2Slots>
    Result<void> readNode(const Index3& origin, VdbTree::Node& node, VdbTree::ChildMasks<kLog2Slots>& masks,
                          std::vector<std::uint64_t>& children) {
        constexpr std::size_t kSlots = std::size_t(1) << 3 * kLog2Slots, kWords = kSlots / 64;
        constexpr int kLog2Child = kLog2Slots == 5 ? VdbTree::kLowerLog2 : VdbTree::kLeafLog2;
        children.resize(kWords);
        active_.resize(kWords);
        for (auto* mask : {&children, &active_}) {
            const auto bytes = cursor_.take(kSlots / 8);
            if (bytes.empty()) return cutOff();
            std::memcpy(mask->data(), bytes.data(), bytes.size());
        }
        if (std::ranges::any_of(children, [](std::uint64_t word) { return word != 0; })) {
            if (masks.bits.size() / kWords >= VdbTree::kNone) return tooLarge();
            node.children = masks.add(children);
        }
        std::size_t active = 0;
        for (const std::uint64_t word : active_) active += std::size_t(std::popcount(word));

        const auto head = cursor_.peek(maxVdbValuesHead(kSlots));
        const VdbCoding& coding = tree_.coding_;
        const auto bytes = measureVdbValues(head, coding, kSlots, active);
        if (!bytes) return damaged(bytes.error().message);
        // The usual node: no active tile, and the others say nothing else than "background".
        if (active == 0 && (coding.compression & VdbCoding::kActiveMask) && head[0] == std::byte(0)) {
            cursor_.skip(*bytes);
            return cursor_.ok() ? Result<void>() : cutOff();
        }
        if (*bytes > cursor_.left()) return cutOff();
        const std::uint64_t at = cursor_.position();
        const auto stored = cursor_.take(std::size_t(*bytes));
        if (stored.empty()) return cutOff();
        values_.resize(kSlots * coding.type.bytes());
        if (auto decoded = decodeVdbValues(stored, coding, active_, values_.data(), scratch_); !decoded)
            return fail(ErrorCode::kCorrupt, fmt::format("{}: {}, at byte {}; write the file again", where_,
                                                         decoded.error().message, at));
        if (active > 0) addActiveTiles(origin, children, kLog2Slots, kLog2Child);
        return addRuns(node, children);
    }

    // values_ and active_ as runs over the slots that have no child.
    Result<void> addRuns(VdbTree::Node& node, const std::vector<std::uint64_t>& children) {
        const std::size_t value_bytes = tree_.coding_.type.bytes();
        node.first_run = std::uint32_t(tree_.runs_.size());
        const std::byte* last = nullptr;
        bool last_active = false;
        for (std::size_t word = 0; word < children.size(); ++word)
            for (std::uint64_t tiles = ~children[word]; tiles != 0; tiles &= tiles - 1) {
                const int bit = std::countr_zero(tiles);
                const std::size_t slot = 64 * word + std::size_t(bit);
                const std::byte* value = values_.data() + slot * value_bytes;
                const bool active = active_[word] >> bit & 1;
                if (last && active == last_active && std::memcmp(value, last, value_bytes) == 0) continue;
                const bool first = !last;
                last = value;
                last_active = active;
                tree_.runs_.push_back({std::uint16_t(first ? 0 : slot), active, valueNumber(value)});
            }
        node.runs = std::uint32_t(tree_.runs_.size()) - node.first_run;
        if (node.runs == 1 && !tree_.runs_.back().active && tree_.runs_.back().value == 0) {
            tree_.runs_.pop_back();
            node.runs = 0;
        }
        // Compressed tiles can be a thousandth of what they become: a hostile file would take any memory.
        if (tree_.runs_.size() * sizeof(VdbTree::Run) + tree_.values_.size() > most_tile_bytes_)
            return tooLarge();
        return {};
    }

    std::uint32_t valueNumber(const std::byte* value) {
        const std::size_t value_bytes = tree_.coding_.type.bytes();
        auto& values = tree_.values_;
        if (std::memcmp(value, values.data(), value_bytes) == 0) return 0;
        if (std::memcmp(value, values.data() + values.size() - value_bytes, value_bytes) != 0)
            values.insert(values.end(), value, value + value_bytes);
        return std::uint32_t(values.size() / value_bytes - 1);
    }

    tl::unexpected<Error> tooLarge() const {
        return fail(ErrorCode::kUnsupported,
                    fmt::format("{}: its tree has more nodes and tiles than can be read; prune it", where_));
    }

    Result<void> readUpper(const Index3& origin) {
        const std::size_t number = tree_.uppers_.size();
        tree_.uppers_.emplace_back();
        VdbTree::Node node;
        if (auto read = readNode<5>(origin, node, tree_.upper_masks_, upper_children_); !read) return read;
        node.first_child = std::uint32_t(tree_.lowers_.size());
        tree_.uppers_[number] = node;
        for (std::size_t word = 0; word < upper_children_.size(); ++word)
            for (std::uint64_t bits = upper_children_[word]; bits != 0; bits &= bits - 1) {
                const std::size_t slot = 64 * word + std::size_t(std::countr_zero(bits));
                if (auto read = readLower(childOrigin(origin, slot, 5, VdbTree::kLowerLog2)); !read)
                    return read;
            }
        return {};
    }

    // Its leaves' masks follow its tiles, one behind the other.
    Result<void> readLower(const Index3& origin) {
        VdbTree::Node node;
        if (auto read = readNode<4>(origin, node, tree_.lower_masks_, lower_children_); !read) return read;
        if (leaves_ > std::numeric_limits<std::uint32_t>::max() - 4096) return tooLarge();
        node.first_child = std::uint32_t(leaves_);
        leaf_masks_begin_.push_back(cursor_.position());
        lower_origins_.push_back({std::int32_t(origin[0]), std::int32_t(origin[1]), std::int32_t(origin[2])});
        for (std::size_t word = 0; word < lower_children_.size(); ++word)
            for (std::uint64_t bits = lower_children_[word]; bits != 0; bits &= bits - 1) {
                const auto mask = cursor_.take(kLeafMaskBytes);
                if (mask.empty()) return cutOff();
                const std::size_t slot = 64 * word + std::size_t(std::countr_zero(bits));
                addLeafActive(childOrigin(origin, slot, 4, VdbTree::kLeafLog2), mask);
                ++leaves_;
            }
        tree_.lowers_.push_back(node);
        return {};
    }

    // The leaves' records: those of the root's children in the order of their origins, whatever order the
    // topology had. A record begins with the leaf's mask once more.
    Result<void> placeLeaves() {
        tree_.leaf_ends_.resize(leaves_);
        for (const VdbTree::RootEntry& entry : tree_.root_) {
            if (entry.upper == VdbTree::kNone) continue;
            const VdbTree::Node& upper = tree_.uppers_[entry.upper];
            if (upper.children == VdbTree::kNone) continue;
            const std::uint32_t last_slot = (1u << 3 * VdbTree::kUpperSlotsLog2) - 1;
            const std::uint32_t lowers = tree_.upper_masks_.rank(upper.children, last_slot) +
                                         tree_.upper_masks_.has(upper.children, last_slot);
            for (std::uint32_t i = 0; i < lowers; ++i)
                if (auto placed = placeLeavesOf(upper.first_child + i); !placed) return placed;
        }
        return {};
    }

    Result<void> placeLeavesOf(std::uint32_t number) {
        VdbTree::Node& lower = tree_.lowers_[number];
        lower.leaves_begin = cursor_.position();
        if (lower.children == VdbTree::kNone) return {};
        const std::size_t words = VdbTree::ChildMasks<VdbTree::kLowerSlotsLog2>::kWords;
        const auto children = std::span(tree_.lower_masks_.bits).subspan(lower.children * words, words);
        std::size_t count = 0;
        for (const std::uint64_t word : children) count += std::size_t(std::popcount(word));
        masks_.resize(count * kLeafMaskBytes);
        if (auto read = file_.readAt(leaf_masks_begin_[number], masks_); !read) return read;
        const std::byte* mask = masks_.data();
        std::uint32_t leaf = lower.first_child;
        const auto& at = lower_origins_[number];
        for (std::size_t word = 0; word < words; ++word)
            for (std::uint64_t bits = children[word]; bits != 0;
                 bits &= bits - 1, mask += kLeafMaskBytes, ++leaf) {
                const std::size_t slot = 64 * word + std::size_t(std::countr_zero(bits));
                const Index3 origin = childOrigin({at[0], at[1], at[2]}, slot, 4, VdbTree::kLeafLog2);
                if (auto passed = passLeaf(origin, mask); !passed) return passed;
                tree_.leaf_ends_[leaf] = std::uint32_t(cursor_.position() - lower.leaves_begin);
            }
        return {};
    }

    Result<void> passLeaf(const Index3& origin, const std::byte* mask) {
        const VdbCoding& coding = tree_.coding_;
        const auto record = cursor_.peek(kLeafMaskBytes + maxVdbValuesHead(512));
        if (record.size() < kLeafMaskBytes) return cutOff();
        if (std::memcmp(record.data(), mask, kLeafMaskBytes) != 0)
            return damaged(fmt::format("the leaf of ({}, {}, {}) has two masks that differ", origin[0],
                                       origin[1], origin[2]));
        if (coding.type.component == SampleType::kBool) {
            // Mask, origin, and the values as another mask, unless they are the mask.
            cursor_.skip(kLeafMaskBytes + 12 + (coding.type.mask ? 0 : kLeafMaskBytes));
        } else {
            std::array<std::uint64_t, 8> words;
            std::memcpy(words.data(), mask, sizeof words);
            std::size_t active = 0;
            for (const std::uint64_t word : words) active += std::size_t(std::popcount(word));
            const auto bytes = measureVdbValues(record.subspan(kLeafMaskBytes), coding, 512, active);
            if (!bytes)
                return damaged(fmt::format("in the leaf of ({}, {}, {}), {}", origin[0], origin[1], origin[2],
                                           bytes.error().message));
            cursor_.skip(kLeafMaskBytes + *bytes);
        }
        return cursor_.ok() ? Result<void>() : cutOff();
    }

    void addActive(const Index3& origin, int log2_edge) {
        const std::int64_t edge = std::int64_t(1) << log2_edge;
        tree_.active_voxels_ += std::uint64_t(edge * edge * edge);
        for (std::size_t a = 0; a < 3; ++a) {
            box_.begin[a] = std::min(box_.begin[a], origin[a]);
            box_.end[a] = std::max(box_.end[a], origin[a] + edge);
        }
    }
    void addActiveTiles(const Index3& origin, const std::vector<std::uint64_t>& children, int log2_slots,
                        int log2_child) {
        for (std::size_t word = 0; word < children.size(); ++word)
            for (std::uint64_t bits = active_[word] & ~children[word]; bits != 0; bits &= bits - 1)
                addActive(childOrigin(origin, 64 * word + std::size_t(std::countr_zero(bits)), log2_slots,
                                      log2_child),
                          log2_child);
    }
    void addLeafActive(const Index3& origin, std::span<const std::byte> mask) {
        std::array<std::uint64_t, 8> words;  // one per x; bits count z, then y
        std::memcpy(words.data(), mask.data(), sizeof words);
        std::uint64_t any = 0, all = ~std::uint64_t(0), count = 0;
        for (const std::uint64_t word : words) {
            any |= word;
            all &= word;
            count += std::uint64_t(std::popcount(word));
        }
        if (count == 0) return;
        if (all == ~std::uint64_t(0)) return addActive(origin, VdbTree::kLeafLog2);
        tree_.active_voxels_ += count;
        std::array<unsigned, 3> along{};  // a bit per coordinate that occurs
        for (unsigned i = 0; i < 8; ++i) {
            if (words[i] != 0) along[0] |= 1u << i;
            const unsigned row = unsigned(any >> 8 * i & 0xff);
            if (row != 0) along[1] |= 1u << i;
            along[2] |= row;
        }
        for (std::size_t a = 0; a < 3; ++a) {
            box_.begin[a] = std::min(box_.begin[a], origin[a] + std::countr_zero(along[a]));
            box_.end[a] = std::max(box_.end[a], origin[a] + std::bit_width(along[a]));
        }
    }

    void shrink() {
        tree_.root_.shrink_to_fit();
        tree_.uppers_.shrink_to_fit();
        tree_.lowers_.shrink_to_fit();
        tree_.lower_masks_.bits.shrink_to_fit();
        tree_.lower_masks_.before.shrink_to_fit();
        tree_.upper_masks_.bits.shrink_to_fit();
        tree_.upper_masks_.before.shrink_to_fit();
        tree_.runs_.shrink_to_fit();
        tree_.values_.shrink_to_fit();
    }

    const VdbBytes& file_;
    VdbCursor cursor_;
    const std::string& where_;
    VdbTree tree_;
    std::uint64_t most_tile_bytes_ = 0;
    std::uint64_t leaves_ = 0;
    static constexpr std::int64_t kFar = std::numeric_limits<std::int64_t>::max();
    IndexBox box_{{kFar, kFar, kFar}, {-kFar, -kFar, -kFar}};
    // Per lower node, until the leaves are placed.
    std::vector<std::uint64_t> leaf_masks_begin_;
    std::vector<std::array<std::int32_t, 3>> lower_origins_;
    // Of the node that is being read.
    std::vector<std::uint64_t> upper_children_, lower_children_, active_;
    std::vector<std::byte> values_, scratch_, masks_;
};

Result<VdbTree> VdbTree::build(const VdbBytes& file, std::uint64_t begin, std::uint64_t end, VdbCoding coding,
                               const std::string& where) {
    return VdbTreeBuilder(file, begin, end, coding, where).build();
}

}  // namespace brickyard

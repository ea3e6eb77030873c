#include "tools/importers/vdb_grid_field.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>
#include <limits>

namespace brickyard {
namespace {

constexpr std::int64_t kMin = std::numeric_limits<std::int32_t>::min();
constexpr std::int64_t kEnd = std::int64_t(std::numeric_limits<std::int32_t>::max()) + 1;
constexpr IndexBox kInt32Box{{kMin, kMin, kMin}, {kEnd, kEnd, kEnd}};

constexpr std::size_t kLeafVoxels = 512, kMaskBytes = 64;
// Records this near each other are read in one go: copying what lies between costs no more than another call.
constexpr std::uint64_t kLargestGapBytes = 8u << 10;
constexpr std::uint64_t kMostBytesAtOnce = 512u << 10;
// A box of 2^24 samples may be a line through millions of leaves.
constexpr std::size_t kLeavesAtOnce = 4096;

// Leaves run z fastest, value by value; blocks x fastest, component by component.
template <class Word>
void transpose(const std::byte* values, int components, std::byte* out) {
    for (int c = 0; c < components; ++c)
        for (std::size_t z = 0; z < 8; ++z)
            for (std::size_t y = 0; y < 8; ++y)
                for (std::size_t x = 0; x < 8; ++x, out += sizeof(Word)) {
                    const std::size_t n = 64 * x + 8 * y + z;
                    std::memcpy(out, values + (n * std::size_t(components) + std::size_t(c)) * sizeof(Word),
                                sizeof(Word));
                }
}

template <class Word>
void fillRow(std::byte* row, const std::byte* value, std::size_t count) {
    Word word;
    std::memcpy(&word, value, sizeof word);
    std::fill_n(reinterpret_cast<Word*>(row), count, word);
}

}  // namespace

// The output of a read: where each sample of `box` goes.
struct VdbGridField::Window {
    IndexBox box;
    std::size_t width;  // of a component
    int components;
    std::size_t nx, ny, samples;
    std::byte* values;
    std::uint8_t* active;

    std::size_t at(std::int64_t x, std::int64_t y, std::int64_t z) const {
        return std::size_t(x - box.begin[0]) +
               nx * (std::size_t(y - box.begin[1]) + ny * std::size_t(z - box.begin[2]));
    }

    void fill(const IndexBox& part, const VdbTile& tile) const {
        const std::size_t row = std::size_t(part.extent(0));
        for (std::int64_t z = part.begin[2]; z < part.end[2]; ++z)
            for (std::int64_t y = part.begin[1]; y < part.end[1]; ++y) {
                const std::size_t first = at(part.begin[0], y, z);
                for (std::size_t c = 0; c < std::size_t(components); ++c) {
                    std::byte* out = values + (c * samples + first) * width;
                    const std::byte* value = tile.value + c * width;
                    if (width == 1)
                        fillRow<std::uint8_t>(out, value, row);
                    else if (width == 4)
                        fillRow<std::uint32_t>(out, value, row);
                    else
                        fillRow<std::uint64_t>(out, value, row);
                }
                std::fill_n(active + first, row, std::uint8_t(tile.active));
            }
    }

    void copy(const IndexBox& part, const Index3& origin, const std::byte* leaf) const {
        std::array<std::uint64_t, 8> mask;  // one word per x; bits count z, then y
        std::memcpy(mask.data(), leaf, sizeof mask);
        const std::byte* const in = leaf + kMaskBytes;
        const std::size_t row = std::size_t(part.extent(0)), x0 = std::size_t(part.begin[0] - origin[0]);
        for (std::int64_t z = part.begin[2]; z < part.end[2]; ++z)
            for (std::int64_t y = part.begin[1]; y < part.end[1]; ++y) {
                const std::size_t first = at(part.begin[0], y, z);
                const auto ly = std::size_t(y - origin[1]), lz = std::size_t(z - origin[2]);
                for (std::size_t c = 0; c < std::size_t(components); ++c)
                    std::memcpy(values + (c * samples + first) * width,
                                in + (c * kLeafVoxels + 64 * lz + 8 * ly + x0) * width, row * width);
                for (std::size_t i = 0; i < row; ++i)
                    active[first + i] = std::uint8_t(mask[x0 + i] >> (8 * ly + lz) & 1);
            }
    }
};

// Kept by each thread from one read to the next.
struct VdbGridField::Buffers {
    std::vector<std::pair<IndexBox, VdbLeafPlace>> leaves;
    std::vector<std::size_t> missing;
    std::vector<std::byte> records, values, scratch;
};

VdbGridField::VdbGridField(std::shared_ptr<const VdbBytes> file, VdbTreePlace place, ChannelInfo info,
                           std::shared_ptr<VdbLeafCache> cache, std::uint32_t number)
    : file_(std::move(file)),
      place_(std::move(place)),
      first_info_(std::move(info)),
      cache_(std::move(cache)),
      number_(number),
      current_info_(&first_info_) {}

std::size_t VdbGridField::leafBytes() const { return kMaskBytes + kLeafVoxels * place_.coding.type.bytes(); }

Result<const VdbTree*> VdbGridField::tree() const {
    if (const VdbTree* built = current_tree_.load(std::memory_order_acquire)) return built;
    const std::lock_guard lock(mutex_);
    if (tree_) return tree_.get();
    if (!error_) {
        auto built = VdbTree::build(*file_, place_.begin, place_.end, place_.coding, place_.where);
        // A file that somebody still writes may look like anything.
        if (auto unchanged = file_->checkUnchanged(); !unchanged)
            error_ = unchanged.error();
        else if (!built)
            error_ = built.error();
        else
            tree_ = std::make_unique<const VdbTree>(std::move(*built));
    }
    if (error_) return tl::unexpected(*error_);
    if (!full_info_) {
        auto full = std::make_unique<ChannelInfo>(first_info_);
        full->active_voxels = tree_->activeVoxels();
        full->active_box = tree_->activeBox();
        full_info_ = std::move(full);
        current_info_.store(full_info_.get(), std::memory_order_release);
    }
    current_tree_.store(tree_.get(), std::memory_order_release);
    return tree_.get();
}

void VdbGridField::release() const {
    const std::lock_guard lock(mutex_);
    current_tree_.store(nullptr, std::memory_order_release);
    tree_.reset();
    cache_->forget(number_);
}

std::optional<UniformRegion> VdbGridField::uniformOver(const IndexBox& box) const {
    const UniformRegion background{first_info_.background, false};
    const IndexBox inside = intersect(box, kInt32Box);
    if (inside.empty()) return background;
    const auto known = tree();
    if (!known) return box.contains({0, 0, 0}) ? std::nullopt : std::optional(background);

    const auto tile = (*known)->uniformOver(inside);
    if (!tile) return std::nullopt;
    UniformRegion region;
    region.active = tile->active;
    const VdbValueType& type = place_.coding.type;
    for (std::size_t c = 0; c < std::size_t(type.components); ++c) {
        ValueBits bits = 0;
        std::memcpy(&bits, tile->value + c * sampleBytes(type.component), sampleBytes(type.component));
        region.value.push_back(bits);
    }
    if (inside != box && (region.active || region.value != background.value)) return std::nullopt;
    return region;
}

Result<void> VdbGridField::read(const IndexBox& box, SampleBlock& out) const {
    const auto known = tree();
    if (!known) return tl::unexpected(known.error());
    auto filled = fill(**known, box, out);
    // Also after an error, of which this may be the cause.
    if (auto unchanged = file_->checkUnchanged(); !unchanged) return unchanged;
    return filled;
}

Result<void> VdbGridField::fill(const VdbTree& tree, const IndexBox& box, SampleBlock& out) const {
    const VdbValueType& type = place_.coding.type;
    Window window{box,
                  sampleBytes(type.component),
                  type.components,
                  std::size_t(box.extent(0)),
                  std::size_t(box.extent(1)),
                  0,
                  nullptr,
                  nullptr};
    window.samples = window.nx * window.ny * std::size_t(box.extent(2));
    out.values.resize(window.samples * type.bytes());
    out.active.resize(window.samples);
    window.values = out.values.data();
    window.active = out.active.data();

    const IndexBox inside = intersect(box, kInt32Box);
    const VdbTile background{tree.coding().background.data(), false};
    if (inside != box) window.fill(box, background);
    if (inside.empty()) return {};
    thread_local Buffers buffers;
    auto& leaves = buffers.leaves;
    leaves.clear();
    Result<void> result;
    tree.visit(
        inside, [&](const IndexBox& part, const VdbTile& tile) { window.fill(part, tile); },
        [&](const IndexBox& part, const VdbLeafPlace& place) {
            leaves.emplace_back(part, place);
            if (leaves.size() < kLeavesAtOnce) return;
            if (result) result = copyLeaves(tree, leaves, window, buffers);
            leaves.clear();
        });
    if (result) result = copyLeaves(tree, leaves, window, buffers);
    return result;
}

Result<void> VdbGridField::copyLeaves(const VdbTree& tree,
                                      std::span<const std::pair<IndexBox, VdbLeafPlace>> leaves,
                                      const Window& window, Buffers& buffers) const {
    auto& missing = buffers.missing;
    missing.clear();
    for (std::size_t i = 0; i < leaves.size(); ++i) {
        const auto& [part, place] = leaves[i];
        if (const auto leaf = cache_->find(number_, place.number))
            window.copy(part, place.origin, leaf.get());
        else
            missing.push_back(i);
    }
    const auto placeOf = [&](std::size_t m) -> const VdbLeafPlace& { return leaves[missing[m]].second; };
    for (std::size_t first = 0; first < missing.size();) {
        const std::uint64_t begin = placeOf(first).begin;
        std::uint64_t end = begin + placeOf(first).bytes;
        std::size_t last = first + 1;
        for (; last < missing.size(); ++last) {
            const VdbLeafPlace& next = placeOf(last);
            if (next.begin < end || next.begin - end > kLargestGapBytes ||
                next.begin + next.bytes - begin > kMostBytesAtOnce)
                break;
            end = next.begin + next.bytes;
        }
        if (buffers.records.size() < end - begin) buffers.records.resize(end - begin);
        const auto records = std::span(buffers.records).first(end - begin);
        if (auto read = file_->readAt(begin, records); !read) return read;
        for (; first < last; ++first) {
            const auto& [part, place] = leaves[missing[first]];
            auto leaf = decode(tree, place, records.subspan(place.begin - begin, place.bytes), buffers);
            if (!leaf) return tl::unexpected(leaf.error());
            window.copy(part, place.origin, leaf->get());
            cache_->insert(number_, place.number, std::move(*leaf), leafBytes());
        }
    }
    return {};
}

// A leaf as it is cached: its mask, then its values as a block of 8^3.
Result<VdbLeafCache::Leaf> VdbGridField::decode(const VdbTree& tree, const VdbLeafPlace& place,
                                                std::span<const std::byte> record, Buffers& buffers) const {
    const VdbCoding& coding = tree.coding();
    const auto leaf = std::make_shared_for_overwrite<std::byte[]>(leafBytes());
    std::memcpy(leaf.get(), record.data(), kMaskBytes);
    std::byte* const out = leaf.get() + kMaskBytes;
    std::array<std::uint64_t, 8> mask;
    std::memcpy(mask.data(), record.data(), sizeof mask);
    if (coding.type.component == SampleType::kBool) {
        // The values are a mask as well, behind the leaf's origin; a mask grid's are the mask itself.
        std::array<std::uint64_t, 8> bits = mask;
        if (!coding.type.mask) std::memcpy(bits.data(), record.data() + kMaskBytes + 12, sizeof bits);
        for (std::size_t i = 0; i < kLeafVoxels; ++i)
            out[i] = std::byte(bits[i & 7] >> (8 * (i >> 3 & 7) + (i >> 6)) & 1);
        return leaf;
    }
    if (buffers.values.size() < leafBytes()) buffers.values.resize(leafBytes());
    if (auto decoded =
            decodeVdbValues(record.subspan(kMaskBytes), coding, mask, buffers.values.data(), buffers.scratch);
        !decoded)
        return fail(ErrorCode::kCorrupt,
                    fmt::format("{}: in the leaf of ({}, {}, {}), {}, at byte {}; write the file again",
                                place_.where, place.origin[0], place.origin[1], place.origin[2],
                                decoded.error().message, place.begin));
    if (sampleBytes(coding.type.component) == 4)
        transpose<std::uint32_t>(buffers.values.data(), coding.type.components, out);
    else
        transpose<std::uint64_t>(buffers.values.data(), coding.type.components, out);
    return leaf;
}

}  // namespace brickyard

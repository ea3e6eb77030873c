#include "core/tree_block.h"

#include <fmt/format.h>

#include <bit>
#include <cassert>
#include <cmath>
#include <limits>

#include "core/brick_codec.h"
#include "core/lorenzo.h"
#include "core/node_key.h"
#include "core/tree_block_format.h"
#include "core/zstd_frame.h"

namespace brickyard {
namespace {

tl::unexpected<Error> corrupt(std::string message) {
    return fail(ErrorCode::kCorrupt, message + "; convert this frame again");
}

// 2^((c - 255) / 8) for c in [0, 255]; 0 for c = 0. Powers of two times eight constants, so that every
// machine has the same table.
constexpr std::array<double, 256> makeErrorFactors() {
    constexpr double kEighths[8] = {1.0,
                                    1.0905077326652577,
                                    1.189207115002721,
                                    1.2968395546510096,
                                    1.4142135623730951,
                                    1.5422108254079407,
                                    1.681792830507429,
                                    1.8340080864093424};
    std::array<double, 256> factors{};
    for (int c = 1; c < 256; ++c) {
        double factor = kEighths[(c + 1) % 8];
        for (int octave = (c + 1) / 8; octave < 32; ++octave) factor *= 0.5;
        factors[std::size_t(c)] = factor;
    }
    return factors;
}
constexpr std::array<double, 256> kErrorFactors = makeErrorFactors();
static_assert(kErrorFactors[255] == 1.0 && kErrorFactors[247] == 0.5);

bool isMagnitude(float x) { return std::isfinite(x) && x >= 0; }

}  // namespace

float errorFromCode(std::uint8_t code, float scale) {
    const double error = double(scale) * kErrorFactors[code];
    const float nearest = float(error);
    return double(nearest) < error ? std::nextafter(nearest, std::numeric_limits<float>::infinity())
                                   : nearest;
}

std::uint8_t errorToCode(double error, float scale) {
    assert(error <= double(scale));
    if (!(error > 0)) return 0;
    // errorFromCode rises with the code and gives `scale` itself for the last one.
    unsigned low = 1, high = 255;
    while (low < high) {
        const unsigned middle = (low + high) / 2;
        if (double(errorFromCode(std::uint8_t(middle), scale)) >= error)
            high = middle;
        else
            low = middle + 1;
    }
    return std::uint8_t(low);
}

// Reads a block in steps that each check what the next ones rely on.
struct TreeBlockCodec {
    TreeBlock block;
    std::uint32_t block_count = 0;
    std::uint64_t file_bytes = 0;

    Result<void> readColumns(std::span<const std::byte> raw);
    Result<void> checkRecords() const;
    Result<void> checkTopology() const;
};

Result<void> TreeBlockCodec::readColumns(std::span<const std::byte> raw) {
    ByteReader reader(raw);
    const auto header = reader.get<TreeBlockHeader>();
    if (!reader.ok() || header.magic != kTreeBlockMagic)
        return corrupt("tree block does not begin with its magic");
    if (header.version != kTreeBlockVersion)
        return corrupt(
            fmt::format("tree block of version {} is none that this reader knows", header.version));
    const auto components = std::uint8_t(block.components_);
    if (header.components != components || header.zero != 0)
        return corrupt(
            fmt::format("tree block of {} components in a channel of {}", header.components, components));

    // Every count is below 2^32 and every factor small, so 64 bits hold the sum; nothing is allocated before
    // it agrees.
    const std::uint64_t needed = std::uint64_t(header.nodes) * kTreeBlockNodeBytes +
                                 std::uint64_t(header.far_entries) * 4 +
                                 std::uint64_t(header.constants) * components * sizeof(ValueBits) +
                                 std::uint64_t(header.grids) * sizeof(ErrorGrid);
    if (needed != reader.left() || raw.size() > kMaxBlockRawBytes)
        return corrupt(fmt::format("tree block of {} bytes, but its counts add up to {}", raw.size(),
                                   needed + sizeof(TreeBlockHeader)));
    if (header.nodes == 0 || header.nodes > kMaxBlockNodes || header.head_nodes == 0 ||
        header.head_nodes > 8 || header.head_nodes > header.nodes)
        return corrupt(
            fmt::format("tree block with {} nodes, {} of them heads", header.nodes, header.head_nodes));

    const std::size_t n = header.nodes;
    block.head_nodes_ = header.head_nodes;
    block.descriptors_ = getColumn<std::uint32_t>(reader, n);
    block.far_ = getColumn<std::uint32_t>(reader, header.far_entries);
    const auto flags = getColumn<std::uint8_t>(reader, n);
    std::array<std::vector<std::uint8_t>, 6> box;
    for (auto& side : box) side = getColumn<std::uint8_t>(reader, n);
    const auto payload_bytes = getColumn<std::uint32_t>(reader, n);
    const auto payload_steps = getColumn<std::uint64_t>(reader, n);
    const auto checksums = getColumn<std::uint64_t>(reader, n);
    const auto value_min = getColumn<float>(reader, n);
    const auto value_max = getColumn<float>(reader, n);
    const auto bound = getColumn<float>(reader, n);
    const auto rms = getColumn<float>(reader, n);
    const auto constant = getColumn<std::uint32_t>(reader, n);
    const auto draft_bytes = getColumn<std::uint32_t>(reader, n);
    const auto draft_checksums = getColumn<std::uint64_t>(reader, n);
    const auto draft_bound = getColumn<float>(reader, n);
    const auto draft_rms = getColumn<float>(reader, n);
    block.constants_ = getColumn<ValueBits>(reader, std::size_t(header.constants) * components);
    block.grids_.resize(header.grids);
    for (ErrorGrid& grid : block.grids_) grid = reader.get<ErrorGrid>();
    assert(reader.ok() && reader.left() == 0);

    block.records_.resize(n);
    std::uint64_t payload_end = 0;  // of the node before; modulo 2^64, and compared with the file below
    std::uint32_t next_grid = 0;
    for (std::size_t i = 0; i < n; ++i) {
        NodeRecord& record = block.records_[i];
        if (flags[i] > (kNodeActive | kNodeHasGrid))
            return corrupt(fmt::format("tree block: node {} has flags {}", i, flags[i]));
        record.active = (flags[i] & kNodeActive) != 0;
        if ((flags[i] & kNodeHasGrid) != 0) {
            if (next_grid == header.grids)
                return corrupt(fmt::format("tree block: node {} lacks its error grid", i));
            record.grid = std::int32_t(next_grid++);
        }
        record.payload_bytes = payload_bytes[i];
        record.payload_checksum = checksums[i];
        if (record.hasBrick()) {
            record.payload_offset = payload_end + unzigzag(payload_steps[i]);
            payload_end = record.payload_offset + record.payload_bytes;
        } else if (payload_steps[i] != 0 || checksums[i] != 0) {
            return corrupt(fmt::format("tree block: node {} has no payload, but a place for one", i));
        }
        record.value_min = value_min[i];
        record.value_max = value_max[i];
        record.bound = bound[i];
        record.rms = rms[i];
        record.constant = constant[i];
        record.draft_bytes = draft_bytes[i];
        record.draft_checksum = draft_checksums[i];
        record.draft_bound = draft_bound[i];
        record.draft_rms = draft_rms[i];
        for (std::size_t axis = 0; axis < 3; ++axis) {
            record.box_begin[axis] = box[axis][i];
            record.box_end[axis] = box[3 + axis][i];
        }
    }
    if (next_grid != header.grids) return corrupt("tree block with error grids that no node has");
    return {};
}

Result<void> TreeBlockCodec::checkRecords() const {
    const std::size_t constants = block.constants_.size() / std::size_t(block.components_);
    for (std::size_t i = 0; i < block.records_.size(); ++i) {
        const NodeRecord& r = block.records_[i];
        if (r.hasBrick()) {
            // The subtraction cannot wrap, because the offset is compared first.
            if (r.payload_bytes > kMaxPayloadBytes || r.payload_offset > file_bytes ||
                r.payload_bytes > file_bytes - r.payload_offset)
                return corrupt(fmt::format("tree block: node {} claims {} bytes at {} of a file of {}", i,
                                           r.payload_bytes, r.payload_offset, file_bytes));
            if (r.constant != 0)
                return corrupt(fmt::format("tree block: node {} has a payload and a constant", i));
        } else if (r.constant >= constants) {
            return corrupt(
                fmt::format("tree block: node {} has constant {} of {}", i, r.constant, constants));
        }
        if (!std::isfinite(r.value_min) || !std::isfinite(r.value_max) || r.value_min > r.value_max)
            return corrupt(
                fmt::format("tree block: node {} has values from {} to {}", i, r.value_min, r.value_max));
        if (!isMagnitude(r.bound) || !isMagnitude(r.rms))
            return corrupt(fmt::format("tree block: node {} has error bound {}, RMS {}", i, r.bound, r.rms));
        if (r.hasDraft()) {
            if (r.draft_bytes >= r.payload_bytes || !block.isLeaf(std::uint32_t(i)))
                return corrupt(fmt::format("tree block: node {} has a draft of {} bytes of {}, but {}", i,
                                           r.draft_bytes, r.payload_bytes,
                                           block.isLeaf(std::uint32_t(i)) ? "no more" : "is no leaf"));
            if (!isMagnitude(r.draft_bound) || !isMagnitude(r.draft_rms))
                return corrupt(fmt::format("tree block: node {} has a draft with error bound {}, RMS {}", i,
                                           r.draft_bound, r.draft_rms));
        } else if (r.draft_checksum != 0 || r.draft_bound != 0 || r.draft_rms != 0) {
            return corrupt(fmt::format("tree block: node {} has no draft, but numbers of one", i));
        }
        for (std::size_t axis = 0; axis < 3; ++axis)
            if (r.box_begin[axis] > r.box_end[axis] || r.box_end[axis] > kMaxBrickEdge)
                return corrupt(fmt::format("tree block: node {} has a box from {} to {}", i,
                                           r.box_begin[axis], r.box_end[axis]));
    }
    return {};
}

// Every node behind the heads is the child of exactly one node before it, so walks within a block end, and
// end soon: a graph whose children are shared could be walked for 8^depth steps.
Result<void> TreeBlockCodec::checkTopology() const {
    const std::uint32_t n = block.nodeCount();
    constexpr std::uint8_t kNoParent = 0xff;
    std::vector<std::uint8_t> depth(n, kNoParent);  // below the heads
    std::fill_n(depth.begin(), block.head_nodes_, std::uint8_t(0));
    std::vector<bool> far_used(block.far_.size(), false);
    std::uint32_t last_block = block.own_index_;

    for (std::uint32_t i = 0; i < n; ++i) {
        if (depth[i] == kNoParent) return corrupt(fmt::format("tree block: node {} has no parent", i));
        const std::uint32_t descriptor = block.descriptors_[i];
        if (block.isLeaf(i)) {
            if (descriptor != 0) return corrupt(fmt::format("tree block: leaf {} has a child pointer", i));
            continue;
        }
        if ((block.leafMask(i) & ~unsigned(block.validMask(i))) != 0)
            return corrupt(fmt::format("tree block: node {} has leaves that are no children", i));

        std::uint64_t first = std::uint64_t(i) + (descriptor >> kChildPointerShift);
        if ((descriptor & kFarFlag) != 0) {
            const std::uint32_t at = descriptor >> kChildPointerShift;
            if (at >= block.far_.size() || far_used[at])
                return corrupt(
                    fmt::format("tree block: node {} has far pointer {} of {}", i, at, block.far_.size()));
            far_used[at] = true;
            const std::uint32_t far = block.far_[at];
            if ((far & kFarIsBlock) != 0) {
                const std::uint32_t target = far & ~kFarIsBlock;
                // Rising numbers: behind this block, so that no walk comes back, and no block twice.
                if (target <= last_block || target >= block_count)
                    return corrupt(fmt::format("tree block {}: node {} has its children in block {} of {}",
                                               block.own_index_, i, target, block_count));
                last_block = target;
                continue;  // what is there, that block tells
            }
            first = std::uint64_t(i) + far;
        }

        const auto children = std::uint32_t(std::popcount(block.validMask(i)));
        if (first <= i || first + children > n)
            return corrupt(fmt::format("tree block: node {} has its children at {} of {}", i, first, n));
        if (depth[i] >= kMaxLevel) return corrupt(fmt::format("tree block: node {} lies below level 0", i));
        auto child = std::uint32_t(first);
        for (unsigned octant = 0; octant < 8; ++octant) {
            if ((block.validMask(i) >> octant & 1) == 0) continue;
            if (depth[child] != kNoParent)
                return corrupt(fmt::format("tree block: node {} has two parents", child));
            if ((block.leafMask(i) >> octant & 1) != (block.isLeaf(child) ? 1 : 0))
                return corrupt(
                    fmt::format("tree block: node {} is not what its parent's leaf mask says", child));
            depth[child++] = std::uint8_t(depth[i] + 1);
        }
    }
    for (std::size_t at = 0; at < far_used.size(); ++at)
        if (!far_used[at]) return corrupt(fmt::format("tree block: no node uses far pointer {}", at));
    return {};
}

Result<TreeBlock> TreeBlock::decode(std::span<const std::byte> raw, std::uint32_t own_index,
                                    std::uint32_t block_count, std::uint64_t file_bytes, int components) {
    assert(components >= 1 && components <= 3);
    TreeBlockCodec codec;
    codec.block.components_ = components;
    codec.block.own_index_ = own_index;
    codec.block_count = block_count;
    codec.file_bytes = file_bytes;
    if (const auto read = codec.readColumns(raw); !read) return tl::unexpected(read.error());
    if (const auto sound = codec.checkRecords(); !sound) return tl::unexpected(sound.error());
    if (const auto sound = codec.checkTopology(); !sound) return tl::unexpected(sound.error());
    return std::move(codec.block);
}

ChildrenRef TreeBlock::children(std::uint32_t node) const {
    assert(!isLeaf(node));
    const std::uint32_t pointer = descriptors_[node] >> kChildPointerShift;
    if ((descriptors_[node] & kFarFlag) == 0) return {own_index_, node + pointer};
    const std::uint32_t far = far_[pointer];
    if ((far & kFarIsBlock) != 0) return {far & ~kFarIsBlock, 0};
    return {own_index_, node + far};
}

std::size_t TreeBlock::memoryBytes() const {
    return sizeof(*this) + descriptors_.capacity() * sizeof(std::uint32_t) +
           far_.capacity() * sizeof(std::uint32_t) + records_.capacity() * sizeof(NodeRecord) +
           grids_.capacity() * sizeof(ErrorGrid) + constants_.capacity() * sizeof(ValueBits);
}

Result<TreeBlock> decodeStoredBlock(std::span<const std::byte> stored, std::uint32_t raw_bytes,
                                    std::uint32_t own_index, std::uint32_t block_count,
                                    std::uint64_t file_bytes, int components) {
    if (raw_bytes > kMaxBlockRawBytes)
        return corrupt(fmt::format("tree block claims {} bytes, more than {}", raw_bytes, kMaxBlockRawBytes));
    std::vector<std::byte> raw(raw_bytes);
    if (!readZstdFrame(stored, raw))
        return corrupt(
            fmt::format("tree block of {} stored bytes does not decompress to {}", stored.size(), raw_bytes));
    return TreeBlock::decode(raw, own_index, block_count, file_bytes, components);
}

}  // namespace brickyard

#include "client/paged_channel.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/brick_store.h"

namespace brickyard {

Result<PagedChannel> PagedChannel::create(const ChannelFooter& footer, std::uint32_t index, int brick_edge,
                                          std::uint64_t file_bytes) {
    PagedChannel channel;
    channel.footer_ = footer;
    channel.index_ = index;
    channel.shape_.edge_cells = brick_edge;
    channel.type_ = static_cast<SampleType>(footer.sample_type());
    channel.file_bytes_ = file_bytes;
    if (!isBrickEdge(brick_edge) || (footer.components() != 1 && footer.components() != 3) ||
        footer.background_size() != int(footer.components()) ||
        (footer.active_voxels() > 0 && (footer.active_min_size() != 3 || footer.active_max_size() != 3)))
        return fail(ErrorCode::kCorrupt,
                    fmt::format("channel '{}': its footer does not hold together", footer.name()));
    constexpr double kMost = std::numeric_limits<float>::max();
    if (std::abs(footer.value_min()) > kMost || std::abs(footer.value_max()) > kMost)
        return fail(ErrorCode::kUnsupported,
                    fmt::format("channel '{}': its values, {:g} to {:g}, are beyond the float range "
                                "and cannot be drawn",
                                footer.name(), footer.value_min(), footer.value_max()));

    if (Result<void> placed = channel.place(footer); !placed) return tl::unexpected(placed.error());
    channel.background_bits_.assign(footer.background().begin(), footer.background().end());
    channel.background_ = toFloat(channel.type_, footer.background(0));
    channel.empty_ = footer.active_voxels() == 0;
    if (!channel.empty_)
        for (int a = 0; a < 3; ++a) {
            channel.clip_low_[a] = footer.active_min(a) - 1.0;
            channel.clip_high_[a] = footer.active_max(a) + 1.0;
        }
    for (const RootNode& root : footer.roots())
        channel.roots_.push_back({std::int32_t(root.level()), root.x(), root.y(), root.z()});
    channel.blocks_.resize(std::size_t(footer.blocks_size()));
    channel.levels_.resize(channel.blocks_.size());
    channel.head_level_.assign(channel.blocks_.size(), -1);
    if (!channel.blocks_.empty() && !channel.roots_.empty()) channel.head_level_[0] = channel.roots_[0].level;
    return channel;
}

Result<void> PagedChannel::place(const ChannelFooter& footer) {
    const std::vector<double> columns(footer.index_to_world().begin(), footer.index_to_world().end());
    const Result<Affine> transform = Affine::fromColumns(columns);
    if (!transform)
        return fail(ErrorCode::kCorrupt,
                    fmt::format("channel '{}': {}", footer.name(), transform.error().message));
    transform_ = *transform;
    return {};
}

Result<void> PagedChannel::addBlock(std::uint32_t index, std::span<const std::byte> stored) {
    if (index >= blocks_.size())
        return fail(ErrorCode::kNotFound, fmt::format("channel '{}' has no tree block {}", name(), index));
    if (blocks_[index]) return {};
    const BlockRef& ref = footer_.blocks(int(index));
    if (stored.size() != ref.bytes() || checksum(stored) != ref.xxh64())
        return fail(ErrorCode::kCorrupt,
                    fmt::format("channel '{}': tree block {} fails its checksum", name(), index));
    Result<TreeBlock> block =
        decodeStoredBlock(stored, ref.raw_bytes(), index, blockCount(), file_bytes_, components());
    if (!block)
        return fail(ErrorCode::kCorrupt,
                    fmt::format("channel '{}': tree block {}: {}", name(), index, block.error().message));
    // The roots, and a parent's children, are the first nodes of their block.
    if (index == 0 && block->headNodes() != roots_.size())
        return fail(ErrorCode::kCorrupt,
                    fmt::format("channel '{}': tree block 0 has other roots than the footer", name()));
    if (head_level_[index] < 0)
        return fail(ErrorCode::kCorrupt,
                    fmt::format("channel '{}': tree block {} came before its parent", name(), index));

    // Children stand behind their parents, so one pass tells every level; other blocks learn theirs here.
    std::vector<std::int8_t> levels(block->nodeCount(), std::int8_t(head_level_[index]));
    for (std::uint32_t node = 0; node < block->nodeCount(); ++node) {
        if (block->isLeaf(node)) continue;
        const std::int8_t below = std::int8_t(std::max(0, levels[node] - 1));
        const ChildrenRef children = block->children(node);
        const int count = __builtin_popcount(block->validMask(node));
        if (children.block != index)
            head_level_[children.block] = below;
        else
            std::fill_n(levels.begin() + std::ptrdiff_t(children.first), count, below);
    }
    levels_[index] = std::move(levels);
    tree_bytes_ += block->memoryBytes();
    blocks_[index] = std::make_shared<const TreeBlock>(std::move(*block));
    return {};
}

}  // namespace brickyard

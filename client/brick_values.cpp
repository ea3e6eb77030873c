#include "client/brick_values.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <bit>
#include <optional>

#include "core/brick_codec.h"
#include "core/brick_store.h"
#include "core/sample_conversion.h"
#include "core/tree_block.h"

namespace brickyard {
namespace {

// What finding a brick asks of its channel: tree blocks one by one, then the brick.
class BrickSearch {
public:
    BrickSearch(BrickSource& source, const FrameFooter& footer, std::uint32_t channel,
                SourceDeadline deadline)
        : source_(source),
          channel_(footer.channels(int(channel))),
          index_(channel),
          shape_{int(footer.brick_edge())},
          deadline_(deadline) {}

    Result<BrickValues> run(const std::array<std::int64_t, 3>& position, int level) {
        if (!isBrickEdge(shape_.edge_cells) || channel_.components() < 1 || channel_.components() > 3)
            return corrupt("its footer does not hold together");
        for (int r = 0; r < channel_.roots_size(); ++r) {
            const RootNode& root = channel_.roots(r);
            key_ = {std::int32_t(root.level()), root.x(), root.y(), root.z()};
            if (key_.level < 0 || key_.level > kMaxLevel || !owns(position)) continue;
            if (Result<void> block = load(0); !block) return tl::unexpected(block.error());
            node_ = std::uint32_t(r);
            return descend(position, level);
        }
        return nothingAt(position);
    }

private:
    bool owns(const std::array<std::int64_t, 3>& position) const {
        const std::int64_t edge = std::int64_t(shape_.edge_cells) << key_.level;
        const std::int64_t low[3] = {key_.x * edge, key_.y * edge, key_.z * edge};
        for (int a = 0; a < 3; ++a)
            if (position[std::size_t(a)] < low[a] || position[std::size_t(a)] >= low[a] + edge) return false;
        return true;
    }

    Result<BrickValues> descend(const std::array<std::int64_t, 3>& position, int level) {
        while (true) {
            if (node_ >= block_->nodeCount()) return corrupt("has nodes past the end of a tree block");
            if (key_.level <= level || block_->isLeaf(node_)) return values();
            if (key_.level == 0) return corrupt("has children below level 0");
            const std::int64_t half = std::int64_t(shape_.edge_cells) << (key_.level - 1);
            const std::int64_t middle[3] = {(2 * key_.x + 1) * half, (2 * key_.y + 1) * half,
                                            (2 * key_.z + 1) * half};
            int octant = 0;
            for (int a = 0; a < 3; ++a) octant |= (position[std::size_t(a)] >= middle[a]) << a;
            const unsigned mask = block_->validMask(node_);
            if (!(mask >> octant & 1)) return nothingAt(position);
            // Children stand in octant order of the valid mask.
            const ChildrenRef children = block_->children(node_);
            if (children.block != block_index_)
                if (Result<void> block = load(children.block); !block) return tl::unexpected(block.error());
            node_ = children.first + std::uint32_t(std::popcount(mask & ((1u << octant) - 1)));
            key_ = key_.child(octant);
        }
    }

    Result<BrickValues> values() {
        const SampleType type = levelType(static_cast<SampleType>(channel_.sample_type()), key_.level);
        BrickValues brick{key_, shape_, int(channel_.components()), {}};
        const NodeRecord& record = block_->record(node_);
        if (!record.hasBrick()) {
            for (const ValueBits bits : block_->constant(node_))
                brick.samples.insert(brick.samples.end(), shape_.samples(), toDouble(type, bits));
            return brick;
        }
        const auto payload = fetch({false, {index_, block_index_, node_}});
        if (!payload) return tl::unexpected(payload.error());
        if (payload->size() != record.payload_bytes || checksum(*payload) != record.payload_checksum)
            return corrupt(fmt::format("brick {} fails its checksum", toString(key_)));
        // Only level 0 codes states against the background.
        std::vector<ValueBits> background(channel_.background().begin(), channel_.background().end());
        background.resize(std::size_t(channel_.components()));
        if (key_.level > 0) std::fill(background.begin(), background.end(), 0);
        const auto decoded = decodeBrick(*payload, shape_, type, brick.components, background);
        if (!decoded) return corrupt(fmt::format("brick {}: {}", toString(key_), decoded.error().message));
        samplesToDouble(type, decoded->values, brick.samples);
        return brick;
    }

    Result<void> load(std::uint32_t index) {
        if (index >= std::uint32_t(channel_.blocks_size()))
            return corrupt(fmt::format("has no tree block {}", index));
        const BlockRef& ref = channel_.blocks(int(index));
        const auto stored = fetch({true, {index_, index, 0}});
        if (!stored) return tl::unexpected(stored.error());
        if (stored->size() != ref.bytes() || checksum(*stored) != ref.xxh64())
            return corrupt(fmt::format("tree block {} fails its checksum", index));
        auto block = decodeStoredBlock(*stored, ref.raw_bytes(), index, std::uint32_t(channel_.blocks_size()),
                                       /*file_bytes=*/UINT64_MAX, int(channel_.components()));
        if (!block) return corrupt(fmt::format("tree block {}: {}", index, block.error().message));
        block_ = std::move(*block);
        block_index_ = index;
        return {};
    }

    Result<std::vector<std::byte>> fetch(const WishedPage& page) {
        PageWish wish;
        wish.pages.push_back(page);
        wish.credit_bytes = UINT64_MAX;
        if (Result<void> sent = source_.wish(std::move(wish)); !sent) return tl::unexpected(sent.error());
        while (true) {
            Result<std::vector<Arrival>> arrivals = source_.take(deadline_);
            if (!arrivals) return tl::unexpected(arrivals.error());
            // What an older wish still brought is not it.
            for (Arrival& arrival : *arrivals)
                if (arrival.page.is_block == page.is_block && arrival.page.address == page.address)
                    return std::move(arrival.bytes);
            if (arrivals->empty())
                return fail(ErrorCode::kTimeout,
                            fmt::format("{}: waited for a brick of channel '{}': it did not come by the "
                                        "deadline; allow more time",
                                        source_.name(), channel_.name()));
        }
    }

    tl::unexpected<Error> corrupt(const std::string& why) const {
        return fail(ErrorCode::kCorrupt,
                    fmt::format("{}: channel '{}': {}; run `brickyard verify` on the dataset", source_.name(),
                                channel_.name(), why));
    }
    tl::unexpected<Error> nothingAt(const std::array<std::int64_t, 3>& position) const {
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: channel '{}' stores nothing at ({}): it is background there",
                                source_.name(), channel_.name(), fmt::join(position, ", ")));
    }

    BrickSource& source_;
    const ChannelFooter& channel_;
    const std::uint32_t index_;
    const BrickShape shape_;
    const SourceDeadline deadline_;
    // Where the search has come to.
    NodeKey key_;
    std::optional<TreeBlock> block_;
    std::uint32_t block_index_ = 0, node_ = 0;
};

}  // namespace

Result<BrickValues> readBrick(BrickSource& source, const FrameFooter& footer, const std::string& channel,
                              const std::array<std::int64_t, 3>& position, int level,
                              SourceDeadline deadline) {
    std::vector<std::string> names;
    for (int i = 0; i < footer.channels_size(); ++i) {
        if (footer.channels(i).name() == channel)
            return BrickSearch(source, footer, std::uint32_t(i), deadline).run(position, level);
        names.push_back(footer.channels(i).name());
    }
    return fail(ErrorCode::kNotFound, fmt::format("{}: no channel '{}'; there are: {}", source.name(),
                                                  channel, fmt::join(names, ", ")));
}

}  // namespace brickyard

#include "core/frame_reader.h"

#include <fmt/format.h>

#include <atomic>

namespace brickyard {

FrameReader::FrameReader(std::shared_ptr<const BrickStore> store, std::shared_ptr<BlockCache> blocks)
    : store_(std::move(store)), blocks_(std::move(blocks)) {
    static std::atomic<std::uint64_t> next_id{0};
    frame_id_ = next_id++;
}

Result<std::uint32_t> FrameReader::storedBlockBytes(std::uint32_t channel, std::uint32_t block) const {
    const auto channels = std::uint32_t(footer().channels_size());
    if (channel >= channels)
        return fail(ErrorCode::kNotFound, fmt::format("{}: no channel {}; there are {}",
                                                      store_->path().filename().string(), channel, channels));
    const auto blocks = std::uint32_t(footer().channels(int(channel)).blocks_size());
    if (block >= blocks)
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: channel {} has no tree block {}; there are {}",
                                store_->path().filename().string(), channel, block, blocks));
    return footer().channels(int(channel)).blocks(int(block)).bytes();
}

Result<std::shared_ptr<const TreeBlock>> FrameReader::block(std::uint32_t channel, std::uint32_t block,
                                                            ReadMode mode) const {
    const BlockKey key{frame_id_, channel, block};
    if (auto cached = blocks_->find(key)) return cached;
    if (mode == ReadMode::kCachedOnly) return fail(ErrorCode::kWouldBlock, {});
    auto loaded = store_->loadBlock(channel, block);
    if (!loaded) return tl::unexpected(loaded.error());
    auto shared = std::make_shared<const TreeBlock>(std::move(*loaded));
    blocks_->insert(key, shared);
    return shared;
}

Result<NodeRecord> FrameReader::findBrick(const PageAddress& page, ReadMode mode) const {
    if (const auto known = storedBlockBytes(page.channel, page.block); !known)
        return tl::unexpected(known.error());
    const auto nodes = block(page.channel, page.block, mode);
    if (!nodes) return tl::unexpected(nodes.error());
    if (page.node >= (*nodes)->nodeCount())
        return fail(ErrorCode::kNotFound, fmt::format("{}: channel {}, block {} has no node {}; there are {}",
                                                      store_->path().filename().string(), page.channel,
                                                      page.block, page.node, (*nodes)->nodeCount()));
    const NodeRecord& record = (*nodes)->record(page.node);
    if (!record.hasBrick())
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: channel {}, block {}, node {} has one value and no payload",
                                store_->path().filename().string(), page.channel, page.block, page.node));
    if (page.draft && !record.hasDraft())
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: channel {}, block {}, node {} has no draft",
                                store_->path().filename().string(), page.channel, page.block, page.node));
    return record;
}

}  // namespace brickyard

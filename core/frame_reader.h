// Pages of one open frame by their address: what a server or a local source needs to answer a wish. Any
// thread.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "core/block_cache.h"
#include "core/brick_store.h"
#include "core/page_address.h"
#include "core/result.h"

namespace brickyard {

class FrameReader {
public:
    // `blocks` may be shared by many frames.
    FrameReader(std::shared_ptr<const BrickStore> store, std::shared_ptr<BlockCache> blocks);

    const BrickStore& store() const { return *store_; }
    const FrameFooter& footer() const { return store_->footer(); }

    // Errors: kNotFound (no such channel or block), kCorrupt, kIo; kWouldBlock where `mode` is kCachedOnly
    // and the block is not in the block cache.
    Result<std::shared_ptr<const TreeBlock>> block(std::uint32_t channel, std::uint32_t block,
                                                   ReadMode mode = ReadMode::kMayBlock) const;
    // Size of a block as stored, without reading it. Errors: kNotFound.
    Result<std::uint32_t> storedBlockBytes(std::uint32_t channel, std::uint32_t block) const;
    // The record of a brick. Errors: kNotFound (no such channel, block or node, a node of one value, or one
    // without the draft that is asked for), and those of block().
    Result<NodeRecord> findBrick(const PageAddress& page, ReadMode mode = ReadMode::kMayBlock) const;
    // Stored bytes of the whole payload or of its draft, neither decoded nor verified. REQUIRES: !draft ||
    // record.hasDraft(). Errors: kCorrupt (outside the file), kIo.
    Result<std::vector<std::byte>> readBrick(const NodeRecord& record, bool draft) const {
        NodeRecord part = record;
        if (draft) part.payload_bytes = record.draft_bytes;
        return store_->readPayloadUnchecked(part);
    }

private:
    std::shared_ptr<const BrickStore> store_;
    std::shared_ptr<BlockCache> blocks_;
    std::uint64_t frame_id_;
};

}  // namespace brickyard

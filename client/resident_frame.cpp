#include "client/resident_frame.h"

#include <fmt/format.h>

#include "client/brick_page.h"

namespace brickyard {

Result<void> ResidentFrame::begin(const FrameFooter& footer, std::uint64_t file_bytes,
                                  std::uint64_t budget_bytes, int components) {
    // Where a scene puts a channel makes no other frame of it.
    FrameFooter unplaced = footer;
    for (ChannelFooter& channel : *unplaced.mutable_channels()) channel.clear_index_to_world();
    std::string stored = unplaced.SerializeAsString();
    if (!cache_ || stored != stored_footer_ || file_bytes != file_bytes_ || budget_bytes != budget_bytes_ ||
        components > components_) {
        const int edge = int(footer.brick_edge());
        if (!isBrickEdge(edge))
            return fail(ErrorCode::kCorrupt,
                        fmt::format("the frame's footer names a brick edge of {} cells, which cannot be",
                                    footer.brick_edge()));
        channels_.clear();
        cache_.emplace(budget_bytes, pageFloats(BrickShape{edge}, components));
        stored_footer_ = std::move(stored);
        file_bytes_ = file_bytes;
        budget_bytes_ = budget_bytes;
        components_ = components;
    }
    footer_ = footer;
    for (auto& [index, channel] : channels_)
        if (Result<void> placed = channel.place(footer.channels(int(index))); !placed) return placed;
    if (cache_->capacity() == 0)
        return fail(ErrorCode::kInvalid,
                    fmt::format("--cache {} is less than one brick of this dataset; give at least {} bytes",
                                budget_bytes, cache_->pageBytes()));
    cache_->beginPicture();
    return {};
}

Result<PagedChannel*> ResidentFrame::channel(std::uint32_t index) {
    if (const auto found = channels_.find(index); found != channels_.end()) return &found->second;
    Result<PagedChannel> made =
        PagedChannel::create(footer_.channels(int(index)), index, int(footer_.brick_edge()), file_bytes_);
    if (!made) return tl::unexpected(made.error());
    return &channels_.emplace(index, std::move(*made)).first->second;
}

std::uint64_t ResidentFrame::treeBytes() const {
    std::uint64_t bytes = 0;
    for (const auto& [index, channel] : channels_) bytes += channel.treeBytes();
    return bytes;
}

}  // namespace brickyard

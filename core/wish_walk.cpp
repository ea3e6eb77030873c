#include "core/wish_walk.h"

#include <fmt/format.h>

#include <algorithm>

#include "core/brick_codec.h"

namespace brickyard {

Result<WishWalk> WishWalk::create(std::shared_ptr<const FrameReader> frame, PageWish wish) {
    wish.credit_bytes = std::min(wish.credit_bytes, kMaxWishBytes);
    // A block has no node number: the same block must always have the same address.
    for (WishedPage& page : wish.pages)
        if (page.is_block) page.address.node = 0, page.address.draft = false;
    WishWalk walk(std::move(frame), std::move(wish));
    for (CameraView& view : walk.wish_.views) {
        auto camera = PinholeCamera::create(view.camera, view.width, view.height);
        if (!camera) return tl::unexpected(camera.error());
        walk.cameras_.push_back(*camera);
        // A channel named twice would be sent twice.
        std::sort(view.channels.begin(), view.channels.end());
        view.channels.erase(std::unique(view.channels.begin(), view.channels.end()), view.channels.end());
        const auto channels = std::uint32_t(walk.frame_->footer().channels_size());
        if (!view.channels.empty() && view.channels.back() >= channels)
            return fail(ErrorCode::kInvalid,
                        fmt::format("view: no channel {}; the frame has {}", view.channels.back(), channels));
    }
    return walk;
}

std::optional<WishWalk::Step> WishWalk::next() {
    if (plan(ReadMode::kMayBlock) != Plan::kPage) return std::nullopt;
    const Planned next = *planned_;
    if (!next.bytes) {
        skipPlanned();
        return Step{next.page, tl::unexpected(next.bytes.error())};
    }
    std::vector<std::byte> bytes(*next.bytes);
    if (auto read = readPlanned(bytes, ReadMode::kMayBlock); !read)
        return Step{next.page, tl::unexpected(read.error())};
    return Step{next.page, std::move(bytes)};
}

WishWalk::Plan WishWalk::plan(ReadMode mode) {
    for (;;) {
        if (planned_) return Plan::kPage;
        if (credit_exhausted_) return Plan::kDone;
        if (next_page_ < wish_.pages.size()) {
            auto found = look(wish_.pages[next_page_], mode);
            if (found && !found->bytes && found->bytes.error().code == ErrorCode::kWouldBlock)
                return Plan::kWaits;
            ++next_page_;
            planned_ = std::move(found);
        } else if (next_view_ == wish_.views.size()) {
            return Plan::kDone;
        } else if (mode == ReadMode::kCachedOnly) {
            // A descent takes its time even where all of its blocks are in memory.
            return Plan::kWaits;
        } else {
            descend();
        }
    }
}

void WishWalk::beginView() {
    const CameraView& view = wish_.views[next_view_];
    const float pixels_per_voxel = view.pixels_per_voxel > 0 ? view.pixels_per_voxel : 1;
    for (const std::uint32_t channel : view.channels) {
        auto descent = ViewDescent::create(cameras_[next_view_], frame_->footer().channels(int(channel)),
                                           channel, int(frame_->footer().brick_edge()), pixels_per_voxel);
        // An open frame's transforms are sound.
        if (descent) descents_.push_back({channel, std::move(*descent), 0, std::nullopt, false});
    }
    // What the list has sent already is not sent again.
    for (const WishedPage& page : wish_.pages)
        (page.is_block ? listed_blocks_ : listed_bricks_).insert(page.address);
}

// The next page of the view: each channel keeps its own order, and the one that has had the fewest bytes goes
// next.
void WishWalk::descend() {
    if (descents_.empty()) beginView();
    ChannelDescent* best = nullptr;
    for (ChannelDescent& channel : descents_) {
        if (!channel.next && !channel.over) {
            std::uint32_t failed_block = 0;
            const auto load = [&](std::uint32_t block) {
                auto loaded = frame_->block(channel.channel, block);
                if (!loaded) failed_block = block;
                return loaded;
            };
            auto step = channel.descent.next(load);
            channel.over = !step || !*step;
            if (!step) {
                planned_ = Planned{{true, {channel.channel, failed_block, 0}}, tl::unexpected(step.error())};
                return;
            }
            channel.next = *step;
        }
        if (channel.next && (best == nullptr || channel.bytes < best->bytes)) best = &channel;
    }
    if (best == nullptr) {
        dropView();
        return;
    }
    const DescentStep step = *best->next;
    best->next.reset();
    best->bytes += step.bytes;
    if (!(step.is_block ? listed_blocks_ : listed_bricks_).contains(step.page))
        planned_ = look({step.is_block, step.page}, ReadMode::kMayBlock);
}

std::size_t WishWalk::viewBytes() const {
    std::size_t bytes = 0;
    for (const ChannelDescent& channel : descents_) bytes += channel.descent.memoryBytes();
    return bytes;
}

void WishWalk::dropView() {
    if (next_view_ == wish_.views.size()) return;
    ++next_view_;
    descents_.clear();
}

std::optional<WishWalk::Planned> WishWalk::look(const WishedPage& page, ReadMode mode) {
    // Sizes are known before the bytes are read, so nothing is read that will not be sent.
    std::uint32_t bytes = 0;
    if (page.is_block) {
        const auto stored = frame_->storedBlockBytes(page.address.channel, page.address.block);
        if (!stored) return Planned{page, tl::unexpected(stored.error())};
        bytes = *stored;
    } else {
        const auto found = frame_->findBrick(page.address, mode);
        if (!found) return Planned{page, tl::unexpected(found.error())};
        record_ = *found;
        bytes = page.address.draft ? record_.draft_bytes : record_.payload_bytes;
    }
    // Nobody could receive it, and nobody may be made to allocate it.
    if (bytes > kMaxPayloadBytes)
        return Planned{
            page, fail(ErrorCode::kCorrupt,
                       fmt::format("{}: a page claims {} bytes, more than {}; convert this frame again",
                                   frame_->store().path().filename().string(), bytes, kMaxPayloadBytes))};
    if (bytes > wish_.credit_bytes - sent_bytes_) {
        credit_exhausted_ = true;
        return std::nullopt;
    }
    return Planned{page, bytes};
}

Result<void> WishWalk::readPlanned(std::span<std::byte> out, ReadMode mode) {
    const PageAddress& address = planned_->page.address;
    auto read = planned_->page.is_block
                    ? frame_->store().readBlockInto(address.channel, address.block, out, mode)
                    : frame_->store().readPayloadInto(record_, out, mode);
    if (!read && read.error().code == ErrorCode::kWouldBlock) return read;
    if (read) sent_bytes_ += out.size();
    planned_.reset();
    return read;
}

}  // namespace brickyard

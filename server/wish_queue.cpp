#include "server/wish_queue.h"

#include "core/stream_frame.h"

namespace brickyard {
namespace {

PageWish pageWishOf(const Wish& wish) {
    PageWish list;
    list.credit_bytes = wish.credit_bytes();
    list.pages.reserve(std::size_t(wish.blocks_size()) + std::size_t(wish.pages_size()));
    for (const BlockWish& block : wish.blocks())
        list.pages.push_back({true, {block.channel(), block.block(), 0}});
    for (const PageRef& page : wish.pages())
        list.pages.push_back({false, {page.channel(), page.block(), page.node(), page.draft()}});
    if (wish.has_camera()) {
        const CameraWish& seen = wish.camera();
        CameraView view;
        view.camera = seen.camera();
        view.width = seen.width();
        view.height = seen.height();
        view.channels.assign(seen.channels().begin(), seen.channels().end());
        view.pixels_per_voxel = seen.pixels_per_voxel();
        list.views.push_back(std::move(view));
    }
    return list;
}

}  // namespace

Result<void> WishQueue::replace(const Wish& wish, std::shared_ptr<const FrameReader> frame) {
    current_.reset();
    auto walk = WishWalk::create(std::move(frame), pageWishOf(wish));
    if (!walk) return tl::unexpected(walk.error());
    current_.emplace(Current{wish.epoch(), wish.dataset_id(), wish.frame(), std::move(*walk)});
    return {};
}

std::optional<OutMessage> WishQueue::next() {
    if (!current_) return std::nullopt;
    auto step = current_->walk.next();
    if (!step) {
        StreamHeader header;
        WishDone& done = *header.mutable_wish_done();
        done.set_epoch(current_->epoch);
        done.set_sent_bytes(current_->walk.sentBytes());
        done.set_credit_exhausted(current_->walk.creditExhausted());
        current_.reset();
        return OutMessage{encodeStreamHead(header), {}};
    }
    OutMessage message{encodeStreamHead(describe(*step)), {}};
    if (step->bytes) message.payload = std::move(*step->bytes);
    return message;
}

StreamHeader WishQueue::describe(const WishWalk::Step& step) const {
    const PageAddress& address = step.page.address;
    StreamHeader header;
    if (!step.bytes) {
        Failed& failed = *header.mutable_failed();
        failed.set_reason(step.bytes.error().code == ErrorCode::kNotFound ? Failed::REASON_NO_PAGE
                                                                          : Failed::REASON_IO);
        failed.set_message(step.bytes.error().message);
        failed.set_epoch(current_->epoch);
        failed.set_dataset_id(current_->dataset_id);
        failed.set_frame(current_->frame);
        if (step.page.is_block) {
            failed.mutable_block()->set_channel(address.channel);
            failed.mutable_block()->set_block(address.block);
        } else {
            failed.mutable_page()->set_channel(address.channel);
            failed.mutable_page()->set_block(address.block);
            failed.mutable_page()->set_node(address.node);
            failed.mutable_page()->set_draft(address.draft);
        }
    } else if (step.page.is_block) {
        auto& block = *header.mutable_block_page();
        block.set_epoch(current_->epoch);
        block.set_dataset_id(current_->dataset_id);
        block.set_frame(current_->frame);
        block.set_channel(address.channel);
        block.set_block(address.block);
    } else {
        Page& page = *header.mutable_page();
        page.set_epoch(current_->epoch);
        page.set_dataset_id(current_->dataset_id);
        page.set_frame(current_->frame);
        page.mutable_ref()->set_channel(address.channel);
        page.mutable_ref()->set_block(address.block);
        page.mutable_ref()->set_node(address.node);
        page.mutable_ref()->set_draft(address.draft);
    }
    return header;
}

}  // namespace brickyard

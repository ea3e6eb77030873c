#include "server/wish_queue.h"

#include <algorithm>

#include "core/camera_framing.h"
#include "core/default_density.h"
#include "core/stream_frame.h"

namespace brickyard {
namespace {

// Which channels a camera wish means: by number, or by name for those that know no numbers yet.
std::vector<std::uint32_t> channelsOf(const CameraWish& seen, const FrameFooter& footer) {
    std::vector<std::uint32_t> channels(seen.channels().begin(), seen.channels().end());
    if (!channels.empty()) return channels;
    for (const std::string& name : seen.channel_names()) {
        if (name.empty()) {
            if (const auto density = defaultDensity(footer)) channels.push_back(*density);
            continue;
        }
        for (int c = 0; c < footer.channels_size(); ++c)
            if (footer.channels(c).name() == name) channels.push_back(std::uint32_t(c));
    }
    return channels;
}

// Lists by the entries there is memory for.
PageWish pageWishOf(const Wish& wish, const FrameFooter& footer, std::size_t max_entries) {
    PageWish list;
    list.credit_bytes = wish.credit_bytes();
    list.pages.reserve(
        std::min(max_entries, std::size_t(wish.blocks_size()) + std::size_t(wish.pages_size())));
    for (const BlockWish& block : wish.blocks())
        if (list.pages.size() < max_entries)
            list.pages.push_back({true, {block.channel(), block.block(), 0}});
    for (const PageRef& page : wish.pages())
        if (list.pages.size() < max_entries)
            list.pages.push_back({false, {page.channel(), page.block(), page.node(), page.draft()}});
    if (!wish.has_camera()) return list;
    const CameraWish& seen = wish.camera();
    CameraView view;
    view.width = seen.width();
    view.height = seen.height();
    view.channels = channelsOf(seen, footer);
    view.pixels_per_voxel = seen.pixels_per_voxel();
    if (seen.has_camera()) {
        view.camera = seen.camera();
    } else if (!view.channels.empty() && view.channels.front() < std::uint32_t(footer.channels_size())) {
        view.camera = frameChannel(footer.channels(int(view.channels.front())),
                                   double(view.width) / double(view.height));
    } else {
        return list;  // nothing to look at
    }
    list.views.push_back(std::move(view));
    return list;
}

}  // namespace

Result<void> WishQueue::replace(const Wish& wish, std::uint32_t frame_number,
                                std::shared_ptr<const FrameReader> frame) {
    if (metrics_ != nullptr) metrics_->wishReceived(current_.has_value());
    current_.reset();
    const std::size_t entries = std::size_t(wish.blocks_size()) + std::size_t(wish.pages_size());
    std::size_t max_entries = entries;
    ByteBudget::Share memory;
    if (budget_ != nullptr) {
        memory = budget_->reserveUpTo(entries * sizeof(WishedPage));
        max_entries = memory.bytes() / sizeof(WishedPage);
    }
    const bool cut_short = max_entries < entries;
    PageWish list = pageWishOf(wish, frame->footer(), max_entries);
    if (cut_short) list.views.clear();
    auto walk = WishWalk::create(std::move(frame), std::move(list));
    if (!walk) return tl::unexpected(walk.error());
    current_.emplace(Current{wish.epoch(),
                             wish.dataset_id(),
                             frame_number,
                             cut_short,
                             std::chrono::steady_clock::now(),
                             std::move(*walk),
                             std::move(memory),
                             0,
                             {}});
    return {};
}

WishQueue::Step WishQueue::addTo(OutBatch& batch, ReadMode mode) {
    if (!current_) return Step::kNothing;
    if (current_->failure) return addFailure(batch);
    WishWalk& walk = current_->walk;
    const auto plan = walk.plan(mode);
    // A view that looks at very many nodes ends where the memory for all clients does.
    if (budget_ != nullptr && walk.viewBytes() > current_->view_bytes) {
        const std::uint64_t wanted = current_->memory.bytes() - current_->view_bytes + 2 * walk.viewBytes();
        if (current_->memory.growTo(wanted)) {
            current_->view_bytes = 2 * walk.viewBytes();
        } else {
            walk.dropView();
            current_->cut_short = true;
        }
    }
    switch (plan) {
        case WishWalk::Plan::kWaits: return Step::kWaits;
        case WishWalk::Plan::kDone: return addDone(batch);
        case WishWalk::Plan::kPage: break;
    }
    const WishedPage page = walk.planned().page;
    if (!walk.planned().bytes) {
        current_->failure = walk.planned();
        walk.skipPlanned();
        return addFailure(batch);
    }
    const std::size_t bytes = *walk.planned().bytes;
    describe(page);
    encodeStreamHeadInto(header_, head_);
    if (!batch.fits(head_.size() + bytes)) {
        needed_bytes_ = OutBatch::framedBytes(head_.size() + bytes);
        return Step::kFull;
    }
    const auto payload = batch.add(head_, bytes, /*is_page=*/true);
    if (auto read = walk.readPlanned(payload, mode); !read) {
        batch.removeLast();
        if (read.error().code == ErrorCode::kWouldBlock) return Step::kWaits;
        current_->failure = Planned{page, tl::unexpected(read.error())};
        return addFailure(batch);
    }
    if (metrics_ != nullptr)
        metrics_->pageSent(
            Via::kStream, page.is_block, bytes,
            std::chrono::duration<double>(std::chrono::steady_clock::now() - current_->since).count());
    return Step::kAdded;
}

WishQueue::Step WishQueue::addDone(OutBatch& batch) {
    StreamHeader header;
    WishDone& done = *header.mutable_wish_done();
    done.set_epoch(current_->epoch);
    done.set_sent_bytes(current_->walk.sentBytes());
    done.set_credit_exhausted(current_->walk.creditExhausted() || current_->cut_short);
    const Step added = addHead(batch, header);
    if (added == Step::kAdded) current_.reset();
    return added;
}

WishQueue::Step WishQueue::addFailure(OutBatch& batch) {
    const WishedPage& page = current_->failure->page;
    const Error& error = current_->failure->bytes.error();
    if (metrics_ != nullptr && error.code != ErrorCode::kNotFound) metrics_->error("disk");
    const PageAddress& address = page.address;
    StreamHeader header;
    Failed& failed = *header.mutable_failed();
    failed.set_reason(error.code == ErrorCode::kNotFound ? Failed::REASON_NO_PAGE : Failed::REASON_IO);
    failed.set_message(error.message);
    failed.set_epoch(current_->epoch);
    failed.set_dataset_id(current_->dataset_id);
    failed.set_frame(current_->frame);
    if (page.is_block) {
        failed.mutable_block()->set_channel(address.channel);
        failed.mutable_block()->set_block(address.block);
    } else {
        failed.mutable_page()->set_channel(address.channel);
        failed.mutable_page()->set_block(address.block);
        failed.mutable_page()->set_node(address.node);
        failed.mutable_page()->set_draft(address.draft);
    }
    const Step added = addHead(batch, header);
    if (added == Step::kAdded) current_->failure.reset();
    return added;
}

WishQueue::Step WishQueue::addHead(OutBatch& batch, const StreamHeader& header) {
    encodeStreamHeadInto(header, head_);
    if (!batch.fits(head_.size())) {
        needed_bytes_ = OutBatch::framedBytes(head_.size());
        return Step::kFull;
    }
    batch.add(head_, 0, /*is_page=*/true);
    return Step::kAdded;
}

void WishQueue::describe(const WishedPage& wished) {
    const PageAddress& address = wished.address;
    if (wished.is_block) {
        auto& block = *header_.mutable_block_page();
        block.set_epoch(current_->epoch);
        block.set_dataset_id(current_->dataset_id);
        block.set_frame(current_->frame);
        block.set_channel(address.channel);
        block.set_block(address.block);
    } else {
        Page& page = *header_.mutable_page();
        page.set_epoch(current_->epoch);
        page.set_dataset_id(current_->dataset_id);
        page.set_frame(current_->frame);
        page.mutable_ref()->set_channel(address.channel);
        page.mutable_ref()->set_block(address.block);
        page.mutable_ref()->set_node(address.node);
        page.mutable_ref()->set_draft(address.draft);
    }
}

}  // namespace brickyard

#include "server/conversation.h"

#include <fmt/format.h>

#include <algorithm>

#include "core/stream_frame.h"

namespace brickyard {
namespace {

// The first limit of stream.proto that a wish breaks, or nothing.
std::string brokenLimit(const Wish& wish) {
    if (wish.pages_size() > kMaxWishPages)
        return fmt::format("a wish of {} pages is over the limit of {}", wish.pages_size(), kMaxWishPages);
    if (wish.blocks_size() > kMaxWishBlocks)
        return fmt::format("a wish of {} tree blocks is over the limit of {}", wish.blocks_size(),
                           kMaxWishBlocks);
    if (!wish.has_camera()) return {};
    const CameraWish& seen = wish.camera();
    if (seen.channels_size() > kMaxWishChannels)
        return fmt::format("a camera wish of {} channels is over the limit of {}", seen.channels_size(),
                           kMaxWishChannels);
    if (seen.width() < 1 || seen.width() > kMaxPictureEdge || seen.height() < 1 ||
        seen.height() > kMaxPictureEdge)
        return fmt::format("a picture of {}x{} pixels is outside 1 to {} an edge", seen.width(),
                           seen.height(), kMaxPictureEdge);
    // Written so that NaN is refused too.
    if (seen.channel_names_size() > kMaxWishChannels)
        return fmt::format("a camera wish of {} channel names is over the limit of {}",
                           seen.channel_names_size(), kMaxWishChannels);
    for (const std::string& name : seen.channel_names())
        if (name.size() > std::size_t(kMaxChannelNameBytes))
            return fmt::format("a channel's name in a camera wish is over the limit of {} bytes",
                               kMaxChannelNameBytes);
    if (!(seen.pixels_per_voxel() >= 0)) return "pixels_per_voxel is not a number of at least 0";
    return {};
}

// A name from outside, fit for a log line.
std::string printable(std::string_view text) {
    std::string clean;
    for (const char c : text) clean += c >= ' ' && c <= '~' ? c : '?';
    return clean;
}

}  // namespace

Conversation::Conversation(ConversationServices services)
    : services_(std::move(services)), wishes_(services_.wish_budget, services_.metrics) {}

void Conversation::receive(std::span<const std::byte> message) {
    if (message.size() > kMaxClientMessageBytes)
        return end(Failed::REASON_PROTOCOL, fmt::format("a message of {} bytes is over the limit of {}",
                                                        message.size(), kMaxClientMessageBytes));
    const auto frame =
        parseStreamFrame(message, {.header_bytes = kMaxClientMessageBytes, .payload_bytes = 0});
    if (!frame) return end(Failed::REASON_PROTOCOL, frame.error().message);

    const StreamHeader& header = frame->header;
    if (!greeted_ && !header.has_hello())
        return end(Failed::REASON_PROTOCOL, "the first message must be Hello");
    switch (header.message_case()) {
        case StreamHeader::kHello: return onHello(header.hello());
        case StreamHeader::kOpen: return onOpen(header.open());
        case StreamHeader::kOpenFrame: return onOpenFrame(header.open_frame());
        case StreamHeader::kWish: return onWish(header.wish());
        case StreamHeader::kPing: {
            StreamHeader pong;
            pong.mutable_pong()->set_number(header.ping().number());
            return answer(pong);
        }
        default: return end(Failed::REASON_PROTOCOL, "a client sent a message that only servers send");
    }
}

Conversation::Filled Conversation::fill(OutBatch& batch, ReadMode mode,
                                        const std::function<bool()>& interrupted) {
    while (!interrupted()) {
        if (!answers_.empty()) {
            const std::vector<std::byte>& next = answers_.front();
            if (!batch.fits(next.size())) {
                needed_bytes_ = OutBatch::framedBytes(next.size());
                return Filled::kFull;
            }
            // A page that is in the batch may be dropped; what follows it must be one, too.
            if (batch.endsWithPage()) return Filled::kFull;
            batch.add(next, 0, /*is_page=*/false);
            answer_bytes_ -= next.size();
            answers_.pop_front();
            continue;
        }
        if (over_) return Filled::kNothing;
        switch (wishes_.addTo(batch, mode)) {
            case WishQueue::Step::kNothing: return Filled::kNothing;
            case WishQueue::Step::kAdded: break;
            case WishQueue::Step::kFull: needed_bytes_ = wishes_.neededBytes(); return Filled::kFull;
            case WishQueue::Step::kWaits: return Filled::kWaits;
        }
    }
    return Filled::kFull;
}

bool Conversation::checkToken(const std::string& token, const char* why_not) {
    auto tokens = services_.tokens ? services_.tokens() : nullptr;
    if (greeted_ && tokens == checked_) return true;
    Access access;
    if (tokens && tokens->required()) {
        const Access* found = tokens->find(token);
        if (found == nullptr) {
            end(Failed::REASON_TOKEN, why_not);
            return false;
        }
        access = *found;
    }
    // A stream goes on with what it has opened, so that must still be the token's to open.
    for (const OpenDataset& open : datasets_)
        if (!access.allows(open.name)) {
            end(Failed::REASON_TOKEN, why_not);
            return false;
        }
    offer_.emplace(*services_.catalog, std::move(access));
    checked_ = std::move(tokens);
    return true;
}

void Conversation::onHello(const Hello& hello) {
    if (greeted_) return end(Failed::REASON_PROTOCOL, "Hello was said twice");
    if (hello.protocol_major() != kProtocolMajor)
        return end(
            Failed::REASON_VERSION,
            fmt::format("this server speaks protocol {}.{} and the client {}.{}; use the same major version",
                        kProtocolMajor, kProtocolMinor, hello.protocol_major(), hello.protocol_minor()));
    if (hello.token().size() > AccessTokens::kMaxTokenBytes || hello.client().size() > kMaxClientNameBytes)
        return end(Failed::REASON_PROTOCOL, "the token or the client's name in Hello is over its limit");
    if (!checkToken(hello.token(), hello.token().empty() ? "this server asks for a token; give one"
                                                         : "the token is not the server's; check it"))
        return;
    client_name_ = printable(hello.client());
    client_minor_ = hello.protocol_minor();
    token_ = hello.token();
    greeted_ = true;
    told_names_ = offer_->names();
}

void Conversation::onOpen(const Open& open) {
    if (open.dataset().size() > kMaxDatasetNameBytes)
        return end(Failed::REASON_PROTOCOL, "the name of a dataset is over the limit of 1024 bytes");
    auto dataset = offer_->dataset(open.dataset());
    open_failed_ = !dataset;
    if (!dataset) {
        Failed failed;
        failed.set_reason(Failed::REASON_NO_DATASET);
        failed.set_message(dataset.error().message);
        return fail(failed);
    }
    auto known = std::find_if(datasets_.begin(), datasets_.end(),
                              [&](const OpenDataset& opened) { return opened.name == open.dataset(); });
    if (known == datasets_.end()) {
        if (datasets_.size() == kMaxOpenDatasets)
            return end(
                Failed::REASON_PROTOCOL,
                fmt::format("more than {} datasets on one connection; use a second one", kMaxOpenDatasets));
        known = datasets_.insert(datasets_.end(), {open.dataset(), {}, {}});
    }
    known->told = *dataset;
    StreamHeader header;
    Welcome& welcome = *header.mutable_welcome();
    welcome.set_protocol_major(kProtocolMajor);
    welcome.set_protocol_minor(kProtocolMinor);
    welcome.set_dataset_id(std::uint32_t(known - datasets_.begin()) + 1);
    *welcome.mutable_manifest() = (*dataset)->manifest();
    answer(header);
}

Conversation::OpenDataset* Conversation::datasetOf(std::uint32_t id, const char* message) {
    if (id != 0 && id <= datasets_.size()) return &datasets_[id - 1];
    // Said right behind an Open that failed: the client could not know.
    if (open_failed_ && id == datasets_.size() + 1) {
        Failed failed;
        failed.set_reason(Failed::REASON_NO_DATASET);
        failed.set_message(fmt::format("{} names a dataset that could not be opened", message));
        failed.set_dataset_id(id);
        fail(failed);
        return nullptr;
    }
    end(Failed::REASON_PROTOCOL, fmt::format("{} names dataset {}, which is not open", message, id));
    return nullptr;
}

Result<ServedFrame> Conversation::frameOf(OpenDataset& dataset, std::uint32_t number, bool first) const {
    if (!first)
        for (const ServedFrame& kept : dataset.frames)
            if (kept.number == number) return kept;
    return offer_->frame(dataset.name, first ? std::nullopt : std::optional(number));
}

void Conversation::keep(OpenDataset& dataset, const ServedFrame& frame) {
    std::erase_if(dataset.frames, [&](const ServedFrame& kept) { return kept.number == frame.number; });
    if (dataset.frames.size() == kMaxKeptFrames) dataset.frames.erase(dataset.frames.begin());
    dataset.frames.push_back(frame);
}

namespace {

Failed noFrame(const Error& error, std::uint32_t dataset_id, std::uint32_t frame) {
    Failed failed;
    failed.set_reason(error.code == ErrorCode::kNotFound ? Failed::REASON_NO_FRAME : Failed::REASON_IO);
    failed.set_message(error.message);
    failed.set_dataset_id(dataset_id);
    failed.set_frame(frame);
    return failed;
}

}  // namespace

void Conversation::onOpenFrame(const OpenFrame& open_frame) {
    const std::uint32_t id = open_frame.dataset_id();
    OpenDataset* dataset = datasetOf(id, "OpenFrame");
    if (dataset == nullptr) return;
    // As it is now, even where this connection has it open.
    const auto frame = offer_->frame(
        dataset->name, open_frame.first_frame() ? std::nullopt : std::optional(open_frame.frame()));
    if (!frame) {
        if (services_.metrics != nullptr && frame.error().code != ErrorCode::kNotFound)
            services_.metrics->error("disk");
        return fail(noFrame(frame.error(), id, open_frame.frame()));
    }
    keep(*dataset, *frame);
    StreamHeader header;
    FrameOpened& opened = *header.mutable_frame_opened();
    opened.set_dataset_id(id);
    opened.set_frame(frame->number);
    *opened.mutable_footer() = frame->reader->footer();
    opened.set_footer_xxh64(frame->reader->store().footerChecksum());
    answer(header);
}

void Conversation::onWish(const Wish& wish) {
    if (const auto broken = brokenLimit(wish); !broken.empty()) return end(Failed::REASON_PROTOCOL, broken);
    const std::uint32_t id = wish.dataset_id();
    OpenDataset* dataset = datasetOf(id, "a wish");
    if (dataset == nullptr) return;
    if (epoch_ && wish.epoch() <= *epoch_) return;
    epoch_ = wish.epoch();
    ++wish_count_;

    const auto frame = frameOf(*dataset, wish.frame(), wish.first_frame());
    if (!frame) {
        // Nothing of an older wish may follow either, so the newest one ends here.
        wishes_.clear();
        Failed failed = noFrame(frame.error(), id, wish.frame());
        failed.set_epoch(wish.epoch());
        return fail(failed);
    }
    if (const auto queued = wishes_.replace(wish, frame->number, frame->reader); !queued)
        end(Failed::REASON_PROTOCOL, queued.error().message);
}

void Conversation::tellNews() {
    if (!greeted_ || over_) return;
    if (!checkToken(token_, "the token counts no more; ask for another one")) return;
    if (client_minor_ == 0) return;
    auto names = offer_->names();
    if (names != told_names_) {
        StreamHeader header;
        // Named also where no dataset is left: a header must say something.
        CatalogChanged& changed = *header.mutable_catalog_changed();
        for (const std::string& name : names) changed.add_datasets(name);
        told_names_ = std::move(names);
        answer(header);
    }
    for (std::size_t i = 0; i < datasets_.size(); ++i) {
        OpenDataset& dataset = datasets_[i];
        const auto now = offer_->dataset(dataset.name);
        const auto current = now ? *now : nullptr;
        if (current == dataset.told) continue;
        dataset.told = current;
        StreamHeader header;
        DatasetChanged& changed = *header.mutable_dataset_changed();
        changed.set_dataset_id(std::uint32_t(i) + 1);
        changed.set_removed(current == nullptr);
        if (current) *changed.mutable_manifest() = current->manifest();
        answer(header);
    }
}

void Conversation::answer(const StreamHeader& header) {
    if (header.ByteSizeLong() > kMaxServerHeaderBytes) {
        Failed failed;
        failed.set_reason(Failed::REASON_IO);
        failed.set_message(
            "the index of this dataset is too long for one message; serve fewer frames or channels");
        return fail(failed);
    }
    answers_.push_back(encodeStreamHead(header));
    answer_bytes_ += answers_.back().size();
}

void Conversation::fail(const Failed& failed) {
    StreamHeader header;
    *header.mutable_failed() = failed;
    answer(header);
}

void Conversation::end(Failed::Reason reason, const std::string& why) {
    if (over_) return;
    over_ = true;
    wishes_.clear();
    if (services_.metrics != nullptr)
        services_.metrics->error(reason == Failed::REASON_TOKEN  ? "refused"
                                 : reason == Failed::REASON_BUSY ? "memory"
                                                                 : "protocol");
    Failed failed;
    failed.set_reason(reason);
    failed.set_message(why);
    fail(failed);
}

}  // namespace brickyard

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

bool tokensMatch(std::string_view expected, std::string_view given) {
    unsigned difference = expected.size() == given.size() ? 0 : 1;
    for (std::size_t i = 0; i < given.size(); ++i)
        difference |= static_cast<unsigned char>(given[i]) ^
                      (expected.empty() ? 0u : static_cast<unsigned char>(expected[i % expected.size()]));
    return difference == 0;
}

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

std::optional<OutMessage> Conversation::next() {
    if (!answers_.empty()) {
        OutMessage message = std::move(answers_.front());
        answers_.pop_front();
        return message;
    }
    if (over_) return std::nullopt;
    return wishes_.next();
}

void Conversation::onHello(const Hello& hello) {
    if (greeted_) return end(Failed::REASON_PROTOCOL, "a second Hello; a connection has one");
    // The version comes first: a client of another one may mean something else by every other field.
    if (hello.protocol_major() != kProtocolMajor)
        return end(Failed::REASON_VERSION,
                   fmt::format(
                       "this server speaks protocol {}.{} and the client {}.{}; use a {} of the same version",
                       kProtocolMajor, kProtocolMinor, hello.protocol_major(), hello.protocol_minor(),
                       hello.protocol_major() > kProtocolMajor ? "server" : "client"));
    if (hello.token().size() > kMaxTokenBytes || hello.client().size() > kMaxClientNameBytes)
        return end(Failed::REASON_PROTOCOL, "the token or the client's name in Hello is over its limit");
    if (!options_.token.empty() && !tokensMatch(options_.token, hello.token()))
        return end(Failed::REASON_TOKEN, hello.token().empty() ? "this server asks for a token; give one"
                                                               : "the token is not the server's; check it");
    client_name_ = printable(hello.client());
    greeted_ = true;
}

void Conversation::onOpen(const Open& open) {
    if (open.dataset().size() > kMaxDatasetNameBytes)
        return end(Failed::REASON_PROTOCOL, "the name of a dataset is over the limit of 1024 bytes");
    const auto dataset = catalog_.dataset(open.dataset());
    if (!dataset) {
        Failed failed;
        failed.set_reason(Failed::REASON_NO_DATASET);
        failed.set_message(dataset.error().message);
        return fail(failed);
    }
    auto known = std::find(datasets_.begin(), datasets_.end(), open.dataset());
    if (known == datasets_.end()) {
        if (datasets_.size() == kMaxOpenDatasets)
            return end(
                Failed::REASON_PROTOCOL,
                fmt::format("more than {} datasets on one connection; use a second one", kMaxOpenDatasets));
        known = datasets_.insert(datasets_.end(), open.dataset());
    }
    StreamHeader header;
    Welcome& welcome = *header.mutable_welcome();
    welcome.set_protocol_major(kProtocolMajor);
    welcome.set_protocol_minor(kProtocolMinor);
    welcome.set_dataset_id(std::uint32_t(known - datasets_.begin()) + 1);
    *welcome.mutable_manifest() = (*dataset)->manifest();
    answer(header);
}

void Conversation::onOpenFrame(const OpenFrame& open_frame) {
    const std::uint32_t id = open_frame.dataset_id();
    if (id == 0 || id > datasets_.size())
        return end(Failed::REASON_PROTOCOL, fmt::format("OpenFrame names dataset {}, which is not open", id));
    const auto frame = catalog_.frame(datasets_[id - 1], open_frame.frame());
    if (!frame) {
        Failed failed;
        failed.set_reason(frame.error().code == ErrorCode::kNotFound ? Failed::REASON_NO_FRAME
                                                                     : Failed::REASON_IO);
        failed.set_message(frame.error().message);
        failed.set_dataset_id(id);
        failed.set_frame(open_frame.frame());
        return fail(failed);
    }
    StreamHeader header;
    FrameOpened& opened = *header.mutable_frame_opened();
    opened.set_dataset_id(id);
    opened.set_frame(open_frame.frame());
    *opened.mutable_footer() = (*frame)->footer();
    answer(header);
}

void Conversation::onWish(const Wish& wish) {
    if (const auto broken = brokenLimit(wish); !broken.empty()) return end(Failed::REASON_PROTOCOL, broken);
    const std::uint32_t id = wish.dataset_id();
    if (id == 0 || id > datasets_.size())
        return end(Failed::REASON_PROTOCOL, fmt::format("a wish names dataset {}, which is not open", id));
    if (epoch_ && wish.epoch() <= *epoch_) return;
    epoch_ = wish.epoch();

    const auto frame = catalog_.frame(datasets_[id - 1], wish.frame());
    if (!frame) {
        // Nothing of an older wish may follow either, so the newest one ends here.
        wishes_ = {};
        Failed failed;
        failed.set_reason(frame.error().code == ErrorCode::kNotFound ? Failed::REASON_NO_FRAME
                                                                     : Failed::REASON_IO);
        failed.set_message(frame.error().message);
        failed.set_epoch(wish.epoch());
        failed.set_dataset_id(id);
        failed.set_frame(wish.frame());
        return fail(failed);
    }
    if (const auto queued = wishes_.replace(wish, *frame); !queued)
        end(Failed::REASON_PROTOCOL, queued.error().message);
}

void Conversation::answer(const StreamHeader& header) {
    if (header.ByteSizeLong() > kMaxServerHeaderBytes) {
        Failed failed;
        failed.set_reason(Failed::REASON_IO);
        failed.set_message(
            "the index of this dataset is too long for one message; serve fewer frames or channels");
        return fail(failed);
    }
    answers_.push_back({encodeStreamHead(header), {}});
}

void Conversation::fail(const Failed& failed) {
    StreamHeader header;
    *header.mutable_failed() = failed;
    answer(header);
}

void Conversation::end(Failed::Reason reason, const std::string& why) {
    if (over_) return;
    over_ = true;
    Failed failed;
    failed.set_reason(reason);
    failed.set_message(why);
    fail(failed);
}

}  // namespace brickyard

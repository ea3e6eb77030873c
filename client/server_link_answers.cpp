// What comes from the server: which source each message is for, and what it changes.

#include <fmt/format.h>

#include <algorithm>

#include "client/server_link.h"
#include "core/brick_codec.h"
#include "core/stream_frame.h"

namespace brickyard {
namespace {

ErrorCode codeOf(Failed::Reason reason) {
    switch (reason) {
        case Failed::REASON_VERSION: return ErrorCode::kTooNew;
        case Failed::REASON_TOKEN:
        case Failed::REASON_BUSY: return ErrorCode::kRefused;
        case Failed::REASON_NO_DATASET:
        case Failed::REASON_NO_FRAME:
        case Failed::REASON_NO_PAGE: return ErrorCode::kNotFound;
        case Failed::REASON_IO: return ErrorCode::kIo;
        default: return ErrorCode::kInvalid;
    }
}

// A peer's words, fit to stand in our one line.
std::string oneLine(std::string_view text) {
    std::string line;
    for (const char c : text.substr(0, 500)) line += static_cast<unsigned char>(c) < ' ' ? ' ' : c;
    return line;
}

}  // namespace

// Whether to go on reading.
bool ServerLink::receive(std::span<const std::byte> message) {
    const auto frame = parseStreamFrame(message, {kMaxServerHeaderBytes, kMaxPayloadBytes});
    const std::lock_guard lock(mutex);
    if (closing_) return false;
    last_heard_ = std::chrono::steady_clock::now();
    if (!frame) {
        loseTo(ErrorCode::kCorrupt,
               fmt::format("the server sent {}; is its version ours?", frame.error().message));
        return false;
    }
    const StreamHeader& header = frame->header;
    switch (header.message_case()) {
        case StreamHeader::kWelcome: onWelcome(header.welcome()); break;
        case StreamHeader::kFrameOpened: onFrameOpened(header.frame_opened()); break;
        case StreamHeader::kPage: {
            const Page& page = header.page();
            const PageRef& ref = page.ref();
            onPage(page.epoch(), page.frame(), {false, {ref.channel(), ref.block(), ref.node(), ref.draft()}},
                   frame->payload);
            break;
        }
        case StreamHeader::kBlockPage: {
            const BlockPage& page = header.block_page();
            onPage(page.epoch(), page.frame(), {true, {page.channel(), page.block(), 0}}, frame->payload);
            break;
        }
        case StreamHeader::kFailed: onFailed(header.failed()); break;
        case StreamHeader::kWishDone:
            finishWish(header.wish_done().epoch(), header.wish_done().credit_exhausted());
            break;
        case StreamHeader::kDatasetChanged: onDatasetChanged(header.dataset_changed()); break;
        case StreamHeader::kCatalogChanged: {
            const auto& names = header.catalog_changed().datasets();
            catalog_.emplace(names.begin(), names.end());
            break;
        }
        case StreamHeader::kPong: break;
        default: loseTo(ErrorCode::kCorrupt, "the server sent a message that only clients send"); break;
    }
    if (lost_) return false;
    // A server that sends more than it was granted waits until some of it is taken.
    return std::none_of(streams_.begin(), streams_.end(), [](auto* stream) { return stream->paused; });
}

// The question that an answer is for; nothing where it is not the one that is due.
std::optional<ServerLink::Question> ServerLink::answered(Question::Kind kind) {
    const auto fits = [&](const Question& question) {
        return (question.kind == Question::Kind::kOpen) == (kind == Question::Kind::kOpen);
    };
    if (questions_.empty() || !fits(questions_.front())) {
        loseTo(ErrorCode::kCorrupt, "the server answers what was not asked; is its version ours?");
        return std::nullopt;
    }
    const Question question = questions_.front();
    questions_.pop_front();
    return question;
}

void ServerLink::onWelcome(const Welcome& welcome) {
    if (welcome.protocol_major() != kProtocolMajor)
        return loseTo(
            ErrorCode::kTooNew,
            fmt::format("the server speaks protocol {}.{} and this program {}.{}; use the same version",
                        welcome.protocol_major(), welcome.protocol_minor(), kProtocolMajor, kProtocolMinor));
    const std::optional<Question> question = answered(Question::Kind::kOpen);
    if (!question) return;
    established_ = true;
    server_minor_ = welcome.protocol_minor();
    if (!question->stream) return;
    DatasetStream& stream = *question->stream;
    dataset_ids_[stream.dataset] = welcome.dataset_id();
    stream.dataset_id = welcome.dataset_id();
    auto manifest = std::make_shared<const Manifest>(welcome.manifest());
    if (!stream.first_manifest) {
        stream.first_manifest = stream.manifest = std::move(manifest);
    } else {
        // It may have changed while the connection was away.
        if (manifest->SerializeAsString() != stream.manifest->SerializeAsString()) {
            stream.manifest = std::move(manifest);
            stream.news = true;
        }
        ++stream.counters.reconnects;
        ++stream.counters.round_trips;
    }
    serve(stream);
    settled();
    stream.changed.notify_all();
}

void ServerLink::serve(DatasetStream& stream) {
    if (stream.start) {
        ++stream.counters.round_trips;
        sendEarly(stream, stream.dataset_id);
        return connection_->wakeSender();
    }
    const bool asked = std::any_of(questions_.begin(), questions_.end(), [&](const Question& question) {
        return question.stream == &stream && question.kind == Question::Kind::kFrame;
    });
    if (stream.opening && !stream.opening->answer) {
        if (!asked) ask(Question::Kind::kFrame, stream);
    } else if (stream.frame && !stream.frame_open) {
        ++stream.counters.round_trips;
        ask(Question::Kind::kFrameAgain, stream);
    }
}

void ServerLink::onFrameOpened(const FrameOpened& opened) {
    const std::optional<Question> question = answered(Question::Kind::kFrame);
    if (!question || !question->stream) return;
    DatasetStream& stream = *question->stream;
    if (question->kind == Question::Kind::kFrameAgain) {
        if (stream.frame != opened.frame()) return;  // left in the meantime
        if (stream.footer_xxh64 != 0 && opened.footer_xxh64() != stream.footer_xxh64)
            return loseStream(
                stream, {ErrorCode::kNotFound,
                         fmt::format("{}: frame {} was converted again while the connection was lost; start "
                                     "again",
                                     urlOf(stream), opened.frame())});
    } else {
        if (!stream.opening || stream.opening->number != question->number) return;
        stream.opening->frame = opened.frame();
        stream.opening->answer = opened.footer();
        stream.frame = opened.frame();
        stream.footer_xxh64 = opened.footer_xxh64();
        if (stream.early_view) stream.early_seen = resolveStartView(*stream.early_view, opened.footer());
    }
    stream.frame_open = true;
    settled();
    stream.changed.notify_all();
    connection_->wakeSender();
}

void ServerLink::onPage(std::uint64_t epoch, std::uint32_t frame, const WishedPage& page,
                        Result<std::span<const std::byte>> payload) {
    served_ = true;
    settled();
    DatasetStream* owner = turns_.ownerOf(epoch);
    if (!owner) return;
    DatasetStream& stream = *owner;
    const std::uint64_t bytes = payload ? payload->size() : 0;
    if (payload) {
        stream.counters.bytes_streamed += bytes;
        ++(page.is_block ? stream.counters.blocks_streamed : stream.counters.pages_streamed);
    }
    // Of a frame that was left: an address says nothing without its frame.
    if (frame != stream.frame) return;
    if (stream.first_epoch != 0 && epoch >= stream.first_epoch) {
        stream.credit_left -= std::min(stream.credit_left, bytes);
        // Where the wish was sent more than once, a page may come again.
        if (!stream.had.insert(page) && epoch > stream.first_epoch) return;
    }
    stream.queued_bytes += bytes;
    if (payload)
        stream.arrivals.push_back({page, std::vector<std::byte>(payload->begin(), payload->end())});
    else
        stream.arrivals.push_back({page, tl::unexpected(payload.error())});
    stream.paused = stream.queued_bytes > stream.queue_limit;
    stream.changed.notify_all();
}

void ServerLink::finishWish(std::uint64_t epoch, bool credit_exhausted) {
    DatasetStream* owner = turns_.ownerOf(epoch);
    if (turns_.finish(epoch, credit_exhausted)) {
        owner->done = true;
        owner->changed.notify_all();
    }
    served_ = true;
    settled();
    connection_->wakeSender();
}

void ServerLink::onFailed(const Failed& failed) {
    Error error{codeOf(failed.reason()), fmt::format("{}: {}", address_.url(), oneLine(failed.message()))};
    if (failed.has_page() || failed.has_block()) {
        const PageRef& ref = failed.page();
        const WishedPage page =
            failed.has_block() ? WishedPage{true, {failed.block().channel(), failed.block().block(), 0}}
                               : WishedPage{false, {ref.channel(), ref.block(), ref.node(), ref.draft()}};
        return onPage(failed.epoch(), failed.frame(), page, tl::unexpected(std::move(error)));
    }
    const bool goes_on = failed.reason() == Failed::REASON_NO_DATASET ||
                         failed.reason() == Failed::REASON_NO_FRAME || failed.reason() == Failed::REASON_IO;
    if (goes_on && failed.epoch() != 0) {
        DatasetStream* owner = turns_.ownerOf(failed.epoch());
        if (!owner || owner->epoch != failed.epoch()) return;
        turns_.leave(*owner);
        // Of a frame that openFrame() has not asked for yet, it is that which will tell.
        if (!owner->early_view) owner->wish_failed = std::move(error);
        owner->done = true;
        owner->changed.notify_all();
        return connection_->wakeSender();
    }
    if (goes_on && !questions_.empty()) {
        const Question question = questions_.front();
        questions_.pop_front();
        if (!question.stream) return;
        DatasetStream& stream = *question.stream;
        error.message = fmt::format("{}: {}", urlOf(stream), oneLine(failed.message()));
        if (question.kind != Question::Kind::kFrame) {
            loseStream(stream, std::move(error));
        } else if (stream.opening && stream.opening->number == question.number) {
            // A server that does not know of "the first" looked for frame 0; the manifest tells by now.
            const bool first = !stream.opening->frame && server_minor_ == 0;
            if (first && stream.manifest && stream.manifest->frames_size() > 0) {
                stream.opening->frame = stream.manifest->frames(0).frame();
                return ask(Question::Kind::kFrame, stream);
            }
            stream.opening->answer = tl::unexpected(std::move(error));
            stream.changed.notify_all();
        }
        return settled();
    }
    // A server that does not know yet what goes with a greeting: once more, without.
    if (failed.reason() == Failed::REASON_PROTOCOL && early_ && established_ && server_minor_ == 0) {
        for (DatasetStream* stream : streams_)
            if (stream->opening && stream->opening->early) stream->opening->answer.reset();
        return;
    }
    // It closes, but will have room again.
    if (failed.reason() == Failed::REASON_BUSY && established_) return;
    lose(std::move(error));
}

void ServerLink::onDatasetChanged(const DatasetChanged& change) {
    for (DatasetStream* stream : streams_) {
        if (stream->dataset_id != change.dataset_id() || change.dataset_id() == 0) continue;
        if (!change.removed()) stream->manifest = std::make_shared<const Manifest>(change.manifest());
        stream->news = true;
        stream->changed.notify_all();
    }
}

}  // namespace brickyard

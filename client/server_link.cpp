#include "client/server_link.h"

#include <fmt/format.h>

#include <algorithm>

#include "core/stream_frame.h"

namespace brickyard {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr const char* kClientName = "brickyard 0.1";
// Between attempts: doubled from the first to the last, and up to a half less at random, so that the clients
// of a server that comes back do not come at once.
constexpr milliseconds kFirstDelay{100}, kLastDelay{5'000};

std::string inSeconds(milliseconds time) {
    return fmt::format("{:.3g} s", std::chrono::duration<double>(time).count());
}

}  // namespace

ServerLink::ServerLink(StreamAddress address, std::string token, StreamTimeouts timeouts,
                       std::shared_ptr<NetworkThread> thread, bool alone)
    : address_(std::move(address)),
      token_(std::move(token)),
      timeouts_(timeouts),
      thread_(std::move(thread)),
      alone_(alone),
      last_heard_(Clock::now()) {
    const std::lock_guard lock(mutex);
    connect(milliseconds(0));
}

ServerLink::~ServerLink() {
    std::unique_ptr<StreamConnection> connection;
    {
        const std::lock_guard lock(mutex);
        closing_ = true;
        connection = std::move(connection_);
    }
    // Without the mutex: a handler that runs may be waiting for it.
}

std::string ServerLink::urlOf(const DatasetStream& stream) const {
    StreamAddress address = address_;
    address.dataset = stream.dataset;
    return address.url();
}

const Error* ServerLink::failure(const DatasetStream& stream) const {
    return stream.lost ? &*stream.lost : lost_ ? &*lost_ : nullptr;
}

void ServerLink::wakeAll() {
    for (DatasetStream* stream : streams_) stream->changed.notify_all();
}

void ServerLink::lose(Error error) {
    if (!lost_) lost_ = std::move(error);
    wakeAll();
}

void ServerLink::loseTo(ErrorCode code, const std::string& why) {
    lose({code, fmt::format("{}: {}", address_.url(), why)});
}

void ServerLink::loseStream(DatasetStream& stream, Error error) {
    if (!stream.lost) stream.lost = std::move(error);
    if (turns_.leave(stream) && connection_) connection_->wakeSender();
    stream.changed.notify_all();
}

// So long may a server be away, and so long may nothing at all come from it while an answer is owed.
SourceDeadline ServerLink::patienceEnd(SourceDeadline begin, bool owed) const {
    if (away_since_) return *away_since_ + timeouts_.reconnect;
    // Far away, but not so far that a clock's arithmetic overflows.
    if (!owed) return begin + std::chrono::hours(24 * 365);
    if (!established_) return begin + 2 * timeouts_.connect;
    return std::max(begin, last_heard_) + timeouts_.idle;
}

void ServerLink::loseSilent(const std::string& awaited) {
    if (away_since_)
        return loseTo(ErrorCode::kTimeout,
                      fmt::format("waited for {}: {}, and the server was not back within {}; start it again",
                                  awaited, away_why_, inSeconds(timeouts_.reconnect)));
    loseTo(ErrorCode::kTimeout,
           fmt::format("waited for {}: the server does not answer within {}; try again, "
                       "or start it again",
                       awaited, inSeconds(established_ ? timeouts_.idle : 2 * timeouts_.connect)));
}

// --- Connecting, and connecting again

void ServerLink::connect(milliseconds delay) {
    open_ = false;
    StreamConnection::Handlers handlers;
    handlers.on_open = [this] { greet(); };
    handlers.on_message = [this](std::span<const std::byte> message) { return receive(message); };
    handlers.on_lost = [this](Error error) { onLost(std::move(error)); };
    handlers.next_message = [this] { return nextMessage(); };
    connection_ =
        std::make_unique<StreamConnection>(address_, timeouts_, std::move(handlers), thread_, delay);
}

// Hello and all Opens go together: the answer to one costs no wait of its own. The first dataset's number is
// known, so its frame and wish go with them.
void ServerLink::greet() {
    const std::lock_guard lock(mutex);
    open_ = true;
    last_heard_ = Clock::now();
    StreamHeader hello;
    hello.mutable_hello()->set_protocol_major(kProtocolMajor);
    hello.mutable_hello()->set_protocol_minor(kProtocolMinor);
    hello.mutable_hello()->set_token(token_);
    hello.mutable_hello()->set_client(kClientName);
    send(hello);
    for (DatasetStream* stream : streams_) {
        if (stream->lost) continue;
        ask(Question::Kind::kOpen, *stream);
        if (alone_ && stream->start) sendEarly(*stream, /*dataset_id=*/1);
    }
}

void ServerLink::sendEarly(DatasetStream& stream, std::uint32_t dataset_id) {
    const StartHint hint = *std::exchange(stream.start, std::nullopt);
    early_ = true;
    stream.opening.emplace();
    stream.opening->frame = hint.frame;
    stream.opening->number = ++stream.openings;
    stream.opening->early = true;
    StreamHeader opening;
    opening.mutable_open_frame()->set_dataset_id(dataset_id);
    opening.mutable_open_frame()->set_frame(hint.frame.value_or(0));
    opening.mutable_open_frame()->set_first_frame(!hint.frame);
    questions_.push_back({Question::Kind::kFrame, &stream, stream.opening->number});
    send(opening);
    if (!hint.view) return;

    stream.forgetWish();
    stream.wanted = wishMessage(*hint.view);
    stream.done = false;
    stream.early_view = hint.view;
    stream.credit_granted = stream.credit_left = stream.queue_limit = stream.last_credit =
        hint.view->credit_bytes;
    stream.epoch = stream.first_epoch = turns_.nextEpoch();
    StreamHeader header;
    Wish& wish = *header.mutable_wish();
    wish = stream.wanted;
    wish.set_epoch(stream.epoch);
    wish.set_dataset_id(dataset_id);
    wish.set_frame(hint.frame.value_or(0));
    wish.set_first_frame(!hint.frame);
    wish.set_credit_bytes(hint.view->credit_bytes);
    send(header);
    turns_.sent(stream);
}

void ServerLink::onLost(Error error) {
    const std::lock_guard lock(mutex);
    if (closing_ || lost_) return;
    if (!established_ || timeouts_.reconnect == milliseconds(0)) return lose(std::move(error));

    const auto now = Clock::now();
    if (!away_since_) {
        away_since_ = now;
        away_why_ = error.message.substr(std::min(error.message.size(), address_.url().size() + 2));
        delay_ = kFirstDelay;
    }
    // Everything is asked for again, but what was asked for early and is not a wish yet.
    questions_.clear();
    outbox_.clear();
    dataset_ids_.clear();
    early_ = served_ = false;
    for (DatasetStream* stream : streams_) {
        stream->dataset_id = 0;
        stream->frame_open = false;
        stream->paused = false;
        if (!stream->early_view) continue;
        turns_.leave(*stream);
        stream->forgetWish();
    }
    turns_.restart();
    wakeAll();

    std::uniform_real_distribution<double> part(0.5, 1.0);
    const milliseconds delay(std::int64_t(double(delay_.count()) * part(random_)));
    delay_ = std::min(2 * delay_, kLastDelay);
    if (now + delay >= *away_since_ + timeouts_.reconnect) return loseSilent("the server");
    // Destroys the connection whose handler this is; nothing of it is touched afterwards.
    connect(delay);
}

// A connection that was lost is found again when what was owed comes: one that is lost again before that, by
// the very question that the server does not survive, is the same loss.
void ServerLink::settled() {
    if (!away_since_) return;
    for (const DatasetStream* stream : streams_) {
        if (stream->lost) continue;
        const bool opening = stream->opening && !stream->opening->answer;
        if (stream->dataset_id == 0 || opening || (stream->frame && !stream->frame_open)) return;
        if (!stream->done && !served_) return;
    }
    away_since_.reset();
    last_heard_ = Clock::now();
}

// --- Out

void ServerLink::send(const StreamHeader& header) { outbox_.push_back(encodeStreamHead(header)); }

std::vector<std::byte> ServerLink::nextMessage() {
    const std::lock_guard lock(mutex);
    std::vector<std::byte> message;
    if (closing_ || lost_) return message;
    if (!outbox_.empty()) {
        message = std::move(outbox_.front());
        outbox_.pop_front();
    } else if (std::optional<Wish> wish = turns_.next()) {
        StreamHeader header;
        *header.mutable_wish() = std::move(*wish);
        message = encodeStreamHead(header);
    }
    return message;
}

void ServerLink::ask(Question::Kind kind, DatasetStream& stream) {
    StreamHeader header;
    Question question{kind, &stream};
    if (kind == Question::Kind::kOpen) {
        header.mutable_open()->set_dataset(stream.dataset);
    } else {
        OpenFrame& open_frame = *header.mutable_open_frame();
        open_frame.set_dataset_id(stream.dataset_id);
        std::optional<std::uint32_t> frame = stream.frame;
        if (kind == Question::Kind::kFrame) {
            frame = stream.opening->frame;
            question.number = stream.opening->number;
        }
        // By now the manifest tells which is the first.
        if (!frame && stream.manifest->frames_size() > 0) frame = stream.manifest->frames(0).frame();
        open_frame.set_frame(frame.value_or(0));
    }
    questions_.push_back(question);
    send(header);
    connection_->wakeSender();
}

Result<void> ServerLink::join(DatasetStream& stream) {
    if (lost_) return tl::unexpected(*lost_);
    std::map<std::string, int> names;
    for (const DatasetStream* other : streams_) names[other->dataset];
    for (const auto& [name, id] : dataset_ids_) names[name];
    if (!names.contains(stream.dataset) && names.size() >= kMaxOpenDatasets)
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: more than {} datasets on one connection; use a second one",
                                urlOf(stream), kMaxOpenDatasets));
    streams_.push_back(&stream);
    if (open_) ask(Question::Kind::kOpen, stream);
    return {};
}

void ServerLink::leave(DatasetStream& stream) {
    std::erase(streams_, &stream);
    for (Question& question : questions_)
        if (question.stream == &stream) question.stream = nullptr;
    const bool abandoned = turns_.leave(stream);
    if (!connection_) return;
    if (abandoned && stream.frame_open) {
        // Others may go on using the connection: an empty wish keeps it from carrying what nobody takes.
        StreamHeader header;
        header.mutable_wish()->set_epoch(turns_.nextEpoch());
        header.mutable_wish()->set_dataset_id(stream.dataset_id);
        header.mutable_wish()->set_frame(*stream.frame);
        send(header);
    }
    connection_->wakeSender();
    connection_->resumeReading();
}

void ServerLink::askFrame(DatasetStream& stream) {
    // What is left of the old frame is of no use, and must not keep the answer from being read.
    turns_.leave(stream);
    stream.forgetWish();
    stream.forgetArrivals();
    stream.frame.reset();
    stream.frame_open = false;
    if (stream.dataset_id != 0) ask(Question::Kind::kFrame, stream);
    if (connection_) connection_->resumeReading();
}

void ServerLink::sendWish(DatasetStream& stream) {
    turns_.enter(stream);
    connection_->wakeSender();
}

void ServerLink::resume(DatasetStream& stream) {
    if (!stream.paused || stream.queued_bytes > stream.queue_limit) return;
    stream.paused = false;
    connection_->resumeReading();
}

}  // namespace brickyard

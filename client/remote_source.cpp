#include "client/remote_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>

#include "core/brick_codec.h"
#include "core/camera.h"
#include "core/stream_frame.h"

namespace brickyard {
namespace {

constexpr const char* kClientName = "brickyard 0.1";
constexpr std::size_t kChunkPages = 64;
constexpr std::size_t kChunkBytes = 1u << 20;
// Limits of stream.proto: what is over them would end the connection.
constexpr std::size_t kMaxWishPages = 65536;
constexpr std::size_t kMaxWishBlocks = 4096;

ErrorCode codeOf(Failed::Reason reason) {
    switch (reason) {
        case Failed::REASON_VERSION: return ErrorCode::kTooNew;
        case Failed::REASON_TOKEN: return ErrorCode::kRefused;
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

// The front of a wish that fits one message.
StreamHeader headerOf(const PageWish& list) {
    StreamHeader header;
    Wish& wish = *header.mutable_wish();
    wish.set_credit_bytes(list.credit_bytes);
    for (const WishedPage& page : list.pages) {
        if (page.is_block && std::size_t(wish.blocks_size()) < kMaxWishBlocks) {
            BlockWish& block = *wish.add_blocks();
            block.set_channel(page.address.channel);
            block.set_block(page.address.block);
        } else if (!page.is_block && std::size_t(wish.pages_size()) < kMaxWishPages) {
            PageRef& ref = *wish.add_pages();
            ref.set_channel(page.address.channel);
            ref.set_block(page.address.block);
            ref.set_node(page.address.node);
            ref.set_draft(page.address.draft);
        }
    }
    if (!list.views.empty()) {
        const CameraView& view = list.views.front();
        CameraWish& seen = *wish.mutable_camera();
        *seen.mutable_camera() = view.camera;
        seen.set_width(view.width);
        seen.set_height(view.height);
        for (const std::uint32_t channel : view.channels) seen.add_channels(channel);
        seen.set_pixels_per_voxel(view.pixels_per_voxel);
    }
    // Room for the length, the epoch, the dataset and the frame, which are filled in later.
    while (header.ByteSizeLong() + 64 > kMaxClientMessageBytes && wish.pages_size() > 0)
        wish.mutable_pages()->DeleteSubrange(wish.pages_size() - wish.pages_size() / 8 - 1,
                                             wish.pages_size() / 8 + 1);
    return header;
}

}  // namespace

struct RemoteSource::State {
    State(StreamAddress to, std::string with, StreamTimeouts limits)
        : address(std::move(to)), token(std::move(with)), timeouts(limits) {}

    void connect() {
        StreamConnection::Handlers handlers;
        handlers.on_open = [this] { greet(); };
        handlers.on_message = [this](std::span<const std::byte> message) { return receive(message); };
        handlers.on_lost = [this](Error error) {
            const std::lock_guard lock(mutex);
            lose(std::move(error));
        };
        handlers.next_message = [this] { return nextMessage(); };
        connection = std::make_unique<StreamConnection>(address, timeouts, std::move(handlers));
    }

    // Hello and Open go together: the answer to one costs no wait of its own.
    void greet() {
        StreamHeader hello, open;
        hello.mutable_hello()->set_protocol_major(kProtocolMajor);
        hello.mutable_hello()->set_protocol_minor(kProtocolMinor);
        hello.mutable_hello()->set_token(token);
        hello.mutable_hello()->set_client(kClientName);
        open.mutable_open()->set_dataset(address.dataset);
        const std::lock_guard lock(mutex);
        outbox.push_back(encodeStreamHead(hello));
        outbox.push_back(encodeStreamHead(open));
    }

    std::vector<std::byte> nextMessage() {
        const std::lock_guard lock(mutex);
        std::vector<std::byte> message;
        if (!outbox.empty()) {
            message = std::move(outbox.front());
            outbox.pop_front();
        } else if (wish_to_send) {
            message = encodeStreamHead(*wish_to_send);
            wish_to_send.reset();
        }
        return message;
    }

    // REQUIRES: the mutex is held.
    void lose(Error error) {
        // The first reason is the cause; what follows is only its consequence.
        if (!lost) lost = std::move(error);
        changed.notify_all();
    }
    void loseTo(ErrorCode code, const std::string& why) {
        lose({code, fmt::format("{}: {}", address.url(), why)});
    }

    // On the connection's thread. Whether to go on reading.
    bool receive(std::span<const std::byte> message) {
        const auto frame = parseStreamFrame(message, {kMaxServerHeaderBytes, kMaxPayloadBytes});
        const std::lock_guard lock(mutex);
        if (!frame) {
            loseTo(ErrorCode::kCorrupt,
                   fmt::format("the server sent {}; is its version ours?", frame.error().message));
            return false;
        }
        const StreamHeader& header = frame->header;
        switch (header.message_case()) {
            case StreamHeader::kWelcome: onWelcome(header.welcome()); break;
            case StreamHeader::kFrameOpened:
                if (opening == header.frame_opened().frame()) answer = header.frame_opened().footer();
                break;
            case StreamHeader::kPage: {
                const PageRef& ref = header.page().ref();
                onPage({false, {ref.channel(), ref.block(), ref.node(), ref.draft()}}, header.page().frame(),
                       frame->payload);
                break;
            }
            case StreamHeader::kBlockPage: {
                const BlockPage& page = header.block_page();
                onPage({true, {page.channel(), page.block(), 0}}, page.frame(), frame->payload);
                break;
            }
            case StreamHeader::kFailed: onFailed(header.failed()); break;
            case StreamHeader::kWishDone:
                done_epoch = std::max(done_epoch, header.wish_done().epoch());
                break;
            case StreamHeader::kPong: break;
            default: loseTo(ErrorCode::kCorrupt, "the server sent a message that only clients send"); break;
        }
        changed.notify_all();
        if (lost) return false;
        // A server that sends more than it was granted waits until some of it is taken.
        paused = queued_bytes > queue_limit;
        return !paused;
    }

    void onWelcome(const Welcome& welcome) {
        if (welcome.protocol_major() != kProtocolMajor)
            return loseTo(
                ErrorCode::kTooNew,
                fmt::format("the server speaks protocol {}.{} and this program {}.{}; use the same version",
                            welcome.protocol_major(), welcome.protocol_minor(), kProtocolMajor,
                            kProtocolMinor));
        if (welcomed) return;
        welcomed = true;
        dataset_id = welcome.dataset_id();
        manifest = welcome.manifest();
    }

    void onPage(const WishedPage& page, std::uint32_t frame, std::span<const std::byte> payload) {
        counters.bytes_streamed += payload.size();
        ++(page.is_block ? counters.blocks_streamed : counters.pages_streamed);
        // Of a frame that was left: an address says nothing without its frame.
        if (frame != current_frame) return;
        queued_bytes += payload.size();
        arrivals.push_back({page, std::vector<std::byte>(payload.begin(), payload.end())});
    }

    void onFailed(const Failed& failed) {
        const Error error{codeOf(failed.reason()),
                          fmt::format("{}: {}", address.url(), oneLine(failed.message()))};
        if (failed.has_page() || failed.has_block()) {
            if (failed.frame() != current_frame) return;
            WishedPage page;
            page.is_block = failed.has_block();
            page.address = page.is_block ? PageAddress{failed.block().channel(), failed.block().block(), 0}
                                         : PageAddress{failed.page().channel(), failed.page().block(),
                                                       failed.page().node()};
            arrivals.push_back({page, tl::unexpected(error)});
        } else if (opening && failed.epoch() == 0 && failed.frame() == *opening &&
                   (failed.reason() == Failed::REASON_NO_FRAME || failed.reason() == Failed::REASON_IO)) {
            answer = tl::unexpected(error);
        } else {
            lose(error);
        }
    }

    const StreamAddress address;
    const std::string token;
    const StreamTimeouts timeouts;

    std::mutex mutex;  // guards everything below but the connection
    std::condition_variable changed;
    std::optional<Error> lost;
    std::deque<std::vector<std::byte>> outbox;
    std::optional<StreamHeader> wish_to_send;  // the newest; one that was not sent in time is replaced

    bool welcomed = false;
    std::uint32_t dataset_id = 0;
    Manifest manifest;  // set once, before `welcomed`
    std::optional<std::uint32_t> opening;
    std::optional<Result<FrameFooter>> answer;  // to `opening`
    std::optional<std::uint32_t> current_frame;

    std::uint64_t epoch = 0, done_epoch = 0;
    std::deque<Arrival> arrivals;
    std::uint64_t queued_bytes = 0;  // Invariant: the payloads in `arrivals`
    std::uint64_t queue_limit = 0;   // what the two newest wishes granted
    std::uint64_t last_credit = 0;
    bool paused = false;
    SourceCounters counters;

    // Last, so that its thread has ended before the rest goes.
    std::unique_ptr<StreamConnection> connection;
};

RemoteSource::RemoteSource(std::unique_ptr<State> state) : state_(std::move(state)) {}
RemoteSource::~RemoteSource() = default;

Result<std::unique_ptr<RemoteSource>> RemoteSource::open(const StreamAddress& address,
                                                         const std::string& token, StreamTimeouts timeouts) {
    auto state = std::make_unique<State>(address, token, timeouts);
    state->connect();
    {
        std::unique_lock lock(state->mutex);
        ++state->counters.round_trips;
        // The connection has its own deadline; the rest is for the answer to Open.
        state->changed.wait_for(lock, 2 * timeouts.connect, [&] { return state->welcomed || state->lost; });
        if (!state->welcomed && !state->lost)
            state->loseTo(ErrorCode::kTimeout, "the server does not answer; try again, or start it again");
        if (state->lost) return tl::unexpected(*state->lost);
    }
    return std::unique_ptr<RemoteSource>(new RemoteSource(std::move(state)));
}

const Manifest& RemoteSource::manifest() const { return state_->manifest; }

Result<FrameFooter> RemoteSource::openFrame(std::uint32_t frame) {
    StreamHeader header;
    header.mutable_open_frame()->set_dataset_id(state_->dataset_id);
    header.mutable_open_frame()->set_frame(frame);

    std::unique_lock lock(state_->mutex);
    if (state_->lost) return tl::unexpected(*state_->lost);
    ++state_->counters.round_trips;
    state_->opening = frame;
    state_->answer.reset();
    // What is left of the old frame is of no use, and must not keep the answer from being read.
    state_->current_frame.reset();
    state_->wish_to_send.reset();
    state_->done_epoch = state_->epoch;
    state_->arrivals.clear();
    state_->queued_bytes = 0;
    state_->paused = false;
    state_->outbox.push_back(encodeStreamHead(header));
    state_->connection->wakeSender();
    state_->connection->resumeReading();
    const bool answered =
        state_->changed.wait_for(lock, state_->timeouts.idle, [&] { return state_->answer || state_->lost; });
    state_->opening.reset();
    if (!state_->answer) {
        if (!answered)
            state_->loseTo(ErrorCode::kTimeout,
                           fmt::format("the server does not open frame {}; try again", frame));
        return tl::unexpected(*state_->lost);
    }
    auto footer = std::move(*state_->answer);
    state_->answer.reset();
    if (footer) state_->current_frame = frame;
    return footer;
}

Result<void> RemoteSource::wish(PageWish newest) {
    // Refused here as a local source refuses it: the server would end the connection.
    for (const CameraView& view : newest.views)
        if (auto camera = PinholeCamera::create(view.camera, view.width, view.height); !camera)
            return tl::unexpected(camera.error());
    StreamHeader header = headerOf(newest);
    {
        const std::lock_guard lock(state_->mutex);
        if (state_->lost) return tl::unexpected(*state_->lost);
        if (!state_->current_frame)
            return fail(ErrorCode::kInvalid,
                        fmt::format("{}: pages are wished before a frame is open; open one first",
                                    state_->address.url()));
        ++state_->counters.round_trips;
        Wish& wish = *header.mutable_wish();
        wish.set_epoch(++state_->epoch);
        wish.set_dataset_id(state_->dataset_id);
        wish.set_frame(*state_->current_frame);
        // What waits to be taken has its room already.
        wish.set_credit_bytes(newest.credit_bytes - std::min(newest.credit_bytes, state_->queued_bytes));
        const std::uint64_t sum = newest.credit_bytes + state_->last_credit;
        state_->queue_limit = sum < newest.credit_bytes ? newest.credit_bytes : sum;
        state_->last_credit = newest.credit_bytes;
        state_->wish_to_send = std::move(header);
    }
    state_->connection->wakeSender();
    return {};
}

Result<std::vector<Arrival>> RemoteSource::take(std::chrono::steady_clock::time_point deadline) {
    std::vector<Arrival> chunk;
    bool resume = false;
    {
        std::unique_lock lock(state_->mutex);
        state_->changed.wait_until(lock, deadline, [&] {
            return !state_->arrivals.empty() || state_->lost || state_->done_epoch == state_->epoch;
        });
        std::size_t bytes = 0;
        while (!state_->arrivals.empty() && chunk.size() < kChunkPages && bytes < kChunkBytes) {
            Arrival& next = state_->arrivals.front();
            if (next.bytes) bytes += next.bytes->size();
            chunk.push_back(std::move(next));
            state_->arrivals.pop_front();
        }
        state_->queued_bytes -= bytes;
        if (chunk.empty() && state_->lost) return tl::unexpected(*state_->lost);
        resume = state_->paused && state_->queued_bytes <= state_->queue_limit;
        if (resume) state_->paused = false;
    }
    if (resume) state_->connection->resumeReading();
    return chunk;
}

bool RemoteSource::wishDone() const {
    const std::lock_guard lock(state_->mutex);
    return state_->done_epoch == state_->epoch && state_->arrivals.empty();
}

SourceCounters RemoteSource::counters() const {
    const std::lock_guard lock(state_->mutex);
    return state_->counters;
}

}  // namespace brickyard

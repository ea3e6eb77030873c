#include "server/stream_session.h"

#include <netinet/tcp.h>

#include <atomic>
#include <boost/asio/post.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/websocket.hpp>
#include <deque>

#include "core/stream_frame.h"
#include "server/conversation.h"
#include "server/frame_lane.h"

namespace brickyard {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using ErrorCondition = boost::system::error_code;

constexpr std::size_t kReadBytes = 4u << 10, kKeptReadBytes = 64u << 10;
// Messages that came and wait for a worker; then no more is read.
constexpr std::size_t kMaxInbox = 8, kMaxInboxBytes = 256u << 10;
// What the socket may hold that the network did not take yet: little, so that a new wish finds little on its
// way, and enough that the network never waits for us.
constexpr int kUnsentBytes = 64 << 10;

// Who touches what: the connection's thread owns the socket and everything here, but for `talk_`, which
// belongs to a worker while `working_`. A worker receives messages, and reads from the disk what memory does
// not have; pages that are in memory are sent without one.
class StreamSession : public std::enable_shared_from_this<StreamSession>, private Timed {
public:
    StreamSession(std::unique_ptr<ByteStream> stream, http::request<http::string_body> upgrade,
                  std::unique_ptr<ConnectionList::Slot> slot, IoThread& thread, ServerContext& context)
        : Timed(thread),
          stream_(std::move(stream)),
          upgrade_(std::move(upgrade)),
          slot_(std::move(slot)),
          context_(context),
          talk_({context.catalog.get(), &context.wishes, &context.metrics,
                 [&context] { return context.tokens.get(); }}),
          id_(context.next_id.fetch_add(1, std::memory_order_relaxed)) {
        context_.metrics.connectionOpened(Via::kStream);
    }

    ~StreamSession() override {
        context_.metrics.connectionClosed(Via::kStream);
        context_.log.write(
            LogLevel::info, "stream ended",
            {{"id", id_}, {"client", talk_.clientName()}, {"bytes", lane().sentBytes()}, {"why", why_}});
    }

    void start() {
        const auto post = [weak = weak_from_this(), executor = stream_.get_executor()](auto what) {
            return [weak, executor, what] {
                asio::post(executor, [weak, what] {
                    if (const auto self = weak.lock()) what(*self);
                });
            };
        };
        slot_->onClose(post([](StreamSession& self) { self.close(websocket::close_code::going_away); }));
        slot_->onNews(post([](StreamSession& self) {
            self.news_ = true;
            self.pump();
        }));
        const ServerOptions& options = context_.options;
        // A peer that is alive answers Beast's pings; one that is gone is dropped after the idle time.
        stream_.set_option(
            websocket::stream_base::timeout{options.handshake_timeout, options.idle_timeout, true});
        stream_.set_option(websocket::stream_base::decorator(
            [](websocket::response_type& response) { response.set(http::field::server, "brickyard"); }));
        stream_.read_message_max(kMaxClientMessageBytes + 1);
        ErrorCondition ignored;
        auto& socket = lane().bytes().socket();
        // One batch is one write: waiting to fill a segment would only delay it.
        socket.set_option(asio::ip::tcp::no_delay(true), ignored);
        socket.set_option(asio::detail::socket_option::integer<IPPROTO_TCP, TCP_NOTSENT_LOWAT>(kUnsentBytes),
                          ignored);
        setDeadline();
        stream_.async_accept(upgrade_, [self = shared_from_this()](ErrorCondition error) {
            self->upgrade_ = {};
            self->accepted_ = true;
            if (self->closing_) return;
            if (error) return self->drop("its handshake failed");
            self->context_.log.write(LogLevel::info, "stream opened",
                                     {{"id", self->id_}, {"tls", self->lane().bytes().encryption()}});
            self->read();
        });
    }

private:
    FrameLane& lane() { return stream_.next_layer(); }

    void read() {
        if (reading_ || closing_ || ending_ || backlogged_) return;
        if (inbox_.size() >= kMaxInbox || inbox_bytes_ >= kMaxInboxBytes) return;
        reading_ = true;
        stream_.async_read_some(
            in_, kReadBytes,
            [self = shared_from_this()](ErrorCondition error, std::size_t) { self->onRead(error); });
    }

    void onRead(ErrorCondition error) {
        reading_ = false;
        // Beast ends the connection by itself where the peer breaks the protocol of WebSocket.
        if (error == websocket::error::message_too_big)
            return refuse("a message is over the limit of 1048576 bytes");
        if (error) return drop(error == websocket::error::closed ? "" : error.message());
        // A peer may still speak after it was refused; nobody listens.
        if (ending_ || closing_) return;
        if (!stream_.got_binary()) return refuse("a text message; the stream has binary ones only");
        if (in_.size() > kMaxClientMessageBytes)
            return refuse("a message is over the limit of 1048576 bytes");
        if (stream_.is_message_done()) {
            const auto data = in_.cdata();
            const auto* begin = static_cast<const std::byte*>(data.data());
            inbox_.emplace_back(begin, begin + data.size());
            inbox_bytes_ += data.size();
            interrupted_ = true;
            // A long wish must not hold its memory for the life of the connection.
            in_.clear();
            if (in_.capacity() > kKeptReadBytes) in_.shrink_to_fit();
            message_began_.reset();
            setDeadline();
        } else if (!message_began_) {
            message_began_ = Clock::now();
            setDeadline();
        }
        pump();
        read();
    }

    void refuse(const std::string& why) {
        refusal_ = why;
        ending_ = true;
        pump();
    }

    // Goes on with whatever can be done now.
    void pump() {
        if (working_ || closing_) return;
        // A peer that reads nothing does not have news piled up for it.
        if (late_news_ && !backlogged_) {
            late_news_ = false;
            news_ = true;
        }
        if (refusal_ && !talk_.over()) talk_.refuse(*refusal_);
        if (!inbox_.empty() || news_) return work({});
        if (lane().writing() || awaiting_memory_) return;
        if (!talk_.hasMore()) {
            granted_.reset();
            if (talk_.over()) close(websocket::close_code::policy_error);
            return;
        }
        OutBatch batch = takeBatch();
        if (!batch) return;
        const auto filled = talk_.fill(batch, ReadMode::kCachedOnly, [] { return false; });
        noteAnswers();
        if (!batch.empty()) return send(std::move(batch));
        if (filled == Conversation::Filled::kWaits) return work(std::move(batch));
        if (filled == Conversation::Filled::kFull) {
            needed_ = talk_.neededBytes();
            batch = {};
            pump();
        }
    }

    OutBatch takeBatch() {
        const std::size_t bytes = std::max(std::exchange(needed_, 0), kBatchBytes);
        if (granted_ && granted_.capacity() >= bytes) return OutBatch(std::move(granted_));
        granted_.reset();
        OutBatch batch(context_.batches.take(bytes));
        if (!batch) {
            awaiting_memory_ = true;
            context_.batches.await(
                bytes, [weak = weak_from_this(), executor = stream_.get_executor()](BatchMemory memory) {
                    asio::post(executor, [weak, granted = std::move(memory)]() mutable {
                        if (const auto self = weak.lock()) self->onGranted(std::move(granted));
                    });
                });
        }
        return batch;
    }

    void onGranted(BatchMemory memory) {
        awaiting_memory_ = false;
        if (closing_) return;
        if (!memory) return drop("the machine is out of memory");
        granted_ = std::move(memory);
        pump();
    }

    // A worker receives what came, and then fills `batch` where there is one.
    void work(OutBatch batch) {
        working_ = true;
        interrupted_ = false;
        std::deque<std::vector<std::byte>> messages;
        messages.swap(inbox_);
        inbox_bytes_ = 0;
        const bool news = std::exchange(news_, false);
        // Saves the way back and forth, where there is memory.
        if (!batch && !lane().writing() && !awaiting_memory_)
            batch = OutBatch(granted_ ? std::move(granted_) : context_.batches.take());
        asio::post(context_.workers(), [self = shared_from_this(), messages = std::move(messages), news,
                                        batch = std::move(batch)]() mutable {
            StreamSession& session = *self;
            session.workOn(std::move(self), messages, news, std::move(batch));
        });
    }

    // On a worker's thread: nothing of the session but talk_ and interrupted_ may be touched. Its hold on the
    // session goes back with what it did: a session must end on its own thread.
    void workOn(std::shared_ptr<StreamSession> self, const std::deque<std::vector<std::byte>>& messages,
                bool news, OutBatch batch) {
        const auto began = Clock::now();
        const std::uint64_t wishes_before = talk_.wishCount();
        bool told = false;
        try {
            for (const auto& message : messages)
                if (!talk_.over()) talk_.receive(message);
            told = news && !talk_.backlogged();
            if (told) talk_.tellNews();
            if (batch)
                talk_.fill(batch, ReadMode::kMayBlock,
                           [&] { return interrupted_.load(std::memory_order_relaxed); });
        } catch (const std::exception& error) {
            // Out of memory, in all likelihood.
            context_.log.write(LogLevel::err, "stream failed", {{"id", id_}, {"exception", error.what()}});
            batch = {};
            if (!talk_.over()) talk_.refuseBusy("the server is out of memory; try again later");
        }
        context_.metrics.diskRead(std::chrono::duration<double>(Clock::now() - began).count());
        const bool replaced = talk_.wishCount() != wishes_before;
        asio::post(stream_.get_executor(), [self = std::move(self), replaced, late = news && !told,
                                            batch = std::move(batch)]() mutable {
            self->late_news_ = self->late_news_ || late;
            self->onWorked(replaced, std::move(batch));
        });
    }

    void onWorked(bool replaced, OutBatch batch) {
        working_ = false;
        if (closing_) return;
        if (replaced) lane().dropPages();
        if (!established_ && talk_.established()) {
            established_ = true;
            setDeadline();
        }
        if (talk_.over()) ending_ = true;
        noteAnswers();
        if (batch && !batch.empty()) {
            // What came meanwhile may be a new wish. A worker reads it while these pages go out, and what the
            // socket has not taken by then is dropped.
            send(std::move(batch));
            if (!inbox_.empty() || news_) pump();
        } else {
            batch = {};
            pump();
        }
        read();
    }

    void noteAnswers() { backlogged_ = talk_.backlogged(); }

    void send(OutBatch batch) {
        write_began_ = Clock::now();
        setDeadline();
        lane().write(std::move(batch), [self = shared_from_this()](ErrorCondition error) {
            if (error) return self->drop(error.message());
            self->write_began_.reset();
            self->setDeadline();
            self->pump();
            self->read();
        });
    }

    // The first of what the peer has a limited time for: to open a dataset, to end a message that it began (a
    // byte at a time must not take for ever), to take what it is sent.
    void setDeadline() {
        const ServerOptions& options = context_.options;
        auto first = Clock::time_point::max();
        if (!established_) first = began_ + options.handshake_timeout;
        if (message_began_) first = std::min(first, *message_began_ + options.handshake_timeout);
        if (write_began_) first = std::min(first, *write_began_ + options.idle_timeout);
        expireAt(first);
    }

    // A write that never ends holds this session, which holds the write.
    void onThreadEnded() override {
        const auto self = shared_from_this();
        lane().abandon();
    }

    void onDeadline() override {
        if (closing_) return drop("");
        context_.metrics.error("timeout");
        if (ending_ || established_ || lane().writing() || working_) return drop("it was too slow");
        expireAfter(context_.options.drain_timeout);
        refuse("no dataset was opened in time; send Hello and Open right after connecting");
    }

    void close(websocket::close_code code) {
        if (closing_) return;
        // A WebSocket that is still being made cannot say goodbye.
        if (!accepted_) return drop("");
        closing_ = true;
        granted_.reset();
        lane().dropAll();
        expireAfter(context_.options.drain_timeout);
        stream_.async_close(code, [self = shared_from_this()](ErrorCondition) {});
    }

    void drop(const std::string& why) {
        if (why_.empty()) why_ = why;
        closing_ = true;
        granted_.reset();
        expireNever();
        lane().bytes().close();
    }

    websocket::stream<FrameLane, false> stream_;
    http::request<http::string_body> upgrade_;
    std::unique_ptr<ConnectionList::Slot> slot_;
    ServerContext& context_;
    Conversation talk_;
    const std::uint64_t id_;

    beast::flat_buffer in_;
    std::deque<std::vector<std::byte>> inbox_;
    std::size_t inbox_bytes_ = 0;  // Invariant: the sum over inbox_
    // Something came that the worker must look at before it reads on.
    std::atomic<bool> interrupted_{false};
    std::optional<std::string> refusal_;
    std::size_t needed_ = 0;  // of memory for the next batch, where that is more than usual
    BatchMemory granted_;     // for the next batch, after a wait
    const Clock::time_point began_ = Clock::now();
    std::optional<Clock::time_point> write_began_, message_began_;
    std::string why_;  // it ended, for the log
    bool accepted_ = false, reading_ = false, working_ = false, awaiting_memory_ = false, news_ = false,
         late_news_ = false;
    bool established_ = false, backlogged_ = false;
    bool ending_ = false;   // nothing more is read
    bool closing_ = false;  // nothing more is sent
};

}  // namespace

void startStreamSession(std::unique_ptr<ByteStream> stream, http::request<http::string_body> upgrade,
                        std::unique_ptr<ConnectionList::Slot> slot, IoThread& thread,
                        ServerContext& context) {
    std::make_shared<StreamSession>(std::move(stream), std::move(upgrade), std::move(slot), thread, context)
        ->start();
}

}  // namespace brickyard

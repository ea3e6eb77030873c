#include "server/stream_session.h"

#include <array>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/websocket.hpp>
#include <chrono>

#include "core/stream_frame.h"
#include "server/conversation.h"

namespace brickyard {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using ErrorCondition = boost::system::error_code;
using Clock = std::chrono::steady_clock;

constexpr std::size_t kReadBytes = 64u << 10;

class StreamSession : public std::enable_shared_from_this<StreamSession> {
public:
    StreamSession(asio::ip::tcp::socket socket, http::request<http::string_body> upgrade,
                  std::unique_ptr<ConnectionList::Slot> slot, ServerContext& context)
        : stream_(std::move(socket)),
          upgrade_(std::move(upgrade)),
          slot_(std::move(slot)),
          context_(context),
          talk_(*context.catalog, context.options),
          watchdog_(stream_.get_executor()) {}

    ~StreamSession() {
        context_.log->info("stream of {:?} ended: {} messages, {} payload bytes sent", talk_.clientName(),
                           sent_messages_, sent_bytes_);
    }

    void start() {
        slot_->onClose([weak = weak_from_this(), executor = stream_.get_executor()] {
            asio::post(executor, [weak] {
                if (const auto self = weak.lock()) self->close(websocket::close_code::going_away);
            });
        });
        const ServerOptions& options = context_.options;
        // A peer that is alive answers Beast's pings; one that is gone is dropped after the idle time.
        stream_.set_option(
            websocket::stream_base::timeout{options.handshake_timeout, options.idle_timeout, true});
        stream_.set_option(websocket::stream_base::decorator(
            [](websocket::response_type& response) { response.set(http::field::server, "brickyard"); }));
        stream_.binary(true);
        stream_.auto_fragment(false);
        // One message is one write: waiting to fill a segment would only delay it.
        ErrorCondition ignored;
        beast::get_lowest_layer(stream_).socket().set_option(asio::ip::tcp::no_delay(true), ignored);
        deadline_ = Clock::now() + options.handshake_timeout;
        stream_.async_accept(upgrade_, [self = shared_from_this()](ErrorCondition error) {
            self->upgrade_ = {};
            self->accepted_ = true;
            if (error || self->closing_) return;
            self->watch();
            self->read();
        });
    }

private:
    void read() {
        if (reading_ || closing_ || talk_.over() || talk_.backlogged()) return;
        reading_ = true;
        stream_.async_read_some(
            in_, kReadBytes,
            [self = shared_from_this()](ErrorCondition error, std::size_t) { self->onRead(error); });
    }

    void onRead(ErrorCondition error) {
        reading_ = false;
        if (error) return drop();
        // A peer may still speak after it was refused; nobody listens.
        if (talk_.over() || closing_) return;
        if (!stream_.got_binary()) {
            talk_.refuse("a text message; the stream has binary ones only");
        } else if (in_.size() > kMaxClientMessageBytes) {
            talk_.refuse("a message is over the limit of 1048576 bytes");
        } else if (stream_.is_message_done()) {
            const auto data = in_.cdata();
            talk_.receive({static_cast<const std::byte*>(data.data()), data.size()});
            // A long wish must not hold its memory for the life of the connection.
            in_.clear();
            if (in_.capacity() > 2 * kReadBytes) in_.shrink_to_fit();
        }
        pump();
        read();
    }

    // Writes the next message unless one is being written. A wish that was read meanwhile has replaced the
    // older one by then, so no more than one message of that one still goes out.
    void pump() {
        if (writing_ || closing_) return;
        auto message = talk_.next();
        if (!message) {
            if (talk_.over()) close(websocket::close_code::policy_error);
            return;
        }
        out_ = std::move(*message);
        writing_ = true;
        write_began_ = Clock::now();
        const std::array<asio::const_buffer, 2> buffers{asio::buffer(out_.head), asio::buffer(out_.payload)};
        stream_.async_write(buffers, [self = shared_from_this()](ErrorCondition error, std::size_t) {
            self->writing_ = false;
            if (error) return self->drop();
            ++self->sent_messages_;
            self->sent_bytes_ += self->out_.payload.size();
            self->pump();
            self->read();
        });
    }

    // Looks now and then whether the peer took too long: to open a dataset, or to read one message.
    void watch() {
        const auto tick =
            std::min<Clock::duration>(std::chrono::seconds(1), context_.options.handshake_timeout / 4);
        watchdog_.expires_after(tick);
        // Weak: the timer alone must not keep a session alive whose peer has left.
        watchdog_.async_wait([weak = weak_from_this()](ErrorCondition error) {
            const auto self = weak.lock();
            if (error || !self || self->closing_) return;
            const auto now = Clock::now();
            if (self->writing_ && now - self->write_began_ > self->context_.options.idle_timeout)
                return self->drop();
            if (!self->talk_.established() && !self->talk_.over() && now > self->deadline_) {
                self->talk_.refuse(
                    "no dataset was opened in time; send Hello and Open right after connecting");
                self->pump();
            }
            self->watch();
        });
    }

    void close(websocket::close_code code) {
        if (closing_) return;
        // A WebSocket that is still being made cannot say goodbye.
        if (!accepted_) return drop();
        closing_ = true;
        watchdog_.cancel();
        // Bounded by the handshake timeout.
        stream_.async_close(code, [self = shared_from_this()](ErrorCondition) {});
    }

    void drop() {
        closing_ = true;
        watchdog_.cancel();
        beast::get_lowest_layer(stream_).close();
    }

    websocket::stream<beast::tcp_stream> stream_;
    http::request<http::string_body> upgrade_;
    std::unique_ptr<ConnectionList::Slot> slot_;
    ServerContext& context_;
    Conversation talk_;
    asio::steady_timer watchdog_;
    Clock::time_point deadline_;  // for the first dataset
    beast::flat_buffer in_;
    OutMessage out_;  // lives while it is being written
    Clock::time_point write_began_;
    bool accepted_ = false, reading_ = false, writing_ = false, closing_ = false;
    std::uint64_t sent_messages_ = 0, sent_bytes_ = 0;
};

}  // namespace

void startStreamSession(asio::ip::tcp::socket socket, http::request<http::string_body> upgrade,
                        std::unique_ptr<ConnectionList::Slot> slot, ServerContext& context) {
    std::make_shared<StreamSession>(std::move(socket), std::move(upgrade), std::move(slot), context)->start();
}

}  // namespace brickyard

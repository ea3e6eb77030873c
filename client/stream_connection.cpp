#include "client/stream_connection.h"

#include <fmt/format.h>

#include <boost/asio/connect.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/websocket.hpp>
#include <mutex>
#include <optional>

#include "client/network_thread.h"
#include "core/brick_codec.h"
#include "core/percent_code.h"
#include "core/stream_frame.h"
#include "transport/any_stream.h"
#include "transport/plain_stream.h"
#include "transport/tls_stream.h"

namespace brickyard {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace websocket = beast::websocket;
using asio::ip::tcp;
using ErrorCondition = boost::system::error_code;

constexpr std::size_t kMaxMessageBytes = 4 + kMaxServerHeaderBytes + kMaxPayloadBytes;
// A buffer that one long message has grown beyond this is given back.
constexpr std::size_t kKeptBufferBytes = 4u << 20;

}  // namespace

// Kept alive by its own handlers: the owner may be gone before the last of them has run.
struct StreamConnection::State : std::enable_shared_from_this<State> {
    State(asio::io_context& io, StreamAddress to, StreamTimeouts limits, Handlers calls)
        : address(std::move(to)),
          timeouts(limits),
          handlers(std::move(calls)),
          resolver(io),
          socket(io.get_executor()),
          timer(io) {}

    // A completion handler that runs `body(results...)` unless the connection has ended. The gate is what the
    // owner's destructor waits at. An exception is out of memory, in all likelihood: the connection is of no
    // more use, and its owner must learn it.
    template <class Body>
    auto handler(Body body) {
        return [self = this->shared_from_this(), body = std::move(body)](auto&&... results) mutable {
            const std::lock_guard lock(self->gate);
            if (self->ended) return;
            try {
                body(results...);
            } catch (const std::exception& error) {
                self->lose(ErrorCode::kIo, fmt::format("the connection failed: {}", error.what()));
            }
        };
    }

    void start(std::chrono::milliseconds delay) {
        timer.expires_after(delay);
        timer.async_wait(handler([this](ErrorCondition error) {
            if (!error) resolve();
        }));
    }

    void resolve() {
        timer.expires_after(timeouts.connect);
        timer.async_wait(handler([this](ErrorCondition error) {
            if (error || open || lost) return;
            const double seconds = std::chrono::duration<double>(timeouts.connect).count();
            lose(ErrorCode::kTimeout,
                 fmt::format("no answer within {:.3g} s; is `brickyard serve` running there?", seconds));
        }));
        // A number needs no resolver, which would start a thread of its own for the first name.
        ErrorCondition is_name;
        const asio::ip::address number = asio::ip::make_address(address.host, is_name);
        if (!is_name)
            return connect(tcp::resolver::results_type::create(tcp::endpoint(number, address.port),
                                                               address.host, std::to_string(address.port)));
        resolver.async_resolve(
            address.host, std::to_string(address.port),
            handler([this](ErrorCondition error, const tcp::resolver::results_type& found) {
                if (lost) return;
                if (error)
                    return lose(ErrorCode::kNotFound,
                                fmt::format("no such host: {}; check the name", error.message()));
                connect(found);
            }));
    }

    void connect(const tcp::resolver::results_type& found) {
        auto connected = handler([this](ErrorCondition error, const tcp::endpoint&) {
            if (lost) return;
            if (error) {
                const auto code =
                    error == asio::error::connection_refused ? ErrorCode::kRefused : ErrorCode::kIo;
                return lose(code, fmt::format("cannot connect: {}; is `brickyard serve` running there?",
                                              error.message()));
            }
            encrypt();
        });
        // Types in full: Asio would try a generic handler with others.
        asio::async_connect(
            socket, found,
            [connected = std::move(connected)](ErrorCondition error, const tcp::endpoint& at) mutable {
                connected(error, at);
            });
    }

    void encrypt() {
        ErrorCondition ignored;
        socket.set_option(tcp::no_delay(true), ignored);
        std::unique_ptr<ByteStream> bytes;
        if (address.secure) {
            auto tls = loadClientTls(address.authorities);
            if (!tls) return lose(tls.error().code, tls.error().message);
            bytes = makeTlsClientStream(std::move(socket), std::move(*tls), address.host);
        } else {
            bytes = makePlainStream(std::move(socket));
        }
        stream.emplace(std::move(bytes));
        stream->next_layer().bytes().asyncHandshake(OnceHandler(handler([this](ErrorCondition error,
                                                                               std::size_t) {
            if (lost) return;
            if (error)
                return lose(ErrorCode::kRefused,
                            fmt::format("no encrypted connection: {}; is this a port with TLS, and is its "
                                        "certificate one that this machine believes (--tls-ca)?",
                                        error.message()));
            handshake();
        })));
    }

    void handshake() {
        auto& web_socket = *stream;
        web_socket.set_option(websocket::stream_base::timeout{timeouts.connect, timeouts.idle, true});
        web_socket.binary(true);
        web_socket.auto_fragment(false);
        web_socket.read_message_max(kMaxMessageBytes);
        web_socket.async_handshake(
            response, address.hostAndPort(),
            "/" + (address.dataset.empty() ? "v1/stream" : percentEncode(address.dataset)),
            handler([this](ErrorCondition error) {
                if (lost) return;
                if (error == websocket::error::upgrade_declined) {
                    // The body is one line for a person, and not longer than we care for.
                    std::string said = response.body().substr(0, response.body().find('\n'));
                    return lose(
                        ErrorCode::kRefused,
                        fmt::format("the server declined ({}{}{}); is this the port of `brickyard serve`?",
                                    response.result_int(), said.empty() ? "" : ": ", said.substr(0, 200)));
                }
                if (error)
                    return lose(
                        ErrorCode::kRefused,
                        fmt::format("not a Brickyard stream: {}; is this the port of `brickyard serve`?",
                                    error.message()));
                open = true;
                timer.cancel();
                handlers.on_open();
                send();
                read();
            }));
    }

    void read() {
        if (reading || lost || !open || ended) return;
        reading = true;
        stream->async_read(in, handler([this](ErrorCondition error, std::size_t) {
                               reading = false;
                               if (lost) return;
                               if (error) return lose(ErrorCode::kIo, describeLoss(error));
                               const auto data = in.cdata();
                               const bool go_on = handlers.on_message(
                                   {static_cast<const std::byte*>(data.data()), data.size()});
                               if (ended) return;
                               in.clear();
                               if (in.capacity() > kKeptBufferBytes) in.shrink_to_fit();
                               if (go_on) read();
                           }));
    }

    void send() {
        if (sending || lost || !open || ended) return;
        out = handlers.next_message();
        if (out.empty() || ended) return;
        sending = true;
        stream->async_write(asio::buffer(out), handler([this](ErrorCondition error, std::size_t) {
                                sending = false;
                                if (lost) return;
                                // A server that refused us may have closed already: why is still to be read.
                                if (error && !reading) return lose(ErrorCode::kIo, describeLoss(error));
                                if (!error) send();
                            }));
    }

    std::string describeLoss(ErrorCondition error) const {
        if (error == websocket::error::message_too_big)
            return fmt::format("a message is over {} bytes; is the server's version ours?", kMaxMessageBytes);
        if (error == websocket::error::closed || error == asio::error::eof ||
            error == asio::error::connection_reset || error == beast::error::timeout)
            return fmt::format(
                "the connection was lost ({}); start the server again or try again",
                error == beast::error::timeout ? "it answers no more" : "the server closed it");
        return fmt::format("the connection was lost ({}); try again", error.message());
    }

    void lose(ErrorCode code, const std::string& why) {
        if (lost || ended) return;
        lost = true;
        close();
        handlers.on_lost({code, fmt::format("{}: {}", address.url(), why)});
    }

    void close() {
        timer.cancel();
        resolver.cancel();
        ErrorCondition ignored;
        socket.close(ignored);
        if (stream) stream->next_layer().bytes().close();
    }

    const StreamAddress address;
    const StreamTimeouts timeouts;
    const Handlers handlers;
    std::recursive_mutex gate;  // held while a handler runs; recursive, because that may destroy its owner
    bool ended = false;         // guarded by the gate: the owner is gone
    // The network thread's.
    tcp::resolver resolver;
    ByteStream::Socket socket;  // until it is connected
    std::optional<websocket::stream<AnyStream, false>> stream;
    asio::steady_timer timer;  // of the delay, then of connecting
    websocket::response_type response;
    beast::flat_buffer in;
    std::vector<std::byte> out;
    bool open = false, lost = false, reading = false, sending = false;
};

StreamConnection::StreamConnection(StreamAddress address, StreamTimeouts timeouts, Handlers handlers,
                                   std::shared_ptr<NetworkThread> thread, std::chrono::milliseconds delay)
    : thread_(thread ? std::move(thread) : NetworkThread::shared()),
      state_(std::make_shared<State>(thread_->io(), std::move(address), timeouts, std::move(handlers))) {
    asio::post(thread_->io(), state_->handler([raw = state_.get(), delay] { raw->start(delay); }));
}

StreamConnection::~StreamConnection() {
    {
        const std::lock_guard lock(state_->gate);
        state_->ended = true;
    }
    // Only the network thread may touch the socket.
    asio::post(thread_->io(), [state = std::move(state_)] { state->close(); });
}

void StreamConnection::wakeSender() {
    asio::post(thread_->io(), state_->handler([raw = state_.get()] { raw->send(); }));
}

void StreamConnection::resumeReading() {
    asio::post(thread_->io(), state_->handler([raw = state_.get()] { raw->read(); }));
}

}  // namespace brickyard

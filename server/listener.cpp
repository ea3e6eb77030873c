#include "server/listener.h"

#include <fmt/format.h>

#include <boost/asio/buffer.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/strand.hpp>
#include <boost/asio/write.hpp>
#include <chrono>

#include "server/http_session.h"

namespace brickyard {
namespace {

namespace asio = boost::asio;
using asio::ip::tcp;
using ErrorCondition = boost::system::error_code;

// Out of file descriptors, say: trying again at once would only burn the processor.
constexpr std::chrono::milliseconds kPauseAfterError{100};

void turnAway(tcp::socket socket) {
    static constexpr std::string_view kFull =
        "HTTP/1.1 503 Service Unavailable\r\nContent-Type: text/plain\r\nContent-Length: 53\r\nConnection: "
        "close\r\n\r\n"
        "all connections of this server are in use; try later\n";
    ErrorCondition ignored;
    // A fresh socket has room for this; if not, the peer learns it from the close.
    socket.non_blocking(true, ignored);
    socket.send(asio::buffer(kFull), 0, ignored);
    socket.shutdown(tcp::socket::shutdown_send, ignored);
}

}  // namespace

Listener::Listener(asio::io_context& io, ServerContext& context)
    : io_(io), context_(context), acceptor_(asio::make_strand(io)), pause_(acceptor_.get_executor()) {}

Result<std::uint16_t> Listener::open() {
    const ServerOptions& options = context_.options;
    ErrorCondition error;
    tcp::resolver resolver(io_);
    const auto found =
        resolver.resolve(options.host, std::to_string(options.port), tcp::resolver::passive, error);
    if (error || found.empty())
        return fail(ErrorCode::kInvalid,
                    fmt::format("cannot listen on {}: {}; give a host of this machine, for example 127.0.0.1",
                                options.host, error.message()));
    const tcp::endpoint endpoint = found.begin()->endpoint();
    acceptor_.open(endpoint.protocol(), error);
    if (!error) acceptor_.set_option(asio::socket_base::reuse_address(true), error);
    if (!error) acceptor_.bind(endpoint, error);
    if (!error) acceptor_.listen(asio::socket_base::max_listen_connections, error);
    if (error)
        return fail(ErrorCode::kIo,
                    fmt::format("cannot listen on {}:{}: {}; choose another address with --listen",
                                options.host, options.port, error.message()));
    return acceptor_.local_endpoint().port();
}

void Listener::start() {
    asio::post(acceptor_.get_executor(), [self = shared_from_this()] { self->accept(); });
}

void Listener::stop() {
    asio::post(acceptor_.get_executor(), [self = shared_from_this()] {
        ErrorCondition ignored;
        self->acceptor_.close(ignored);
        self->pause_.cancel();
    });
}

void Listener::accept() {
    if (!acceptor_.is_open()) return;
    acceptor_.async_accept(
        asio::make_strand(io_), [self = shared_from_this()](ErrorCondition error, tcp::socket socket) {
            if (error == asio::error::operation_aborted) return;
            if (error) {
                self->context_.log->warn("cannot accept a connection: {}", error.message());
                self->pause_.expires_after(kPauseAfterError);
                self->pause_.async_wait([self](ErrorCondition) { self->accept(); });
                return;
            }
            if (auto slot = self->context_.connections.take())
                startHttpSession(std::move(socket), std::move(slot), self->context_);
            else
                turnAway(std::move(socket));
            self->accept();
        });
}

}  // namespace brickyard

#include "server/listener.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <boost/asio/buffer.hpp>
#include <boost/asio/post.hpp>
#include <chrono>

#include "server/http_session.h"
#include "server/turn_away.h"
#include "transport/plain_stream.h"
#include "transport/tls_stream.h"

namespace brickyard {
namespace {

namespace asio = boost::asio;
using asio::ip::tcp;
using ErrorCondition = boost::system::error_code;

// After an error that may last, trying again at once would only burn the processor.
constexpr std::chrono::milliseconds kPauseAfterError{100};
constexpr int kMostAtATime = 64;

int openSpare() { return ::open("/dev/null", O_RDONLY | O_CLOEXEC); }

}  // namespace

Listener::Listener(const std::vector<std::unique_ptr<IoThread>>& threads, ServerContext& context)
    : threads_(threads),
      context_(context),
      acceptor_(threads.front()->io()),
      pause_(threads.front()->io()),
      spare_descriptor_(openSpare()) {}

Listener::~Listener() {
    if (spare_descriptor_ >= 0) ::close(spare_descriptor_);
}

Result<std::uint16_t> Listener::open() {
    const ServerOptions& options = context_.options;
    ErrorCondition error;
    tcp::resolver resolver(acceptor_.get_executor());
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
    const std::uint16_t port = acceptor_.local_endpoint().port();
    if (!endpoint.address().is_loopback() && !context_.tokens.get()->required())
        context_.log.write(
            LogLevel::critical,
            "ANYBODY who reaches this address can read every dataset: it is not the loopback, and no "
            "token is asked for; give --token-file, or listen on 127.0.0.1",
            {{"host", options.host}, {"port", std::uint64_t(port)}});
    if (!endpoint.address().is_loopback() && !context_.tls.get())
        context_.log.write(
            LogLevel::warn,
            "tokens and data cross the network in the clear; give --tls-cert and --tls-key, or put "
            "a proxy that encrypts in front");
    return port;
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
    IoThread& thread = *threads_[next_thread_++ % threads_.size()];
    const auto socket = std::make_shared<ByteStream::Socket>(thread.io());
    acceptor_.async_accept(*socket, [self = shared_from_this(), &thread, socket](ErrorCondition error) {
        if (error == asio::error::operation_aborted) return;
        if (error) return self->onError(error);
        self->serve(std::move(*socket), thread);
        self->acceptWaiting();
        self->accept();
    });
}

// Whoever waits as well: one a turn of a busy loop would let a crowd wait for seconds.
void Listener::acceptWaiting() {
    ErrorCondition error;
    acceptor_.non_blocking(true, error);
    for (int count = 0; count < kMostAtATime; ++count) {
        IoThread& thread = *threads_[next_thread_ % threads_.size()];
        ByteStream::Socket socket(thread.io());
        acceptor_.accept(socket, error);
        // What is wrong shows at the next turn again.
        if (error) return;
        ++next_thread_;
        serve(std::move(socket), thread);
    }
}

void Listener::serve(ByteStream::Socket socket, IoThread& thread) {
    ErrorCondition error;
    const auto from = socket.remote_endpoint(error);
    if (error) return;  // gone already
    auto slot = context_.connections.take(from.address());
    if (!slot) {
        const bool full = context_.connections.count() >= context_.options.max_connections;
        context_.metrics.connectionRefused(full ? "full" : "address");
        return turnAway(std::move(socket), thread,
                        full ? TurnedAwayFor::kServerFull : TurnedAwayFor::kAddressFull);
    }
    // Small answers must not wait for the peer's acknowledgement of the one before.
    socket.set_option(tcp::no_delay(true), error);
    auto tls = context_.tls.get();
    auto stream =
        tls ? makeTlsServerStream(std::move(socket), std::move(tls)) : makePlainStream(std::move(socket));
    asio::post(thread.io(),
               [stream = std::move(stream), slot = std::move(slot), &thread, &context = context_]() mutable {
                   startHttpSession(std::move(stream), std::move(slot), thread, context);
               });
}

void Listener::onError(ErrorCondition error) {
    const bool no_descriptor = error == asio::error::no_descriptors || error.value() == ENFILE;
    context_.log.write(LogLevel::warn, "cannot accept a connection", {{"why", error.message()}});
    if (no_descriptor) {
        context_.metrics.connectionRefused("descriptors");
        // Whoever waits in the queue learns that there is no place, instead of being left there.
        ::close(spare_descriptor_);
        ErrorCondition still;
        acceptor_.non_blocking(true, still);
        acceptor_.accept(still);  // and closes it
        spare_descriptor_ = openSpare();
    }
    pause_.expires_after(kPauseAfterError);
    pause_.async_wait([self = shared_from_this()](ErrorCondition) { self->accept(); });
}

}  // namespace brickyard

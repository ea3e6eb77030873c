#include "tools/bench/delay_proxy.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <boost/asio/buffer.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/write.hpp>
#include <deque>
#include <functional>
#include <random>
#include <set>
#include <thread>
#include <utility>
#include <vector>

namespace brickyard {
namespace {

namespace asio = boost::asio;
using asio::ip::tcp;
using boost::system::error_code;
using Clock = std::chrono::steady_clock;

// What one read takes at most. Less on a slow link, so that bytes arrive as a stream and not in lumps.
constexpr std::size_t kMaxChunkBytes = 64u << 10;
constexpr std::size_t kMinChunkBytes = 1460;
constexpr std::uint64_t kFastBytesPerSecond = 1'250'000'000;
// The kernel's own buffers would be a second, unmeasured queue in front of the link.
constexpr int kReceiveBufferBytes = 128 << 10;

std::size_t chunkBytes(const DelayProxyLink& link) {
    if (link.bytes_per_second == 0) return kMaxChunkBytes;
    // 2 ms of the link.
    return std::size_t(
        std::clamp<std::uint64_t>(link.bytes_per_second / 500, kMinChunkBytes, kMaxChunkBytes));
}

std::uint64_t maxHeldBytes(const DelayProxyLink& link) {
    const double rate = double(link.bytes_per_second == 0 ? kFastBytesPerSecond : link.bytes_per_second);
    return link.queue_bytes +
           std::uint64_t(rate * std::chrono::duration<double>(link.delay + link.jitter).count());
}

// What all connections share; outlives them. On the proxy's thread, but for the counts.
struct Shared {
    bool stalled = false;
    std::mt19937_64 random;
    std::atomic<std::uint64_t> connections{0}, open{0}, bytes_to_server{0}, bytes_to_client{0}, most_held{0};
};

// One direction: reads from one socket, holds what travels, writes to the other. Part of its connection,
// which every handler keeps alive through `owner`.
class Pipe {
public:
    // `close` ends the connection; `ended` says that this direction has handed over all there was.
    struct Hooks {
        std::function<std::shared_ptr<void>()> owner;
        std::function<void()> close;
        std::function<void()> ended;
    };

    Pipe(tcp::socket& from, tcp::socket& to, const DelayProxyLink& link, Shared& shared,
         std::atomic<std::uint64_t>& handed_over)
        : from_(from),
          to_(to),
          link_(link),
          shared_(shared),
          all_handed_over_(handed_over),
          chunk_bytes_(chunkBytes(link)),
          max_held_bytes_(maxHeldBytes(link)),
          timer_(from.get_executor()) {}

    // Nothing that is read leaves before `earliest`.
    void start(Hooks hooks, Clock::time_point earliest) {
        hooks_ = std::move(hooks);
        link_free_ = earliest;
        read();
    }
    // Looks again at what is due: the proxy was stalled and is not any more.
    void deliver();
    // From now on what is read is dropped, and the other end hears nothing.
    void vanish() {
        vanished_ = true;
        timer_.cancel();
        if (!hooks_.owner) return;  // connecting still
        if (closed_) return end();
        read();
    }
    // Nothing more is read or written, and no hook is called.
    void stop() {
        stopped_ = true;
        timer_.cancel();
    }

private:
    struct Chunk {
        std::vector<char> bytes;  // none: the sender has closed
        Clock::time_point arrival;
    };

    void read();
    void onRead(error_code error, std::vector<char> bytes);
    Clock::time_point arrivalOf(std::size_t bytes);
    void onWritten(error_code error, std::size_t bytes);
    void end() {
        if (!std::exchange(ended_, true)) hooks_.ended();
    }
    std::uint64_t faultAt() const { return std::min(link_.cut_after_bytes, link_.stall_after_bytes); }

    tcp::socket& from_;
    tcp::socket& to_;
    const DelayProxyLink& link_;
    Shared& shared_;
    std::atomic<std::uint64_t>& all_handed_over_;
    const std::size_t chunk_bytes_;
    const std::uint64_t max_held_bytes_;
    asio::steady_timer timer_;
    Hooks hooks_;
    std::deque<Chunk> chunks_;  // in order of arrival
    std::size_t front_written_ = 0;
    std::uint64_t held_bytes_ = 0, handed_over_ = 0;
    Clock::time_point link_free_, last_arrival_;
    bool reading_ = false, writing_ = false, closed_ = false, ended_ = false;
    bool vanished_ = false, stopped_ = false;
};

void Pipe::read() {
    if (reading_ || closed_ || stopped_ || (held_bytes_ >= max_held_bytes_ && !vanished_)) return;
    reading_ = true;
    std::vector<char> bytes(chunk_bytes_);
    const auto buffer = asio::buffer(bytes);
    from_.async_read_some(buffer, [this, owner = hooks_.owner(), bytes = std::move(bytes)](
                                      error_code error, std::size_t count) mutable {
        bytes.resize(count);
        onRead(error, std::move(bytes));
    });
}

void Pipe::onRead(error_code error, std::vector<char> bytes) {
    reading_ = false;
    if (stopped_) return;
    if (error) {
        closed_ = true;
        bytes.clear();
    }
    if (vanished_) {
        if (closed_) return end();
        return read();
    }
    held_bytes_ += bytes.size();
    if (held_bytes_ > shared_.most_held) shared_.most_held = held_bytes_;
    // A close travels as bytes do.
    const auto arrival = arrivalOf(bytes.size());
    chunks_.push_back({std::move(bytes), arrival});
    deliver();
    read();
}

Clock::time_point Pipe::arrivalOf(std::size_t bytes) {
    link_free_ = std::max(link_free_, Clock::now());
    if (link_.bytes_per_second != 0)
        link_free_ += std::chrono::duration_cast<Clock::duration>(
            std::chrono::duration<double>(double(bytes) / double(link_.bytes_per_second)));
    auto arrival = link_free_ + link_.delay;
    if (link_.jitter.count() > 0)
        arrival += std::chrono::microseconds(shared_.random() % (std::uint64_t(link_.jitter.count()) + 1));
    // Order is kept: what overtakes waits.
    last_arrival_ = std::max(last_arrival_, arrival);
    return last_arrival_;
}

void Pipe::deliver() {
    if (writing_ || stopped_ || vanished_ || shared_.stalled || chunks_.empty()) return;
    Chunk& front = chunks_.front();
    if (front.arrival > Clock::now()) {
        // Setting the time anew cancels an older wait.
        timer_.expires_at(front.arrival);
        timer_.async_wait([this, owner = hooks_.owner()](error_code error) {
            if (!error) deliver();
        });
        return;
    }
    if (handed_over_ >= link_.stall_after_bytes) return;
    if (front.bytes.empty()) {
        chunks_.pop_front();
        error_code ignored;
        to_.shutdown(tcp::socket::shutdown_send, ignored);
        return end();
    }
    const std::size_t count =
        std::size_t(std::min<std::uint64_t>(front.bytes.size() - front_written_, faultAt() - handed_over_));
    writing_ = true;
    asio::async_write(
        to_, asio::buffer(front.bytes.data() + front_written_, count),
        [this, owner = hooks_.owner()](error_code error, std::size_t written) { onWritten(error, written); });
}

void Pipe::onWritten(error_code error, std::size_t bytes) {
    writing_ = false;
    if (stopped_ || vanished_) return;
    if (error) return hooks_.close();
    all_handed_over_ += bytes;
    handed_over_ += bytes;
    held_bytes_ -= bytes;
    front_written_ += bytes;
    if (front_written_ == chunks_.front().bytes.size()) {
        chunks_.pop_front();
        front_written_ = 0;
    }
    if (handed_over_ >= link_.cut_after_bytes) return hooks_.close();
    deliver();
    read();
}

// A client's connection and its twin to the server.
class Connection : public std::enable_shared_from_this<Connection> {
public:
    // `forget` is called once, when both sockets are closed.
    Connection(tcp::socket client, const DelayProxyOptions& options, Shared& shared,
               std::function<void(const std::shared_ptr<Connection>&)> forget)
        : options_(options),
          shared_(shared),
          forget_(std::move(forget)),
          client_(std::move(client)),
          server_(client_.get_executor()),
          to_server_(client_, server_, options_.to_server, shared, shared.bytes_to_server),
          to_client_(server_, client_, options_.to_client, shared, shared.bytes_to_client) {
        ++shared_.open;
    }
    ~Connection() { --shared_.open; }
    Connection(const Connection&) = delete;
    Connection& operator=(const Connection&) = delete;

    void start() {
        const auto accepted = Clock::now();
        const tcp::endpoint server(asio::ip::address_v4::loopback(), options_.server_port);
        server_.async_connect(server, [this, self = shared_from_this(), accepted](error_code error) {
            if (error || closed_) return close();
            for (tcp::socket* socket : {&client_, &server_}) {
                error_code ignored;
                socket->set_option(tcp::no_delay(true), ignored);
                socket->set_option(asio::socket_base::receive_buffer_size(kReceiveBufferBytes), ignored);
            }
            const auto round_trip = options_.connecting_takes_a_round_trip
                                        ? options_.to_server.delay + options_.to_client.delay
                                        : std::chrono::microseconds(0);
            const Pipe::Hooks hooks{[this] { return shared_from_this(); }, [this] { close(); },
                                    [this] { onEnded(); }};
            to_server_.start(hooks, accepted + round_trip);
            to_client_.start(hooks, accepted);
        });
    }
    void deliver() {
        to_server_.deliver();
        to_client_.deliver();
    }
    void vanish() {
        to_server_.vanish();
        to_client_.vanish();
    }
    void close() {
        if (std::exchange(closed_, true)) return;
        to_server_.stop();
        to_client_.stop();
        for (tcp::socket* socket : {&client_, &server_}) {
            error_code ignored;
            // Before close(), which sends a reset where something was not read: what was handed over stays.
            socket->shutdown(tcp::socket::shutdown_send, ignored);
            socket->close(ignored);
        }
        forget_(shared_from_this());
    }

private:
    void onEnded() {
        if (++ended_ == 2) close();
    }

    const DelayProxyOptions& options_;
    Shared& shared_;
    const std::function<void(const std::shared_ptr<Connection>&)> forget_;
    tcp::socket client_, server_;
    Pipe to_server_, to_client_;
    int ended_ = 0;
    bool closed_ = false;
};

}  // namespace

struct DelayProxy::State {
    explicit State(const DelayProxyOptions& the_options) : options(the_options) {
        shared.random.seed(options.seed);
    }

    void accept() {
        acceptor.async_accept([this](error_code error, tcp::socket client) {
            if (!acceptor.is_open()) return;
            if (error) {
                // No file descriptor left, for one: it will not be better at once.
                pause.expires_after(std::chrono::milliseconds(20));
                pause.async_wait([this](error_code stopped) {
                    if (!stopped) accept();
                });
                return;
            }
            ++shared.connections;
            const auto connection = std::make_shared<Connection>(
                std::move(client), options, shared,
                [this](const std::shared_ptr<Connection>& closed) { connections.erase(closed); });
            connections.insert(connection);
            connection->start();
            accept();
        });
    }
    void forEach(void (Connection::*act)()) {
        // A copy: whoever closes leaves the set.
        for (const auto& each : std::vector(connections.begin(), connections.end())) ((*each).*act)();
    }
    void stop() {
        error_code ignored;
        acceptor.close(ignored);
        pause.cancel();
        forEach(&Connection::close);
    }

    const DelayProxyOptions options;
    Shared shared;
    asio::io_context io{1};
    tcp::acceptor acceptor{io};
    asio::steady_timer pause{io};
    std::uint16_t port = 0;
    // The only ones to hold a connection that waits for nothing: one that is stalled and full.
    std::set<std::shared_ptr<Connection>> connections;
    std::jthread thread;
};

DelayProxy::DelayProxy(std::unique_ptr<State> state) : state_(std::move(state)) {}

Result<std::unique_ptr<DelayProxy>> DelayProxy::start(const DelayProxyOptions& options) {
    auto state = std::make_unique<State>(options);
    const tcp::endpoint place(asio::ip::address_v4::loopback(), options.listen_port);
    error_code error;
    state->acceptor.open(place.protocol(), error);
    if (!error) state->acceptor.set_option(tcp::acceptor::reuse_address(true), error);
    if (!error) state->acceptor.bind(place, error);
    if (!error) state->acceptor.listen(asio::socket_base::max_listen_connections, error);
    if (!error) state->port = state->acceptor.local_endpoint(error).port();
    if (error)
        return fail(ErrorCode::kIo, fmt::format("127.0.0.1:{}: cannot listen: {}; choose another port",
                                                options.listen_port, error.message()));
    state->accept();
    state->thread = std::jthread([io = &state->io] { io->run(); });
    return std::unique_ptr<DelayProxy>(new DelayProxy(std::move(state)));
}

DelayProxy::~DelayProxy() {
    // With the last handler gone run() returns, and nothing refers to a connection any more.
    asio::post(state_->io, [state = state_.get()] { state->stop(); });
    state_->thread.join();
}

std::uint16_t DelayProxy::port() const { return state_->port; }

DelayProxy::Counts DelayProxy::counts() const {
    const Shared& shared = state_->shared;
    return {shared.connections, shared.open, shared.bytes_to_server, shared.bytes_to_client,
            shared.most_held};
}

void DelayProxy::stall(bool stalled) {
    asio::post(state_->io, [state = state_.get(), stalled] {
        state->shared.stalled = stalled;
        if (!stalled) state->forEach(&Connection::deliver);
    });
}

void DelayProxy::cut() {
    asio::post(state_->io, [state = state_.get()] { state->forEach(&Connection::close); });
}

void DelayProxy::vanish() {
    asio::post(state_->io, [state = state_.get()] { state->forEach(&Connection::vanish); });
}

}  // namespace brickyard

#include "server/turn_away.h"

#include <array>
#include <atomic>
#include <boost/asio/post.hpp>
#include <memory>

namespace brickyard {
namespace {

namespace asio = boost::asio;
using asio::ip::tcp;
using ErrorCondition = boost::system::error_code;

constexpr std::string_view kServerFull =
    "HTTP/1.1 503 Service Unavailable\r\nContent-Type: text/plain\r\nContent-Length: 53\r\nRetry-After: 1\r\n"
    "Connection: close\r\n\r\n"
    "all connections of this server are in use; try later\n";
constexpr std::string_view kAddressFull =
    "HTTP/1.1 429 Too Many Requests\r\nContent-Type: text/plain\r\nContent-Length: 66\r\nRetry-After: 1\r\n"
    "Connection: close\r\n\r\n"
    "your address has all the connections that it may have; close some\n";
constexpr std::chrono::milliseconds kPatience{1000};
constexpr int kMostAtATime = 256;

std::atomic<int> waiting{0};

// Kept alive by its own handlers.
class Refusal : public std::enable_shared_from_this<Refusal>, private Timed {
public:
    Refusal(ByteStream::Socket socket, IoThread& thread, std::string_view answer)
        : Timed(thread), socket_(std::move(socket)), answer_(answer) {}
    ~Refusal() override { --waiting; }

    void start() {
        expireAfter(kPatience);
        read();
    }

private:
    // Until the peer closes, or its time is up.
    void read() {
        socket_.async_read_some(asio::buffer(buffer_),
                                [self = shared_from_this()](ErrorCondition error, std::size_t) {
                                    if (error) return;
                                    if (!self->answered_) self->answer();
                                    self->read();
                                });
    }

    void answer() {
        answered_ = true;
        ErrorCondition ignored;
        socket_.non_blocking(true, ignored);
        // A fresh socket has room for this.
        socket_.send(asio::buffer(answer_), 0, ignored);
        socket_.shutdown(tcp::socket::shutdown_send, ignored);
    }

    void onDeadline() override {
        if (!answered_) {
            // It asks nothing; it is told all the same.
            expireAfter(kPatience);
            return answer();
        }
        ErrorCondition ignored;
        socket_.close(ignored);
    }

    ByteStream::Socket socket_;
    const std::string_view answer_;
    std::array<char, 2048> buffer_;
    bool answered_ = false;
};

}  // namespace

void turnAway(ByteStream::Socket socket, IoThread& thread, TurnedAwayFor why) {
    if (++waiting > kMostAtATime) {
        --waiting;
        return;
    }
    asio::post(thread.io(), [socket = std::move(socket), &thread, why]() mutable {
        std::make_shared<Refusal>(std::move(socket), thread,
                                  why == TurnedAwayFor::kServerFull ? kServerFull : kAddressFull)
            ->start();
    });
}

}  // namespace brickyard

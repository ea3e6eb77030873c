// The far network on loopback. A busy machine may make anything later, never earlier: times have lower bounds
// only.
#include "tools/bench/delay_proxy.h"

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <functional>
#include <string>
#include <string_view>
#include <thread>

namespace brickyard {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

sockaddr_in loopback(std::uint16_t port) {
    sockaddr_in place{};
    place.sin_family = AF_INET;
    place.sin_port = htons(port);
    place.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return place;
}

// A connection's end, blocking, with a deadline on every read.
class Socket {
public:
    explicit Socket(int descriptor) : descriptor_(descriptor) { setPatience(10s); }
    ~Socket() { close(); }
    Socket(const Socket&) = delete;
    Socket& operator=(const Socket&) = delete;

    static Socket connect(std::uint16_t port) {
        const int descriptor = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
        const sockaddr_in to = loopback(port);
        EXPECT_EQ(::connect(descriptor, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
        return Socket(descriptor);
    }
    void setPatience(std::chrono::milliseconds patience) {
        const timeval time{.tv_sec = patience.count() / 1000, .tv_usec = patience.count() % 1000 * 1000};
        ::setsockopt(descriptor_, SOL_SOCKET, SO_RCVTIMEO, &time, sizeof time);
        ::setsockopt(descriptor_, SOL_SOCKET, SO_SNDTIMEO, &time, sizeof time);
    }
    // How many bytes the kernel took before the peer closed or the deadline passed.
    std::size_t send(std::string_view bytes) {
        std::size_t sent = 0;
        while (sent < bytes.size()) {
            const ssize_t some = ::send(descriptor_, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
            if (some <= 0) break;
            sent += std::size_t(some);
        }
        return sent;
    }
    // Up to `bytes`; less where the peer closed or the deadline passed.
    std::string receive(std::size_t bytes) {
        std::string all(bytes, '\0');
        std::size_t size = 0;
        while (size < bytes) {
            const ssize_t some = ::recv(descriptor_, all.data() + size, bytes - size, 0);
            if (some <= 0) {
                ended_ = some == 0 || (errno != EAGAIN && errno != EWOULDBLOCK);
                break;
            }
            size += std::size_t(some);
        }
        all.resize(size);
        return all;
    }
    // Whether the last receive() ended because the peer has closed.
    bool ended() const { return ended_; }
    void finish() { ::shutdown(descriptor_, SHUT_WR); }
    void close() {
        if (descriptor_ >= 0) ::close(descriptor_);
        descriptor_ = -1;
    }

private:
    int descriptor_;
    bool ended_ = false;
};

// Accepts one connection and hands it to `serve` on a thread of its own.
class OneServer {
public:
    explicit OneServer(std::function<void(Socket& client)> serve) {
        listener_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
        sockaddr_in place = loopback(0);
        socklen_t size = sizeof place;
        EXPECT_EQ(::bind(listener_, reinterpret_cast<const sockaddr*>(&place), size), 0);
        EXPECT_EQ(::listen(listener_, 4), 0);
        EXPECT_EQ(::getsockname(listener_, reinterpret_cast<sockaddr*>(&place), &size), 0);
        port_ = ntohs(place.sin_port);
        thread_ = std::thread([listener = listener_, serve = std::move(serve)] {
            Socket client(::accept(listener, nullptr, nullptr));
            serve(client);
        });
    }
    ~OneServer() {
        // Wakes a thread that nobody has called.
        ::shutdown(listener_, SHUT_RDWR);
        join();
        ::close(listener_);
    }
    // REQUIRES: somebody calls.
    void join() {
        if (thread_.joinable()) thread_.join();
    }
    std::uint16_t port() const { return port_; }

private:
    int listener_ = -1;
    std::uint16_t port_ = 0;
    std::thread thread_;
};

void echo(Socket& client) {
    for (std::string byte; !(byte = client.receive(1)).empty();) client.send(byte);
}

// No two places are alike for a long way, so that whatever is lost, doubled or swapped shows.
std::string pattern(std::size_t bytes) {
    std::string all(bytes, '\0');
    std::uint32_t state = 1;
    for (char& each : all) {
        state = state * 1664525u + 1013904223u;
        each = char(state >> 24);
    }
    return all;
}

bool comesTrue(const std::function<bool()>& condition) {
    for (int i = 0; i < 500 && !condition(); ++i) std::this_thread::sleep_for(10ms);
    return condition();
}

std::unique_ptr<DelayProxy> startProxy(const DelayProxyOptions& options) {
    auto proxy = DelayProxy::start(options);
    EXPECT_TRUE(proxy) << proxy.error().message;
    return std::move(*proxy);
}

TEST(DelayProxyTest, ARoundTripTakesTheDelayOfBothWays) {
    OneServer server(echo);
    const auto proxy = startProxy(
        {.server_port = server.port(), .to_server = {.delay = 30ms}, .to_client = {.delay = 20ms}});
    const auto begin = Clock::now();
    Socket client = Socket::connect(proxy->port());
    client.send("a");
    EXPECT_EQ(client.receive(1), "a");
    const auto connected = Clock::now();
    EXPECT_GE(connected - begin, 100ms) << "connecting takes a round trip as well";
    client.send("b");
    EXPECT_EQ(client.receive(1), "b");
    EXPECT_GE(Clock::now() - connected, 50ms);
}

TEST(DelayProxyTest, SendsNoFasterThanTheLink) {
    const std::string bytes = pattern(2'000'000);
    OneServer server([&](Socket& client) { client.send(bytes); });
    const auto proxy =
        startProxy({.server_port = server.port(), .to_client = {.bytes_per_second = 2'000'000}});
    Socket client = Socket::connect(proxy->port());
    const auto begin = Clock::now();
    EXPECT_EQ(client.receive(1000).size(), 1000u);
    const auto first = Clock::now() - begin;
    EXPECT_TRUE(client.receive(bytes.size() - 1000) == bytes.substr(1000));
    EXPECT_GE(Clock::now() - begin, 900ms);
    EXPECT_LT(first, 900ms) << "everything came in one lump at the end";
}

TEST(DelayProxyTest, ChangesNoByteInEitherDirection) {
    const std::string up = pattern(3'000'000), down = pattern(5'000'000);
    std::string received;
    OneServer server([&](Socket& client) {
        std::thread sender([&] { client.send(down); });
        received = client.receive(up.size());
        sender.join();
    });
    const DelayProxyLink link{.delay = 3ms, .jitter = 5ms, .bytes_per_second = 50'000'000};
    const auto proxy = startProxy({.server_port = server.port(), .to_server = link, .to_client = link});
    Socket client = Socket::connect(proxy->port());
    std::thread sender([&] { client.send(up); });
    EXPECT_TRUE(client.receive(down.size()) == down);
    sender.join();
    server.join();
    EXPECT_TRUE(received == up);
    // Bytes are counted once they are gone, so the receiver may be quicker.
    EXPECT_TRUE(comesTrue([&] { return proxy->counts().bytes_to_server == up.size(); }));
    EXPECT_TRUE(comesTrue([&] { return proxy->counts().bytes_to_client == down.size(); }));
}

TEST(DelayProxyTest, CutsAfterExactlySoManyBytes) {
    const std::string bytes = pattern(500'000);
    for (const std::uint64_t cut : {0u, 1u, 65'536u, 123'457u}) {
        OneServer server([&](Socket& client) { client.send(bytes); });
        const auto proxy = startProxy({.server_port = server.port(), .to_client = {.cut_after_bytes = cut}});
        Socket client = Socket::connect(proxy->port());
        EXPECT_TRUE(client.receive(bytes.size()) == bytes.substr(0, cut)) << cut;
        EXPECT_TRUE(client.ended()) << cut;
    }
}

TEST(DelayProxyTest, StallsAfterExactlySoManyBytesAndStaysOpen) {
    const std::string bytes = pattern(500'000);
    OneServer server([&](Socket& client) {
        client.send(bytes);
        client.receive(1);
    });
    const auto proxy =
        startProxy({.server_port = server.port(), .to_client = {.stall_after_bytes = 100'001}});
    Socket client = Socket::connect(proxy->port());
    client.setPatience(200ms);
    EXPECT_TRUE(client.receive(bytes.size()) == bytes.substr(0, 100'001));
    EXPECT_FALSE(client.ended());
    EXPECT_EQ(proxy->counts().open, 1u);
}

TEST(DelayProxyTest, GoesOnWhereItWasStalled) {
    OneServer server(echo);
    const auto proxy = startProxy({.server_port = server.port()});
    Socket client = Socket::connect(proxy->port());
    client.send("a");
    EXPECT_EQ(client.receive(1), "a");
    proxy->stall(true);
    client.send("b");
    client.setPatience(100ms);
    EXPECT_EQ(client.receive(1), "");
    EXPECT_FALSE(client.ended());
    proxy->stall(false);
    client.setPatience(10s);
    EXPECT_EQ(client.receive(1), "b");
}

TEST(DelayProxyTest, AVanishedNetworkTellsNobody) {
    std::string received;
    OneServer server([&](Socket& client) {
        client.send("hello");
        client.setPatience(300ms);
        received = client.receive(100);
        EXPECT_FALSE(client.ended()) << "the server hears that the client has closed";
    });
    const auto proxy = startProxy({.server_port = server.port()});
    {
        Socket client = Socket::connect(proxy->port());
        EXPECT_EQ(client.receive(5), "hello");
        proxy->vanish();
        // Posted to the same thread before what the client sends from now on can be read.
        std::this_thread::sleep_for(50ms);
        EXPECT_EQ(client.send("lost"), 4u);
    }
    server.join();
    EXPECT_EQ(received, "");
}

TEST(DelayProxyTest, CutEndsBothSides) {
    std::string received = "?";
    OneServer server([&](Socket& client) {
        client.send("hello");
        received = client.receive(1);
        EXPECT_TRUE(client.ended());
    });
    const auto proxy = startProxy({.server_port = server.port()});
    Socket client = Socket::connect(proxy->port());
    EXPECT_EQ(client.receive(5), "hello");
    proxy->cut();
    EXPECT_EQ(client.receive(1), "");
    EXPECT_TRUE(client.ended());
    server.join();
    EXPECT_EQ(received, "");
}

TEST(DelayProxyTest, AClosedSideIsPassedOnAfterItsBytes) {
    const std::string bytes = pattern(200'000);
    std::string received;
    OneServer server([&](Socket& client) {
        received = client.receive(bytes.size() + 1);
        client.send("done");
    });
    const DelayProxyLink link{.delay = 10ms};
    const auto proxy = startProxy({.server_port = server.port(), .to_server = link, .to_client = link});
    Socket client = Socket::connect(proxy->port());
    client.send(bytes);
    client.finish();
    EXPECT_EQ(client.receive(5), "done");
    EXPECT_TRUE(client.ended());
    server.join();
    EXPECT_TRUE(received == bytes);
    // Its sockets go with it.
    EXPECT_TRUE(comesTrue([&] { return proxy->counts().open == 0; }));
}

// The receiver reads nothing, the sender has no end.
TEST(DelayProxyTest, HoldsNoMoreThanTheLinkAndItsQueue) {
    const std::string bytes = pattern(1 << 20);
    std::size_t sent = 0;
    OneServer server([&](Socket& client) {
        client.setPatience(300ms);
        for (std::size_t some = bytes.size(); some == bytes.size(); sent += some) some = client.send(bytes);
    });
    const DelayProxyLink link{.delay = 10ms, .bytes_per_second = 100'000'000, .queue_bytes = 500'000};
    const auto proxy = startProxy({.server_port = server.port(), .to_client = link});
    Socket client = Socket::connect(proxy->port());
    server.join();
    EXPECT_GE(proxy->counts().most_held_bytes, 500'000u);
    EXPECT_LE(proxy->counts().most_held_bytes, 1'500'000u + (64u << 10));
    EXPECT_LT(sent, 64u << 20);
}

TEST(DelayProxyTest, EndsAClientWhoseServerIsNotThere) {
    std::uint16_t nobody = 0;
    {
        OneServer server([](Socket&) {});
        nobody = server.port();
    }
    const auto proxy = startProxy({.server_port = nobody});
    Socket client = Socket::connect(proxy->port());
    EXPECT_EQ(client.receive(1), "");
    EXPECT_TRUE(client.ended());
}

TEST(DelayProxyTest, SaysThatItsPortIsTaken) {
    OneServer server([](Socket&) {});
    const auto proxy = DelayProxy::start({.server_port = 1, .listen_port = server.port()});
    ASSERT_FALSE(proxy);
    EXPECT_THAT(proxy.error().message, testing::HasSubstr("choose another port"));
}

}  // namespace
}  // namespace brickyard

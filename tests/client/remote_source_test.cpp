// The client's end of the stream against a real server, and against peers that are none.
#include "client/remote_source.h"

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <set>
#include <thread>

#include "client/local_source.h"
#include "server/server.h"
#include "tiny_dataset.h"

namespace brickyard {
namespace {

using testing::HasSubstr;
using Clock = std::chrono::steady_clock;

// Listens on loopback; each test says what it does with the one connection that comes.
class FakePeer {
public:
    explicit FakePeer(std::function<void(int)> serve) {
        listener_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
        sockaddr_in at{};
        at.sin_family = AF_INET;
        at.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        ::bind(listener_, reinterpret_cast<const sockaddr*>(&at), sizeof at);
        ::listen(listener_, 4);
        socklen_t size = sizeof at;
        ::getsockname(listener_, reinterpret_cast<sockaddr*>(&at), &size);
        port_ = ntohs(at.sin_port);
        thread_ = std::thread([this, serve = std::move(serve)] {
            const int connection = ::accept(listener_, nullptr, nullptr);
            if (connection < 0) return;
            serve(connection);
            ::close(connection);
        });
    }
    ~FakePeer() {
        ::shutdown(listener_, SHUT_RDWR);
        thread_.join();
        ::close(listener_);
    }
    std::uint16_t port() const { return port_; }

private:
    int listener_ = -1;
    std::uint16_t port_ = 0;
    std::thread thread_;
};

// Until the peer closes.
void drain(int connection) {
    char buffer[4096];
    while (::recv(connection, buffer, sizeof buffer, 0) > 0) continue;
}

StreamAddress addressOf(std::uint16_t port, const std::string& dataset = "tiny") {
    StreamAddress address;
    address.host = "127.0.0.1";
    address.port = port;
    address.dataset = dataset;
    return address;
}

class RemoteSourceTest : public testing::Test {
protected:
    void SetUp() override { start({}); }
    void start(ServerOptions options) {
        server_.reset();
        options.port = 0;
        server_ =
            std::move(*Server::start(std::move(*Catalog::open({tiny_.folder()}, 8, 1u << 20)), options));
    }
    std::unique_ptr<BrickSource> connect() {
        auto source = openSource("ws://127.0.0.1:" + std::to_string(server_->port()) + "/tiny", "");
        EXPECT_TRUE(source) << source.error().message;
        return std::move(*source);
    }
    static std::vector<Arrival> takeAll(BrickSource& source) {
        std::vector<Arrival> all;
        while (true) {
            auto chunk = source.take(Clock::now() + std::chrono::seconds(10));
            EXPECT_TRUE(chunk) << chunk.error().message;
            if (!chunk || chunk->empty()) return all;
            for (Arrival& arrival : *chunk) all.push_back(std::move(arrival));
        }
    }
    PageWish listOf(std::size_t pages, std::uint64_t credit = 1u << 30) const {
        PageWish wish;
        wish.credit_bytes = credit;
        const auto bricks = tiny_.bricks(0);
        for (std::size_t i = 0; i < pages; ++i) wish.pages.push_back({false, bricks[i % bricks.size()]});
        return wish;
    }

    TinyDataset tiny_{"tiny", {.frames = {7, 30}, .levels = 4, .payload_bytes = 1024}};
    std::unique_ptr<Server> server_;
};

TEST_F(RemoteSourceTest, GivesTheSameAsTheFolder) {
    auto remote = connect();
    auto local = std::move(*LocalSource::open(tiny_.folder()));
    EXPECT_EQ(remote->manifest().SerializeAsString(), local->manifest().SerializeAsString());
    EXPECT_EQ(remote->openFrame(30)->SerializeAsString(), local->openFrame(30)->SerializeAsString());
    PageWish wish = listOf(300);
    wish.pages.insert(wish.pages.begin(), {{true, {0, 0, 0}}, {true, {1, 0, 0}}});
    wish.pages.push_back({false, {0, 7, 7}});
    for (BrickSource* source : {remote.get(), static_cast<BrickSource*>(local.get())})
        ASSERT_TRUE(source->wish(wish));
    const auto far = takeAll(*remote), near = takeAll(*local);
    ASSERT_EQ(far.size(), near.size());
    for (std::size_t i = 0; i < far.size(); ++i) {
        EXPECT_EQ(far[i].page.address, near[i].page.address);
        EXPECT_EQ(far[i].bytes.has_value(), near[i].bytes.has_value());
        if (far[i].bytes) EXPECT_EQ(*far[i].bytes, *near[i].bytes);
    }
    EXPECT_FALSE(far.back().bytes);
    EXPECT_TRUE(remote->wishDone());
    EXPECT_EQ(remote->counters().bytes_streamed, local->counters().bytes_streamed);
    EXPECT_EQ(remote->counters().pages_streamed, local->counters().pages_streamed);
    EXPECT_EQ(remote->counters().blocks_streamed, local->counters().blocks_streamed);
    EXPECT_EQ(remote->counters().round_trips, local->counters().round_trips);
}

TEST_F(RemoteSourceTest, ACameraGivesTheSameAsTheFolder) {
    auto remote = connect();
    auto local = std::move(*LocalSource::open(tiny_.folder()));
    PageWish wish;
    wish.credit_bytes = 1u << 30;
    CameraView& view = wish.views.emplace_back();
    for (const double x : {32.0, 40.0, 120.0}) view.camera.add_eye(x);
    for (const double x : {32.0, 32.0, 32.0}) view.camera.add_target(x);
    view.width = view.height = 512;
    view.channels = {0, 1};
    std::vector<std::vector<Arrival>> both;
    for (BrickSource* source : {remote.get(), static_cast<BrickSource*>(local.get())}) {
        ASSERT_TRUE(source->openFrame(7));
        ASSERT_TRUE(source->wish(wish));
        both.push_back(takeAll(*source));
    }
    ASSERT_EQ(both[0].size(), both[1].size());
    EXPECT_GT(both[0].size(), 20u);
    for (std::size_t i = 0; i < both[0].size(); ++i)
        EXPECT_EQ(both[0][i].page.address, both[1][i].page.address);
    wish.views[0].camera.clear_eye();
    EXPECT_EQ(remote->wish(wish).error().code, ErrorCode::kInvalid);
    EXPECT_TRUE(remote->openFrame(30)) << "a camera that cannot be must not cost the connection";
}

TEST_F(RemoteSourceTest, NeverHoldsMoreThanItsCreditWhileNobodyTakes) {
    auto source = connect();
    ASSERT_TRUE(source->openFrame(30));
    for (int i = 0; i < 50; ++i) {
        ASSERT_TRUE(source->wish(listOf(200, 10'240)));
        std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    // What came beyond the newest credit can only be of wishes that were on the way.
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    EXPECT_LE(source->counters().bytes_streamed, 3u * 10'240);
    EXPECT_EQ(takeAll(*source).size() * 1024, source->counters().bytes_streamed);
    EXPECT_TRUE(source->wishDone());
}

TEST_F(RemoteSourceTest, AWishThatIsLongerThanTheLimitIsSentFromItsFront) {
    auto source = connect();
    ASSERT_TRUE(source->openFrame(30));
    ASSERT_TRUE(source->wish(listOf(100'000, 50 * 1024)));
    EXPECT_EQ(takeAll(*source).size(), 50u);
    EXPECT_TRUE(source->wishDone());
}

TEST_F(RemoteSourceTest, GoesFromFrameToFrame) {
    auto source = connect();
    for (int i = 0; i < 20; ++i) {
        ASSERT_TRUE(source->openFrame(i % 2 ? 7 : 30));
        ASSERT_TRUE(source->wish(listOf(50)));
        if (i % 3 == 0) EXPECT_EQ(takeAll(*source).size(), 50u);
    }
    const auto missing = source->openFrame(8);
    ASSERT_FALSE(missing);
    EXPECT_EQ(missing.error().code, ErrorCode::kNotFound);
    EXPECT_THAT(missing.error().message, HasSubstr("7"));
    EXPECT_TRUE(source->openFrame(7));
}

TEST_F(RemoteSourceTest, TakeKeepsItsDeadline) {
    auto source = connect();
    ASSERT_TRUE(source->openFrame(30));
    EXPECT_TRUE(source->wishDone());
    const auto begin = Clock::now();
    EXPECT_TRUE(source->take(begin + std::chrono::seconds(5))->empty());
    EXPECT_LT(Clock::now() - begin, std::chrono::seconds(4)) << "no wish is a wish that is done";
}

TEST_F(RemoteSourceTest, NamesAnUnknownDatasetAndThoseThereAre) {
    const auto source = RemoteSource::open(addressOf(server_->port(), "plume"), "");
    ASSERT_FALSE(source);
    EXPECT_EQ(source.error().code, ErrorCode::kNotFound);
    EXPECT_THAT(source.error().message, HasSubstr("/plume"));
    EXPECT_THAT(source.error().message, HasSubstr("tiny"));
}

TEST_F(RemoteSourceTest, SaysThatItsTokenIsWrong) {
    start({.token = "secret"});
    const auto source = RemoteSource::open(addressOf(server_->port()), "wrong");
    ASSERT_FALSE(source);
    EXPECT_EQ(source.error().code, ErrorCode::kRefused);
    EXPECT_THAT(source.error().message, HasSubstr("token"));
    EXPECT_TRUE(RemoteSource::open(addressOf(server_->port()), "secret"));
}

TEST_F(RemoteSourceTest, TellsWhenTheServerStops) {
    StreamTimeouts timeouts;
    timeouts.reconnect = std::chrono::milliseconds(0);
    auto source = std::move(*RemoteSource::open(addressOf(server_->port()), "", timeouts));
    ASSERT_TRUE(source->openFrame(30));
    server_->stop();
    const auto wished = source->openFrame(7);
    ASSERT_FALSE(wished);
    EXPECT_THAT(wished.error().message, HasSubstr("127.0.0.1:" + std::to_string(server_->port()) + "/tiny"));
}

TEST(RemoteSource, SaysThatNobodyListens) {
    std::uint16_t free_port = 0;
    {
        free_port = FakePeer([](int) {}).port();
    }
    const auto source = RemoteSource::open(addressOf(free_port), "");
    ASSERT_FALSE(source);
    EXPECT_EQ(source.error().code, ErrorCode::kRefused);
    EXPECT_THAT(source.error().message, HasSubstr("127.0.0.1:" + std::to_string(free_port)));
    EXPECT_THAT(source.error().message, HasSubstr("brickyard serve"));
}

TEST(RemoteSource, GivesUpOnAPeerThatSaysNothing) {
    const FakePeer silent(drain);
    StreamTimeouts timeouts;
    timeouts.connect = std::chrono::milliseconds(300);
    const auto source = RemoteSource::open(addressOf(silent.port()), "", timeouts);
    ASSERT_FALSE(source);
    EXPECT_EQ(source.error().code, ErrorCode::kTimeout);
}

TEST(RemoteSource, RefusesAPeerThatIsNoServerOfOurs) {
    const FakePeer web([](int connection) {
        const std::string reply = "HTTP/1.1 200 OK\r\nContent-Length: 3\r\n\r\nhi\n";
        ::send(connection, reply.data(), reply.size(), MSG_NOSIGNAL);
        drain(connection);
    });
    EXPECT_THAT(RemoteSource::open(addressOf(web.port()), "").error().message, HasSubstr("200"));
    const FakePeer ssh([](int connection) {
        ::send(connection, "SSH-2.0-x\r\n", 11, MSG_NOSIGNAL);
        drain(connection);
    });
    EXPECT_THAT(RemoteSource::open(addressOf(ssh.port()), "").error().message,
                HasSubstr("not a Brickyard stream"));
    const FakePeer gone([](int) {});
    EXPECT_FALSE(RemoteSource::open(addressOf(gone.port()), ""));
}

}  // namespace
}  // namespace brickyard

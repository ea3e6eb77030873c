// The stream, over real sockets: what a client sees, and what a hostile one may do.
#include <fmt/format.h>
#include <gmock/gmock.h>

#include <atomic>
#include <set>
#include <thread>

#include "core/stream_frame.h"
#include "raw_socket.h"
#include "server/server.h"
#include "stream_client.h"
#include "tiny_dataset.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

class StreamTest : public testing::Test {
protected:
    void SetUp() override { start({}); }

    void start(ServerOptions options) {
        server_.reset();
        options.port = 0;
        auto catalog = Catalog::open({tiny_.folder()}, 8, 1u << 20);
        ASSERT_TRUE(catalog) << catalog.error().message;
        auto server = Server::start(std::move(*catalog), options);
        ASSERT_TRUE(server) << server.error().message;
        server_ = std::move(*server);
    }
    std::unique_ptr<StreamClient> connect(const std::string& path = "tiny") {
        return std::make_unique<StreamClient>(server_->port(), path);
    }
    std::unique_ptr<StreamClient> establish() {
        auto client = connect();
        client->hello();
        const auto welcome = client->open("tiny");
        EXPECT_TRUE(welcome && welcome->header.has_welcome());
        return client;
    }
    static StreamHeader wishOf(std::uint64_t epoch, std::uint64_t credit) {
        StreamHeader header;
        Wish& wish = *header.mutable_wish();
        wish.set_epoch(epoch);
        wish.set_dataset_id(1);
        wish.set_frame(30);
        wish.set_credit_bytes(credit);
        return header;
    }
    static void addPage(StreamHeader& header, const PageAddress& page) {
        PageRef& ref = *header.mutable_wish()->add_pages();
        ref.set_channel(page.channel);
        ref.set_block(page.block);
        ref.set_node(page.node);
    }
    bool isHealthy() { return request(server_->port(), "GET", "/healthz").status == 200; }
    static std::string textOf(const StreamHeader& header) {
        const auto bytes = encodeStreamHead(header);
        return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
    }

    TinyDataset tiny_{"tiny", {.levels = 4, .payload_bytes = 4096}};
    std::unique_ptr<Server> server_;
};

TEST_F(StreamTest, GoesFromHelloToPages) {
    auto client = connect();
    client->hello();
    const auto welcome = client->open("tiny");
    ASSERT_TRUE(welcome);
    EXPECT_EQ(welcome->header.welcome().manifest().frames(0).frame(), 30u);
    const auto opened = client->openFrame(1, 30);
    ASSERT_TRUE(opened);
    EXPECT_EQ(opened->header.frame_opened().footer().channels(0).name(), "density");

    const auto bricks = tiny_.bricks(0);
    StreamHeader wish = wishOf(1, 1u << 20);
    wish.mutable_wish()->add_blocks();
    for (std::size_t i = 0; i < 20; ++i) addPage(wish, bricks[i]);
    client->send(wish);
    const auto block = client->receive();
    ASSERT_TRUE(block && block->header.has_block_page());
    EXPECT_EQ(block->payload, tiny_.store()->readBlock(0, 0).value());
    for (std::size_t i = 0; i < 20; ++i) {
        const auto page = client->receive();
        ASSERT_TRUE(page && page->header.has_page());
        EXPECT_EQ(page->header.page().ref().node(), bricks[i].node);
        EXPECT_EQ(page->payload, tiny_.payload(bricks[i]));
    }
    EXPECT_EQ(client->receive()->header.wish_done().epoch(), 1u);
}

TEST_F(StreamTest, ServesAnyPathOfOneName) {
    for (const char* path : {"/v1/stream", "/", "/tiny", "/elsewhere"}) {
        RawSocket socket(server_->port());
        socket.send(upgradeRequest(path));
        EXPECT_THAT(socket.receiveUntil("\r\n\r\n"), HasSubstr("101 Switching")) << path;
    }
    RawSocket socket(server_->port());
    socket.send(upgradeRequest("/a/b"));
    EXPECT_THAT(socket.receiveUntil("\r\n\r\n"), HasSubstr("404"));
}

TEST_F(StreamTest, RefusesTheWebPageOfAnotherOrigin) {
    RawSocket foreign(server_->port()), own(server_->port());
    foreign.send(upgradeRequest("/tiny", "Origin: http://elsewhere.example\r\n"));
    EXPECT_THAT(foreign.receiveUntil("\r\n\r\n"), HasSubstr("403"));
    own.send(upgradeRequest("/tiny", "Origin: http://localhost\r\n"));
    EXPECT_THAT(own.receiveUntil("\r\n\r\n"), HasSubstr("101"));
}

TEST_F(StreamTest, ClosesAfterAWrongVersion) {
    auto client = connect();
    client->hello(9);
    const auto failed = client->receive();
    ASSERT_TRUE(failed);
    EXPECT_EQ(failed->header.failed().reason(), Failed::REASON_VERSION);
    EXPECT_TRUE(client->isLost());
}

TEST_F(StreamTest, ClosesAfterAWrongToken) {
    start({.token = "secret"});
    auto client = connect();
    client->hello(1, "wrong");
    EXPECT_EQ(client->receive()->header.failed().reason(), Failed::REASON_TOKEN);
    EXPECT_TRUE(client->isLost());
    auto trusted = connect();
    trusted->hello(1, "secret");
    EXPECT_TRUE(trusted->open("tiny")->header.has_welcome());
}

TEST_F(StreamTest, SaysThatADatasetOrAFrameOrAPageIsUnknownAndGoesOn) {
    auto client = connect();
    client->hello();
    EXPECT_EQ(client->open("none")->header.failed().reason(), Failed::REASON_NO_DATASET);
    EXPECT_TRUE(client->open("tiny")->header.has_welcome());
    EXPECT_EQ(client->openFrame(1, 5)->header.failed().reason(), Failed::REASON_NO_FRAME);
    StreamHeader wish = wishOf(1, 1u << 20);
    addPage(wish, {0, 0, 123456});
    client->send(wish);
    const auto failed = client->receive();
    EXPECT_EQ(failed->header.failed().reason(), Failed::REASON_NO_PAGE);
    EXPECT_EQ(failed->header.failed().page().node(), 123456u);
    EXPECT_TRUE(client->receive()->header.has_wish_done());
}

TEST_F(StreamTest, ACameraBringsItsViewCoarseToFine) {
    auto client = establish();
    StreamHeader wish = wishOf(1, 64u << 20);
    CameraWish& seen = *wish.mutable_wish()->mutable_camera();
    for (const double x : {32.0, 32.0, 200.0}) seen.mutable_camera()->add_eye(x);
    for (const double x : {32.0, 32.0, 32.0}) seen.mutable_camera()->add_target(x);
    seen.set_width(8192);
    seen.set_height(8192);
    seen.add_channels(0);
    client->send(wish);
    std::set<std::pair<std::uint32_t, std::uint32_t>> bricks;
    std::set<std::uint32_t> blocks;
    for (;;) {
        const auto message = client->receive();
        ASSERT_TRUE(message);
        if (message->header.has_wish_done()) break;
        if (message->header.has_block_page()) {
            blocks.insert(message->header.block_page().block());
        } else {
            ASSERT_TRUE(message->header.has_page());
            const PageRef& ref = message->header.page().ref();
            EXPECT_EQ(ref.channel(), 0u) << "a channel that nobody asked for";
            EXPECT_TRUE(blocks.contains(ref.block())) << "a brick came before its block";
            bricks.insert({ref.block(), ref.node()});
        }
    }
    EXPECT_EQ(bricks.size(), tiny_.bricks(0).size());
}

TEST_F(StreamTest, StopsSendingAnOlderWishWhenANewOneArrives) {
    // More than the sockets hold, so that the server cannot have sent it all before the second wish comes.
    const auto bricks = tiny_.bricks(0);
    StreamHeader first = wishOf(1, 4ull << 30);
    for (std::size_t i = 0; i < 60'000; ++i) addPage(first, bricks[i % bricks.size()]);
    StreamHeader second = wishOf(2, 1u << 20);
    addPage(second, bricks[0]);

    auto client = establish();
    client->pause();
    client->send(first);
    ASSERT_TRUE(client->receive());
    client->send(second);
    client->resume();
    std::size_t old_pages = 0;
    bool is_new = false;
    for (;;) {
        const auto message = client->receive();
        ASSERT_TRUE(message);
        if (message->header.has_wish_done()) {
            EXPECT_EQ(message->header.wish_done().epoch(), 2u);
            break;
        }
        is_new = is_new || message->header.page().epoch() == 2;
        EXPECT_EQ(message->header.page().epoch(), is_new ? 2u : 1u) << "an older page after a newer one";
        old_pages += message->header.page().epoch() == 1;
    }
    EXPECT_LT(old_pages, 59'000u) << "the older wish was served to its end";
}

TEST_F(StreamTest, SaysWhatIsWrongWithGarbageAndCloses) {
    const std::vector<std::vector<std::byte>> garbage{
        {std::byte{1}}, std::vector<std::byte>(100, std::byte{0xff}), std::vector<std::byte>((1u << 20) + 1)};
    for (const auto& bytes : garbage) {
        auto client = establish();
        client->sendBytes(bytes);
        const auto failed = client->receive();
        ASSERT_TRUE(failed) << bytes.size();
        EXPECT_EQ(failed->header.failed().reason(), Failed::REASON_PROTOCOL);
        EXPECT_TRUE(client->isLost());
    }
    EXPECT_TRUE(isHealthy());
}

TEST_F(StreamTest, RefusesATextMessage) {
    RawSocket socket(server_->port());
    socket.send(upgradeRequest("/tiny"));
    socket.receiveUntil("\r\n\r\n");
    socket.send(webSocketFrame("hello", /*opcode=*/1));
    EXPECT_THAT(socket.receiveUntil("text"), HasSubstr("text message"));
}

TEST_F(StreamTest, DropsAFrameThatClaimsToBeEndless) {
    RawSocket socket(server_->port());
    socket.send(upgradeRequest("/tiny"));
    socket.receiveUntil("\r\n\r\n");
    std::string frame = webSocketFrame(std::string(70'000, 'x'));
    for (std::size_t i = 2; i < 10; ++i) frame[i] = char(i == 2 ? 0x7f : 0xff);
    socket.send(frame);
    // Nothing is allocated for the claim; the limit is met after 1 MiB that really came.
    for (int i = 0; i < 20 && socket.send(std::string(100'000, 'x')); ++i) continue;
    EXPECT_TRUE(socket.closes());
    EXPECT_TRUE(isHealthy());
}

TEST_F(StreamTest, SurvivesAConnectionThatIsCutAtAnyByte) {
    StreamHeader hello, open, wish = wishOf(1, 1u << 20);
    hello.mutable_hello()->set_protocol_major(1);
    open.mutable_open()->set_dataset("tiny");
    const auto bricks = tiny_.bricks(0);
    for (std::size_t i = 0; i < 100; ++i) addPage(wish, bricks[i]);
    std::string all = upgradeRequest("/tiny");
    for (const auto& header : {hello, open, wish}) all += webSocketFrame(textOf(header));
    for (std::size_t cut = 0; cut <= all.size(); cut += 7) {
        RawSocket socket(server_->port());
        socket.send(std::string_view(all).substr(0, cut));
    }
    EXPECT_TRUE(isHealthy());
    server_->stop();
}

TEST_F(StreamTest, DropsWhoOpensNoDatasetInTime) {
    start({.handshake_timeout = std::chrono::milliseconds(300)});
    auto client = connect();
    client->hello();
    const auto failed = client->receive();
    ASSERT_TRUE(failed);
    EXPECT_THAT(failed->header.failed().message(), HasSubstr("in time"));
    EXPECT_TRUE(client->isLost());
}

TEST_F(StreamTest, DropsWhoReadsNothing) {
    start({.idle_timeout = std::chrono::milliseconds(500)});
    RawSocket socket(server_->port());
    StreamHeader hello, open, wish = wishOf(1, 4ull << 30);
    hello.mutable_hello()->set_protocol_major(1);
    open.mutable_open()->set_dataset("tiny");
    const auto bricks = tiny_.bricks(0);
    for (std::size_t i = 0; i < 20'000; ++i) addPage(wish, bricks[i % bricks.size()]);
    socket.send(upgradeRequest("/tiny"));
    for (const auto& header : {hello, open, wish}) socket.send(webSocketFrame(textOf(header)));
    std::this_thread::sleep_for(std::chrono::milliseconds(2500));
    EXPECT_TRUE(socket.closes());
}

TEST_F(StreamTest, ServesManyClientsAtOnce) {
    const auto bricks = tiny_.bricks(0);
    const auto payload = tiny_.payload(bricks[3]);
    std::vector<std::thread> threads;
    std::atomic<int> right{0};
    for (int c = 0; c < 16; ++c)
        threads.emplace_back([&] {
            auto client = establish();
            for (std::uint64_t epoch = 1; epoch <= 20; ++epoch) {
                StreamHeader wish = wishOf(epoch, 1u << 20);
                for (int i = 0; i < 10; ++i) addPage(wish, bricks[3]);
                client->send(wish);
                for (int i = 0; i < 10; ++i) {
                    const auto page = client->receive();
                    if (page && page->payload == payload) ++right;
                }
                client->receive();
            }
        });
    for (std::thread& thread : threads) thread.join();
    EXPECT_EQ(right, 16 * 20 * 10);
}

TEST_F(StreamTest, SaysGoodbyeWhenItStops) {
    auto client = establish();
    const auto begin = std::chrono::steady_clock::now();
    server_->stop();
    EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(2));
    EXPECT_TRUE(client->isLost());
}

}  // namespace
}  // namespace brickyard

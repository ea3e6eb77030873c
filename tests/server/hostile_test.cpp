// Clients that are too slow, want too much, or are cut, over real sockets. After each, the server serves as
// before and holds nothing for whoever came.
#include <fmt/format.h>
#include <gmock/gmock.h>

#include <atomic>
#include <fstream>
#include <thread>

#include "core/stream_frame.h"
#include "hostile_fixture.h"
#include "server/batch_pool.h"

namespace brickyard {
namespace {

using testing::AnyOf;
using testing::HasSubstr;
using testing::Not;

constexpr milliseconds kShort{500};

#ifdef __has_feature
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define BRICKYARD_SANITIZED 1
#endif
#endif
#ifndef BRICKYARD_SANITIZED
#define BRICKYARD_SANITIZED 0
#endif

// ---- Too slow

TEST_F(HostileTest, DropsStreamsThatReadAByteAtATime) {
    start({.idle_timeout = seconds(1)});
    std::vector<std::unique_ptr<RawStream>> slow;
    for (int i = 0; i < 8; ++i) {
        slow.push_back(std::make_unique<RawStream>(port(), 4096));
        ASSERT_TRUE(slow.back()->establish());
        slow.back()->send(wishOfPages(1, 60'000));
    }
    std::atomic<bool> over{false};
    std::thread reader([&] {
        while (!over) {
            for (auto& stream : slow) stream->socket().receiveNow(1);
            std::this_thread::sleep_for(milliseconds(100));
        }
    });
    expectServed();
    EXPECT_TRUE(streamsEnd());
    over = true;
    reader.join();
}

TEST_F(HostileTest, DropsRequestsThatAreReadAByteAtATime) {
    start({.idle_timeout = seconds(1)});
    const std::string request =
        fmt::format("GET /v1/datasets/tiny/frames/30/channels/0/pages/0/{} HTTP/1.1\r\nHost: a\r\n\r\n",
                    bricks_->front().node);
    std::string many;
    for (int i = 0; i < 5000; ++i) many += request;
    RawSocket slow(port(), 4096);
    std::thread sender([&] { slow.send(many); });
    expectServed();
    EXPECT_TRUE(comesTrue([&] {
        slow.receiveNow(1);
        return live_->metric(R"(brickyard_connections{kind="http"})") == 1;
    }));
    sender.join();
}

TEST_F(HostileTest, DropsRequestsThatComeAByteAtATime) {
    start({.handshake_timeout = kShort});
    RawSocket slow(port());
    const auto begin = Clock::now();
    const std::string request = "GET /healthz HTTP/1.1\r\nHost: a\r\nX: " + std::string(2000, 'x');
    std::size_t sent = 0;
    while (sent < request.size() && slow.send(request.substr(sent, 1))) {
        ++sent;
        std::this_thread::sleep_for(milliseconds(10));
        if (sent == 20) expectServed();
    }
    EXPECT_LT(sent, request.size());
    EXPECT_LT(Clock::now() - begin, seconds(10));
}

TEST_F(HostileTest, DropsMessagesThatComeAByteAtATime) {
    start({.handshake_timeout = kShort});
    for (const bool established : {false, true}) {
        RawStream slow(port());
        if (established) ASSERT_TRUE(slow.establish());
        StreamHeader hello;
        hello.mutable_hello()->set_client(std::string(250, 'x'));
        const std::string frame = webSocketFrame(textOf(established ? wishOfPages(1, 2000) : hello));
        std::size_t sent = 0;
        const auto begin = Clock::now();
        while (sent < frame.size() && Clock::now() - begin < seconds(10) &&
               slow.socket().send(frame.substr(sent, 1))) {
            ++sent;
            std::this_thread::sleep_for(milliseconds(10));
        }
        EXPECT_LT(sent, frame.size()) << established;
        EXPECT_LT(Clock::now() - begin, seconds(10)) << established;
    }
}

TEST_F(HostileTest, DropsWhoConnectsAndSaysNothing) {
    start({.handshake_timeout = kShort});
    std::vector<std::unique_ptr<RawSocket>> silent;
    for (int i = 0; i < 50; ++i) silent.push_back(std::make_unique<RawSocket>(port()));
    for (int i = 0; i < 50; ++i)
        silent[std::size_t(i)]->send(std::string_view("GET / HTTP/1.1\r\n").substr(0, std::size_t(i) % 16));
    expectServed();
    for (auto& socket : silent) EXPECT_TRUE(socket->closes());
}

TEST_F(HostileTest, LetsGoOfWhoEndsAtOnce) {
    for (int i = 0; i < 100; ++i) {
        RawSocket ended(port());
        ended.endSending();
        RawSocket cut(port());
        if (i % 2 == 0) cut.send("GET /healthz HTTP/1.1\r\n\r\n");
        cut.reset();
    }
    expectServed();
}

TEST_F(HostileTest, AnswersTlsInTheClearWithoutHarm) {
    RawSocket socket(port());
    socket.send(std::string("\x16\x03\x01\x00\x05\x01\x00\x00\x01\x00", 10) + std::string(500, '\0'));
    EXPECT_THAT(socket.receiveAll(), AnyOf("", HasSubstr("400 Bad Request")));
}

// ---- Too much

// Of one client who does what he can. A sanitizer keeps what was freed.
constexpr std::size_t kMostMemory = std::size_t(BRICKYARD_SANITIZED ? 1024 : 128) << 20;

std::size_t residentBytes() {
    std::ifstream in("/proc/self/statm");
    std::size_t size = 0, resident = 0;
    in >> size >> resident;
    return resident * 4096;
}

TEST_F(HostileTest, AnswersTheLastOfTenThousandWishes) {
    constexpr std::uint64_t kWishes = 10'000;
    RawStream flood(port());
    ASSERT_TRUE(flood.establish());
    const std::size_t before = residentBytes();
    std::size_t most = 0;
    std::thread sender([&] {
        for (std::uint64_t epoch = 1; epoch <= kWishes; ++epoch)
            if (!flood.send(wishOfPages(epoch, epoch == kWishes ? 3 : 100))) break;
    });
    std::uint64_t epoch = 0;
    bool served = false;
    for (;;) {
        const auto message = flood.receive();
        ASSERT_TRUE(message) << "after epoch " << epoch;
        most = std::max(most, residentBytes());
        if (message->header.has_page()) {
            EXPECT_GE(message->header.page().epoch(), epoch) << "a page of an older wish after a newer one's";
            epoch = message->header.page().epoch();
        }
        if (!served) expectServed();
        served = true;
        if (message->header.has_wish_done() && message->header.wish_done().epoch() == kWishes) {
            EXPECT_EQ(message->header.wish_done().sent_bytes(), 3 * 4096u);
            break;
        }
    }
    sender.join();
    EXPECT_LT(most, before + kMostMemory);
}

// Messages that wait for a worker are memory, too.
TEST_F(HostileTest, HoldsLittleOfWhatManySayAtOnce) {
    start({.disk_threads = 1});
    StreamHeader wish = wishMessage(1, 0);
    for (int i = 0; i < 50'000; ++i) addPage(wish, {0x10000000, 0x10000000, 0x10000000});
    const std::string frame = webSocketFrame(textOf(wish));
    ASSERT_GT(frame.size(), 900'000u);
    const std::size_t before = residentBytes();
    std::atomic<std::size_t> most{0};
    std::vector<std::thread> clients;
    for (int c = 0; c < 24; ++c)
        clients.emplace_back([&] {
            RawStream client(port());
            if (!client.establish()) return;
            for (int i = 0; i < 12 && client.socket().send(frame); ++i)
                most = std::max(most.load(), residentBytes());
        });
    for (std::thread& client : clients) client.join();
    EXPECT_LT(most.load(), before + kMostMemory);
}

// An answer is owed for each, and nobody reads it.
TEST_F(HostileTest, DropsFloodsOfQuestionsWhoseAnswersNobodyReads) {
    start({.idle_timeout = seconds(1)});
    StreamHeader ping;
    ping.mutable_ping()->set_number(1);
    const std::string kinds[] = {webSocketFrame(textOf(ping)), webSocketFrame("are you there", /*opcode=*/9),
                                 webSocketFrame(textOf(openFrameMessage(1, 30))),
                                 webSocketFrame(textOf(openMessage("tiny"))),
                                 webSocketFrame(textOf(openMessage("none")))};
    for (const std::string& kind : kinds) {
        RawStream flood(port(), 4096);
        ASSERT_TRUE(flood.establish());
        std::string many;
        while (many.size() < 60'000) many += kind;
        const std::size_t before = residentBytes();
        bool ended = false;
        for (int i = 0; i < 300 && !ended; ++i) ended = !flood.socket().send(many);
        EXPECT_TRUE(ended) << "18 MB of questions were taken, and no answer was read";
        EXPECT_LT(residentBytes(), before + kMostMemory);
        expectServed();
        EXPECT_TRUE(streamsEnd());
    }
}

TEST_F(HostileTest, AnswersEveryQuestionOfAFloodThatIsRead) {
    RawStream flood(port());
    ASSERT_TRUE(flood.establish());
    constexpr int kQuestions = 2000;
    std::thread sender([&] {
        StreamHeader ping;
        for (std::uint64_t i = 0; i < kQuestions; ++i) {
            ping.mutable_ping()->set_number(i);
            flood.send(i % 2 == 0 ? ping : openFrameMessage(1, 30));
        }
    });
    for (std::uint64_t i = 0; i < kQuestions; ++i) {
        const auto answer = flood.receive();
        ASSERT_TRUE(answer) << i;
        if (i % 2 == 0)
            EXPECT_EQ(answer->header.pong().number(), i);
        else
            EXPECT_TRUE(answer->header.has_frame_opened());
    }
    sender.join();
}

// Each of these once brought a session down with work still under way.
TEST_F(HostileTest, SurvivesStreamsThatAreCutWhileTheyAreAnswered) {
    for (int i = 0; i < 200; ++i) {
        RawStream cut(port(), 4096);
        ASSERT_TRUE(cut.establish());
        std::string all;
        for (int n = 0; n < 20; ++n) all += webSocketFrame("ping", /*opcode=*/9);
        if (i % 2 == 0) all += webSocketFrame(textOf(wishOfPages(1, 300)));
        if (i % 3 == 0) all += webSocketFrame(std::string("\x03\xe8", 2), /*opcode=*/8);
        for (int n = 0; n < 20; ++n) all += webSocketFrame("ping", /*opcode=*/9);
        cut.socket().send(all);
        if (i % 4 == 0) std::this_thread::sleep_for(milliseconds(2));
        cut.socket().reset();
    }
    expectServed();
}

TEST_F(HostileTest, StopsWhileManyWaitForMemory) {
    start({.queue_bytes = 2 * kBatchBytes, .drain_timeout = milliseconds(100)});
    std::vector<std::unique_ptr<RawStream>> slow;
    for (int i = 0; i < 20; ++i) {
        slow.push_back(std::make_unique<RawStream>(port(), 4096));
        ASSERT_TRUE(slow.back()->establish());
    }
    for (auto& stream : slow) stream->send(wishOfPages(1, 20'000));
    ASSERT_TRUE(comesTrue([&] { return live_->metric("brickyard_queued_bytes") == 2 * kBatchBytes; }));
    std::this_thread::sleep_for(milliseconds(100));
    live_.reset();
}

TEST_F(HostileTest, ServesWhoIsLeftAfterOthersThatWaitedForMemoryAreGone) {
    start({.queue_bytes = 2 * kBatchBytes});
    std::vector<std::unique_ptr<RawStream>> slow;
    for (int i = 0; i < 12; ++i) {
        slow.push_back(std::make_unique<RawStream>(port(), 4096));
        ASSERT_TRUE(slow.back()->establish());
    }
    for (auto& stream : slow) stream->send(wishOfPages(1, 20'000));
    ASSERT_TRUE(comesTrue([&] { return live_->metric("brickyard_queued_bytes") == 2 * kBatchBytes; }));
    RawStream patient(port());
    patient.hello();
    patient.send(openMessage("tiny"));
    std::this_thread::sleep_for(milliseconds(200));
    for (auto& stream : slow) stream->socket().reset();
    const auto welcome = patient.receive();
    EXPECT_TRUE(welcome && welcome->header.has_welcome());
}

// ---- Cut

TEST_F(HostileTest, SurvivesHttpThatIsCutAtAnyByte) {
    const std::string all =
        "GET /v1/datasets HTTP/1.1\r\nHost: a\r\n\r\nHEAD /healthz HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc"
        "POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n3\r\nabc\r\n0\r\n\r\n";
    for (std::size_t cut = 0; cut <= all.size(); ++cut) {
        RawSocket socket(port());
        socket.send(std::string_view(all).substr(0, cut));
        if (cut % 2 == 0) socket.reset();
    }
}

TEST_F(HostileTest, SurvivesAStreamThatIsCutAtAnyByte) {
    std::string all;
    StreamHeader hello;
    hello.mutable_hello()->set_protocol_major(1);
    for (const auto& header : {hello, openMessage("tiny"), openFrameMessage(1, 30), wishOfPages(1, 10)})
        all += webSocketFrame(textOf(header));
    all += webSocketFrame("ping", /*opcode=*/9) + webSocketFrame(std::string("\x03\xe8", 2), /*opcode=*/8);
    for (std::size_t cut = 0; cut <= all.size(); ++cut) {
        RawStream stream(port());
        stream.socket().send(std::string_view(all).substr(0, cut));
        if (cut % 2 == 0) stream.socket().reset();
    }
}

}  // namespace
}  // namespace brickyard

// What is neither WebSocket, HTTP nor the stream, and names that lead elsewhere, over real sockets. After
// each, the server serves as before and holds nothing for whoever came.
#include <fmt/format.h>
#include <gmock/gmock.h>

#include <thread>

#include "hostile_fixture.h"
#include "server/conversation.h"

namespace brickyard {
namespace {

using testing::AnyOf;
using testing::HasSubstr;
using testing::Not;

using MalformedTest = HostileTest;

// ---- Not WebSocket

TEST_F(MalformedTest, EndsStreamsThatBreakTheProtocolOfWebSocket) {
    start({.drain_timeout = milliseconds(300)});
    using namespace std::string_literals;
    const std::string mask(4, '\0');
    const std::pair<const char*, std::string> broken[] = {
        {"a ping of 126 bytes", "\x89\xfe\x00\x7e"s + mask + std::string(126, 'x')},
        {"a ping in fragments", "\x09\x81"s + mask + "x"},
        {"a close in fragments", "\x08\x80"s + mask},
        {"the first reserved bit", "\xc2\x81"s + mask + "x"},
        {"the second reserved bit", "\xa2\x81"s + mask + "x"},
        {"the third reserved bit", "\x92\x81"s + mask + "x"},
        {"a reserved kind of message", "\x83\x81"s + mask + "x"},
        {"a reserved kind of control frame", "\x8b\x81"s + mask + "x"},
        {"a frame without a mask", "\x82\x01x"s},
        {"a ping without a mask", "\x89\x00"s},
        {"a continuation of nothing", "\x80\x81"s + mask + "x"},
        {"a message within another", "\x02\x81"s + mask + "x" + "\x82\x81" + mask + "x"},
        {"a length over 2^63", "\x82\xff\x80\x00\x00\x00\x00\x00\x00\x01"s + mask + "x"},
        {"a length in more bytes than it needs", "\x82\xfe\x00\x01"s + mask + "x"},
        {"a close of one byte", "\x88\x81"s + mask + "x"},
        {"a close with no code there is", "\x88\x82"s + mask + "\x00\x01"s},
        {"a text message", "\x81\x85"s + mask + "hello"},
        {"an empty message", "\x82\x80"s + mask},
        {"a message of one byte", "\x82\x81"s + mask + "x"},
        {"a message over 1 MiB", webSocketFrame(std::string((1u << 20) + 1, 'x'))},
        {"HTTP", "GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n"},
    };
    for (const auto& [what, bytes] : broken) {
        RawStream stream(port());
        ASSERT_TRUE(stream.establish());
        stream.socket().send(bytes);
        EXPECT_TRUE(stream.socket().closes()) << what;
    }
    // A huge claim is met with patience until that many bytes really come.
    RawStream claim(port());
    ASSERT_TRUE(claim.establish());
    claim.socket().send("\x82\xff\x7f\xff\xff\xff\xff\xff\xff\xff"s + mask + std::string(100, 'x'));
    expectServed();
    for (int i = 0; i < 20 && claim.socket().send(std::string(100'000, 'x')); ++i) continue;
    EXPECT_TRUE(claim.socket().closes());
}

TEST_F(MalformedTest, TakesFragmentsAndPingsBetweenThem) {
    RawStream stream(port());
    ASSERT_TRUE(stream.establish());
    StreamHeader ping;
    ping.mutable_ping()->set_number(77);
    const std::string text = textOf(ping);
    const std::string mask(4, '\0');
    std::string frames;
    for (std::size_t i = 0; i < text.size(); ++i) {
        frames += char((i + 1 == text.size() ? 0x80 : 0) | (i == 0 ? 2 : 0));
        frames += char(0x81);
        frames += mask + text[i];
        if (i + 1 < text.size()) frames += webSocketFrame("between", /*opcode=*/9);
    }
    stream.socket().send(frames);
    const auto pong = stream.receive();
    ASSERT_TRUE(pong);
    EXPECT_EQ(pong->header.pong().number(), 77u);
}

TEST_F(MalformedTest, TakesAWishAtEachLimitAndEndsTheStreamOverIt) {
    const auto pages = [](Wish& wish, int n) {
        for (int i = 0; i < kMaxWishPages + n; ++i) wish.add_pages();
    };
    const auto blocks = [](Wish& wish, int n) {
        for (int i = 0; i < kMaxWishBlocks + n; ++i) wish.add_blocks();
    };
    const auto names = [](Wish& wish, int n) {
        wish.mutable_camera()->set_width(1);
        wish.mutable_camera()->set_height(1);
        for (int i = 0; i < kMaxWishChannels + n; ++i) wish.mutable_camera()->add_channel_names("none");
    };
    const auto name = [](Wish& wish, int n) {
        wish.mutable_camera()->set_width(1);
        wish.mutable_camera()->set_height(1);
        wish.mutable_camera()->add_channel_names(std::string(std::size_t(kMaxChannelNameBytes + n), 'x'));
    };
    const std::function<void(Wish&, int)> changes[] = {pages, blocks, names, name};
    for (const auto& change : changes)
        for (const int over : {0, 1}) {
            RawStream stream(port());
            ASSERT_TRUE(stream.establish());
            StreamHeader wish = wishMessage(1, 0);
            change(*wish.mutable_wish(), over);
            stream.send(wish);
            const auto answer = stream.receive();
            ASSERT_TRUE(answer);
            if (over == 0) {
                EXPECT_TRUE(answer->header.has_wish_done()) << answer->header.ShortDebugString();
                continue;
            }
            EXPECT_EQ(answer->header.failed().reason(), Failed::REASON_PROTOCOL);
            EXPECT_FALSE(stream.receive());
            EXPECT_EQ(stream.closeCode(), 1008);
        }
}

TEST_F(MalformedTest, SaysWhichPagesThereAreNot) {
    RawStream stream(port());
    ASSERT_TRUE(stream.establish());
    StreamHeader wish = wishMessage(1, 4ull << 30);
    constexpr std::uint32_t kHuge = 0xffffffff;
    const PageAddress none[] = {
        {kHuge, 0, 0}, {0, kHuge, 0}, {0, 0, kHuge}, {kHuge, kHuge, kHuge}, {2, 0, 0}};
    for (int i = 0; i < 1000; ++i)
        for (const PageAddress& page : none) addPage(wish, page);
    wish.mutable_wish()->mutable_pages(0)->set_draft(true);
    wish.mutable_wish()->add_blocks()->set_block(kHuge);
    stream.send(wish);
    for (int i = 0; i < 5001; ++i) {
        const auto failed = stream.receive();
        ASSERT_TRUE(failed) << i;
        ASSERT_EQ(failed->header.failed().reason(), Failed::REASON_NO_PAGE);
    }
    EXPECT_TRUE(stream.receive()->header.has_wish_done());
}

TEST_F(MalformedTest, RefusesGarbageInsteadOfHello) {
    const std::string garbage[] = {"",
                                   "x",
                                   std::string(4, '\0'),
                                   std::string(4, '\xff'),
                                   std::string(5000, 'g'),
                                   std::string("\x02\x00\x00\x00\x0a\x00", 6),
                                   textOf(wishOfPages(1, 1))};
    for (const std::string& bytes : garbage) {
        RawStream stream(port());
        stream.sendFrame(bytes);
        const auto failed = stream.receive();
        ASSERT_TRUE(failed) << bytes.size();
        EXPECT_THAT(failed->header.failed().reason(), AnyOf(Failed::REASON_PROTOCOL, Failed::REASON_VERSION));
        EXPECT_FALSE(stream.receive());
    }
}

// ---- Not HTTP

TEST_F(MalformedTest, AnswersAThousandRequestsInOrder) {
    std::string all;
    for (int i = 0; i < 1000; ++i) {
        // Some from memory, some from a worker.
        const std::string target = i % 3 == 0 ? "/healthz"
                                   : i % 3 == 1
                                       ? "/v1/datasets"
                                       : fmt::format("/v1/datasets/tiny/frames/30/channels/0/pages/0/{}",
                                                     (*bricks_)[std::size_t(i) % 60].node);
        all += fmt::format("GET {} HTTP/1.1\r\nHost: a\r\nX-Request-Id: r{}\r\n{}\r\n", target, i,
                           i == 999 ? "Connection: close\r\n" : "");
    }
    RawSocket socket(port());
    std::thread sender([&] { EXPECT_TRUE(socket.send(all)); });
    const std::string answers = socket.receiveAll();
    sender.join();
    std::size_t at = 0;
    for (int i = 0; i < 1000; ++i) {
        ASSERT_EQ(answers.substr(at, 15), "HTTP/1.1 200 OK") << i;
        const std::string head = answers.substr(at, answers.find("\r\n\r\n", at) + 4 - at);
        ASSERT_THAT(head, HasSubstr(fmt::format("X-Request-Id: r{}\r\n", i)));
        const auto length = head.find("Content-Length: ");
        ASSERT_NE(length, std::string::npos);
        at += head.size() + std::size_t(std::atoll(head.c_str() + length + 16));
    }
    EXPECT_EQ(at, answers.size());
}

TEST_F(MalformedTest, AnswersRequestsWhoseBodyComesWithThem) {
    const std::string head = "GET /healthz HTTP/1.1\r\nHost: a\r\n";
    for (const std::string& body :
         {std::string("Content-Length: 5\r\n\r\nhello"),
          std::string("Transfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n0\r\n\r\n")}) {
        RawSocket socket(port());
        socket.send(head + body + head + body + head + "Connection: close\r\n\r\n");
        const std::string answers = socket.receiveAll();
        std::size_t count = 0;
        for (auto at = answers.find("200 OK"); at != std::string::npos; at = answers.find("200 OK", at + 1))
            ++count;
        EXPECT_EQ(count, 3u) << answers;
    }
}

TEST_F(MalformedTest, RefusesRequestsThatAreTooLongOrMeanTwoThings) {
    const std::string begin = "GET /healthz HTTP/1.1\r\nHost: a\r\n";
    std::string many;
    for (int i = 0; i < 20'000; ++i) many += "A: b\r\n";
    const std::pair<std::string, int> requests[] = {
        {begin + many + "\r\n", 431},
        {begin + "X: " + std::string(100'000, 'x') + "\r\n\r\n", 431},
        {begin + std::string(100'000, 'x'), 431},
        {"GET /" + std::string(100'000, 'x') + " HTTP/1.1\r\n\r\n", 431},
        {begin + "Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400},
        {begin + "Transfer-Encoding: chunked\r\nContent-Length: 5\r\n\r\n0\r\n\r\n", 400},
        {begin + "Content-Length: 5\r\nContent-Length: 6\r\n\r\nhello!", 400},
        {begin + "Content-Length: -1\r\n\r\n", 400},
        {begin + "Content-Length: 18446744073709551616\r\n\r\n", 400},
        {begin + "Transfer-Encoding: chunked\r\n\r\nzz\r\n\r\n", 400},
        {begin + "Transfer-Encoding: chunked\r\n\r\nfffffffffffffffff\r\nx", 400},
        {begin + "Transfer-Encoding: chunked\r\n\r\n100000\r\n" + std::string(0x10000, 'x'), 413},
        {begin + "Content-Length: 2000\r\n\r\n" + std::string(2000, 'x'), 413},
        {begin + "No colon\r\n\r\n", 400},
        {begin + std::string("X: a\0b\r\n\r\n", 10), 400},
        {"GET /healthz HTTP/9.9\r\n\r\n", 400},
        {"GET /healthz\r\n\r\n", 400},
        {"\r\n\r\n\r\n\x01\x02\x03\r\n", 400},
    };
    for (const auto& [text, status] : requests) {
        RawSocket socket(port());
        std::thread sender([&] { socket.send(text); });
        const std::string answer = socket.receiveAll();
        sender.join();
        // Where much more comes than is read, the reset may overtake the answer.
        if (answer.empty() && text.size() > 50'000) continue;
        EXPECT_THAT(answer, HasSubstr(fmt::format("HTTP/1.1 {} ", status))) << text.substr(0, 100);
        EXPECT_THAT(answer, Not(HasSubstr("200 OK")))
            << "a second request was seen in: " << text.substr(0, 100);
    }
}

TEST_F(MalformedTest, ServesNothingFromOutside) {
    const std::string up[] = {"..%2f..%2f..%2f..%2f..%2fetc%2fpasswd",
                              "../../../../../etc/passwd",
                              "%2e%2e",
                              "..",
                              ".",
                              "%2e%2e/%2e%2e/etc/passwd",
                              "%2fetc%2fpasswd",
                              "/etc/passwd",
                              "..\\..\\..\\etc\\passwd",
                              "..%5c..%5cetc%5cpasswd",
                              "tiny%00",
                              "tiny%00.bricks",
                              "tiny.bricks",
                              "tiny/manifest.json",
                              "tiny/../tiny",
                              "tiny/./frames/30",
                              "tiny%2fframes",
                              "%252e%252e",
                              "%c0%ae%c0%ae%c0%af",
                              "tiny/frames/..%2f..%2fmanifest.json",
                              "tiny/frames/30/../../manifest.json",
                              "tiny/frames/30/channels/0/blocks/..%2f0",
                              "file:///etc/passwd",
                              "http://localhost/etc/passwd",
                              "~root",
                              "tiny ",
                              "%20tiny",
                              "TINY",
                              "tiny%0d%0aX: y",
                              "tiny/frames/30%20",
                              "tiny/frames/+30",
                              "tiny/frames/0x1e"};
    for (const std::string& name : up) {
        const auto reply = live_->get("/v1/datasets/" + name);
        EXPECT_THAT(reply.status, AnyOf(400, 404)) << name;
        EXPECT_THAT(reply.body, Not(HasSubstr("root:"))) << name;
        EXPECT_THAT(reply.body, Not(HasSubstr("format_major"))) << name;
        EXPECT_THAT(reply.head, Not(HasSubstr("X: y"))) << name;
        RawStream stream(port());
        stream.hello();
        stream.send(openMessage(name));
        const auto failed = stream.receive();
        ASSERT_TRUE(failed) << name;
        EXPECT_EQ(failed->header.failed().reason(), Failed::REASON_NO_DATASET) << name;
    }
    for (const char* target :
         {"/etc/passwd", "/../../etc/passwd", "*", "http://localhost/etc/passwd", "//etc/passwd",
          "/v1/../etc/passwd", "/v1/datasets/../../etc/passwd", "etc/passwd"})
        EXPECT_THAT(live_->get(target).status, AnyOf(400, 404)) << target;
}

TEST_F(MalformedTest, ServesNoFrameThatBecameALinkOutOfItsDataset) {
    const TinyDataset mine("mine");
    LiveServer live({mine.folder()}, {.max_open_frames = 1});
    const auto frame = mine.folder() / Dataset::open(mine.folder())->manifest().frames(0).file();
    const auto outside = mine.folder().parent_path() / "outside";
    std::filesystem::rename(frame, outside);
    std::filesystem::create_symlink(outside, frame);
    EXPECT_EQ(live.get("/v1/datasets/mine/frames/30").status, 400);
    EXPECT_EQ(live.get("/v1/datasets/mine/frames/30/channels/0/blocks/0").status, 400);
    RawStream stream(live.port());
    ASSERT_TRUE(stream.establish("mine"));
    stream.send(openFrameMessage(1, 30));
    const auto failed = stream.receive();
    ASSERT_TRUE(failed);
    EXPECT_EQ(failed->header.failed().reason(), Failed::REASON_IO);
}

}  // namespace
}  // namespace brickyard

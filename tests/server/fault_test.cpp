// What goes wrong below a server: the disk, the folders, descriptors, memory.
#include <gmock/gmock.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "growing_dataset.h"
#include "live_server.h"
#include "raw_stream.h"
#include "server/batch_pool.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::AnyOf;
using testing::HasSubstr;

// ThreadSanitizer allows no threads in a forked child; UndefinedBehaviorSanitizer opens a pipe to see whether
// an object is there, and takes one for absent where no descriptor is left.
#if defined(__has_feature)
#if __has_feature(thread_sanitizer) || __has_feature(undefined_behavior_sanitizer)
#define BRICKYARD_NO_FORK
#endif
#endif

ServerOptions quick() {
    ServerOptions options;
    options.rescan = milliseconds(100);
    return options;
}

TEST(Faults, AFrameThatIsCutWhileItIsServedFailsPageByPage) {
    GrowingDataset growing("tiny", {.levels = 4, .payload_bytes = 4096});
    const auto bricks = growing.first().bricks(0);
    LiveServer live({growing.folder()}, quick());
    RawStream stream(live.port());
    ASSERT_TRUE(stream.establish());
    StreamHeader wish = wishMessage(1, 4ull << 30);
    addPage(wish, bricks.front());
    stream.send(wish);
    ASSERT_TRUE(stream.receive()->header.has_page());
    ASSERT_TRUE(stream.receive()->header.has_wish_done());
    fs::resize_file(growing.frameFile(), 100);

    wish = wishMessage(2, 4ull << 30);
    for (std::size_t i = 0; i < 50; ++i) addPage(wish, bricks[i]);
    stream.send(wish);
    for (std::size_t i = 0; i < 50; ++i) {
        const auto failed = stream.receive();
        ASSERT_TRUE(failed);
        EXPECT_EQ(failed->header.failed().reason(), Failed::REASON_IO) << failed->header.ShortDebugString();
        EXPECT_EQ(failed->header.failed().page().node(), bricks[i].node);
        EXPECT_EQ(failed->header.failed().message().find('\n'), std::string::npos);
    }
    const auto done = stream.receive();
    ASSERT_TRUE(done && done->header.has_wish_done());
    EXPECT_EQ(done->header.wish_done().sent_bytes(), 0u);
    StreamHeader ping;
    ping.mutable_ping();
    stream.send(ping);
    EXPECT_TRUE(stream.receive()->header.has_pong());
    EXPECT_EQ(live.get(fmt::format("/v1/datasets/tiny/frames/30/channels/0/pages/{}/{}", bricks[1].block,
                                   bricks[1].node))
                  .status,
              500);
    EXPECT_TRUE(live.isHealthy());
    EXPECT_GE(live.metric(R"(brickyard_errors_total{kind="disk"})"), 50);
}

TEST(Faults, ADatasetThatIsRemovedGoesOnForThoseWhoHaveItOpen) {
    GrowingDataset growing("tiny", {.levels = 4, .payload_bytes = 4096});
    const auto bricks = growing.first().bricks(0);
    const auto expected = growing.first().payload(bricks[7]);
    LiveServer live({growing.folder()}, quick());
    RawStream stream(live.port());
    ASSERT_TRUE(stream.establish());
    stream.send(openFrameMessage(1, 30));
    ASSERT_TRUE(stream.receive()->header.has_frame_opened());
    growing.remove();
    bool removed = false, names = false;
    while (!removed || !names) {
        const auto news = stream.receive();
        ASSERT_TRUE(news);
        removed = removed || news->header.dataset_changed().removed();
        names = names || news->header.has_catalog_changed();
    }
    StreamHeader wish = wishMessage(1, 4ull << 30);
    addPage(wish, bricks[7]);
    stream.send(wish);
    const auto page = stream.receive();
    ASSERT_TRUE(page && page->header.has_page());
    EXPECT_EQ(std::memcmp(page->payload.data(), expected.data(), expected.size()), 0);
    ASSERT_TRUE(stream.receive()->header.has_wish_done());
    stream.send(openMessage("tiny"));
    EXPECT_EQ(stream.receive()->header.failed().reason(), Failed::REASON_NO_DATASET);
    stream.send(openFrameMessage(1, 30));
    EXPECT_EQ(stream.receive()->header.failed().reason(), Failed::REASON_NO_FRAME);
    EXPECT_EQ(live.get("/v1/datasets/tiny").status, 404);
    RawStream late(live.port());
    EXPECT_FALSE(late.establish());
}

TEST(Faults, AFrameThatIsReplacedStaysTheSameUntilItIsOpenedAgain) {
    GrowingDataset growing("tiny", {.payload_bytes = 96});
    const TinyDataset other("tiny", {.payload_bytes = 128});
    const auto bricks = growing.first().bricks(0);
    LiveServer live({growing.folder()}, quick());
    RawStream stream(live.port());
    ASSERT_TRUE(stream.establish());
    std::uint64_t epoch = 0;
    const auto pageBytes = [&] {
        StreamHeader wish = wishMessage(++epoch, 4ull << 30);
        addPage(wish, bricks[3]);
        stream.send(wish);
        const auto page = stream.receive();
        EXPECT_TRUE(page && page->header.has_page());
        EXPECT_TRUE(stream.receive()->header.has_wish_done());
        return page ? page->payload.size() : 0;
    };
    stream.send(openFrameMessage(1, 30));
    const auto before = stream.receive();
    ASSERT_TRUE(before && before->header.has_frame_opened());
    EXPECT_EQ(pageBytes(), 96u);
    growing.become(other);
    const auto changed = stream.receive();
    ASSERT_TRUE(changed && changed->header.has_dataset_changed());
    EXPECT_EQ(pageBytes(), 96u) << "a frame changed under a client that has it open";
    stream.send(openFrameMessage(1, 30));
    const auto after = stream.receive();
    ASSERT_TRUE(after && after->header.has_frame_opened());
    EXPECT_NE(after->header.frame_opened().footer_xxh64(), before->header.frame_opened().footer_xxh64());
    EXPECT_EQ(after->header.frame_opened().footer_xxh64(), other.store()->footerChecksum());
    EXPECT_EQ(pageBytes(), 128u);
    // Who comes now never sees the old one.
    EXPECT_EQ(live.get(fmt::format("/v1/datasets/tiny/frames/30/channels/0/pages/0/{}", bricks[3].node))
                  .body.size(),
              128u);
}

// Two batches for twenty who read slowly: each gets its turn.
TEST(Faults, WhereMemoryIsShortEverybodyGetsATurn) {
    constexpr int kClients = 20;
    TinyDataset tiny("tiny", {.levels = 4, .payload_bytes = 4096});
    const auto bricks = tiny.bricks(0);
    ServerOptions options;
    options.queue_bytes = 2 * kBatchBytes;
    LiveServer live({tiny.folder()}, options);
    std::vector<std::thread> clients;
    std::atomic<int> done{0};
    for (int c = 0; c < kClients; ++c)
        clients.emplace_back([&] {
            RawStream stream(live.port(), 8192);
            if (!stream.establish()) return;
            StreamHeader wish = wishMessage(1, 4ull << 30);
            for (std::size_t i = 0; i < 500; ++i) addPage(wish, bricks[i % bricks.size()]);
            stream.send(wish);
            for (int i = 0; i < 500; ++i) {
                const auto page = stream.receive();
                if (!page || page->payload.size() != 4096) return;
                if (i % 50 == 0) std::this_thread::sleep_for(milliseconds(5));
            }
            if (stream.receive()) ++done;
        });
    // Each client gives up by itself where nothing comes for 10 seconds.
    EXPECT_TRUE(comesTrue(
        [&] {
            EXPECT_LE(live.metric("brickyard_queued_bytes"), 2 * kBatchBytes);
            return done == kClients;
        },
        seconds(60)));
    for (std::thread& client : clients) client.join();
    EXPECT_EQ(done, kClients);
    EXPECT_EQ(live.metric("brickyard_queued_bytes"), 0);
}

#ifndef BRICKYARD_NO_FORK

// In a process of its own, whose descriptors may run out.
TEST(Faults, WithoutDescriptorsNewcomersAreTurnedAwayAndTheOthersServed) {
    const TinyDataset tiny("tiny", {.levels = 4, .payload_bytes = 4096});
    const auto bricks = tiny.bricks(0);
    int port_pipe[2] = {}, end_pipe[2] = {};
    ASSERT_EQ(::pipe(port_pipe), 0);
    ASSERT_EQ(::pipe(end_pipe), 0);
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
        ::close(port_pipe[0]);
        ::close(end_pipe[1]);
        const std::size_t in_use = openDescriptors();
        auto catalog = Catalog::open({tiny.folder()}, 8, 1u << 20);
        ServerOptions options;
        options.port = 0;
        options.log_level = "critical";
        auto server = Server::start(std::move(*catalog), options);
        const rlimit limit{in_use + 40, in_use + 40};
        std::uint16_t port = server ? (*server)->port() : 0;
        if (::setrlimit(RLIMIT_NOFILE, &limit) != 0 || ::write(port_pipe[1], &port, sizeof port) < 0)
            ::_exit(3);
        char end = 0;
        if (::read(end_pipe[0], &end, 1) < 0) ::_exit(4);
        (*server)->stop();
        ::_exit(0);
    }
    ::close(port_pipe[1]);
    ::close(end_pipe[0]);
    std::uint16_t port = 0;
    ASSERT_EQ(::read(port_pipe[0], &port, sizeof port), ssize_t(sizeof port));
    ASSERT_NE(port, 0);
    {
        RawStream old(port);
        ASSERT_TRUE(old.establish());
        old.send(openFrameMessage(1, 30));
        ASSERT_TRUE(old.receive()->header.has_frame_opened());
        std::vector<std::unique_ptr<RawSocket>> crowd;
        for (int i = 0; i < 60; ++i) crowd.push_back(std::make_unique<RawSocket>(port));
        std::this_thread::sleep_for(milliseconds(300));
        // One of those who came last: told, or cut, and not left waiting.
        const std::string answer = crowd.back()->receiveSome();
        EXPECT_THAT(answer, AnyOf("", HasSubstr("503 Service Unavailable")));
        StreamHeader wish = wishMessage(1, 4ull << 30);
        for (std::size_t i = 0; i < 100; ++i) addPage(wish, bricks[i]);
        old.send(wish);
        for (int i = 0; i < 100; ++i) {
            const auto page = old.receive();
            ASSERT_TRUE(page && page->header.has_page()) << i;
        }
        const auto done = old.receive();
        EXPECT_TRUE(done && done->header.has_wish_done());
    }
    EXPECT_TRUE(comesTrue([&] { return request(port, "GET", "/healthz").status == 200; }))
        << "it did not recover when descriptors were free again";
    EXPECT_EQ(::write(end_pipe[1], "x", 1), 1);
    int status = 0;
    ::waitpid(child, &status, 0);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
    ::close(port_pipe[0]);
    ::close(end_pipe[1]);
}

#endif

}  // namespace
}  // namespace brickyard

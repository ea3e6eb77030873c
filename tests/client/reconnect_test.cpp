// A server that goes away in the middle: whoever draws waits until it is back, and draws the same.
#include <gmock/gmock.h>

#include <cstring>
#include <thread>

#include "blob_field.h"
#include "client/remote_server.h"
#include "client/remote_source.h"
#include "client/renderer.h"
#include "forwarding_source.h"
#include "server/server.h"
#include "stored_fields.h"

namespace brickyard {
namespace {

using testing::HasSubstr;
using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

// Does something in the middle: when it was asked for pages so often.
class InterruptedSource final : public ForwardingSource {
public:
    InterruptedSource(std::unique_ptr<BrickSource> inner, int takes, std::function<void()> interrupt)
        : ForwardingSource(std::move(inner)), takes_(takes), interrupt_(std::move(interrupt)) {}
    Result<std::vector<Arrival>> take(SourceDeadline deadline) override {
        if (takes_-- == 0) interrupt_();
        return inner_->take(deadline);
    }

private:
    int takes_;
    std::function<void()> interrupt_;
};

class ReconnectTest : public testing::Test {
protected:
    void SetUp() override {
        const FormulaField field = roughBlobField();
        for (const char* name : {"one.bricks", "two.bricks"}) {
            const Result<void> stored = storeFields(folder_ / name, {&field});
            ASSERT_TRUE(stored) << stored.error().message;
        }
        start();
        timeouts_.reconnect = milliseconds(20'000);
    }
    // On the port that it had before.
    void start() {
        auto catalog = Catalog::open({folder_ / "one.bricks", folder_ / "two.bricks"}, 8, 1u << 20);
        ASSERT_TRUE(catalog) << catalog.error().message;
        ServerOptions options;
        options.port = port_;
        auto server = Server::start(std::move(*catalog), options);
        ASSERT_TRUE(server) << server.error().message;
        server_ = std::move(*server);
        port_ = server_->port();
    }
    void stop() { server_.reset(); }
    StreamAddress address() const {
        StreamAddress address;
        address.host = "127.0.0.1";
        address.port = port_;
        address.dataset = "one";
        return address;
    }
    std::unique_ptr<RemoteSource> connect() {
        auto source = RemoteSource::open(address(), "", timeouts_);
        EXPECT_TRUE(source) << source.error().message;
        return std::move(*source);
    }
    static RenderRequest request() {
        RenderRequest request;
        request.width = 40, request.height = 32;
        request.camera = cameraAt({0, 20, 150}, {0, 0, 5});
        request.density_scale = 0.05;
        request.quality.max_error = 0.01;
        return request;
    }
    static RenderOutcome draw(BrickSource& source, const RenderRequest& request = ReconnectTest::request()) {
        auto outcome = makeCpuRenderer()->render(source, request);
        EXPECT_TRUE(outcome) << outcome.error().message;
        return outcome ? std::move(*outcome) : RenderOutcome();
    }
    static void expectSamePixels(const Picture& a, const Picture& b) {
        ASSERT_EQ(a.pixels.size(), b.pixels.size());
        EXPECT_EQ(std::memcmp(a.pixels.data(), b.pixels.data(), a.pixels.size() * sizeof(Pixel)), 0);
    }
    static std::size_t takeAll(BrickSource& source) {
        std::size_t pages = 0;
        while (true) {
            const auto chunk = source.take(Clock::now() + std::chrono::seconds(20));
            EXPECT_TRUE(chunk) << chunk.error().message;
            if (!chunk || chunk->empty()) return pages;
            pages += chunk->size();
        }
    }
    // Every brick of the frame's first tree block that has one.
    static PageWish bricksOf(BrickSource& source, const FrameFooter& footer) {
        PageWish wish;
        wish.pages.push_back({true, {0, 0, 0}});
        wish.credit_bytes = 1u << 30;
        EXPECT_TRUE(source.wish(wish));
        const auto arrivals = source.take(Clock::now() + std::chrono::seconds(20));
        EXPECT_TRUE(arrivals && arrivals->size() == 1);
        const BlockRef& ref = footer.channels(0).blocks(0);
        const auto block = decodeStoredBlock(*arrivals->front().bytes, ref.raw_bytes(), 0,
                                             std::uint32_t(footer.channels(0).blocks_size()), UINT64_MAX, 1);
        EXPECT_TRUE(block);
        wish.pages.clear();
        for (std::uint32_t node = 0; block && node < block->nodeCount(); ++node)
            if (block->record(node).hasBrick()) wish.pages.push_back({false, {0, 0, node}});
        return wish;
    }

    ScratchFolder folder_;
    std::uint16_t port_ = 0;
    std::unique_ptr<Server> server_;
    StreamTimeouts timeouts_;
};

TEST_F(ReconnectTest, APictureIsTheSameWheneverTheServerIsStartedAgain) {
    auto undisturbed = connect();
    const RenderOutcome expected = draw(*undisturbed);
    ASSERT_TRUE(expected.final);
    for (const int takes : {0, 1, 2, 5, 9, 20}) {
        std::thread restart;
        InterruptedSource source(connect(), takes, [&] {
            stop();
            restart = std::thread([&] {
                std::this_thread::sleep_for(milliseconds(150));
                start();
            });
        });
        const RenderOutcome outcome = draw(source);
        if (restart.joinable()) restart.join();
        EXPECT_TRUE(outcome.final) << takes;
        // Stopped before anything was taken, it is missed by a later wish. Afterwards that depends on what
        // had arrived.
        if (takes == 0)
            EXPECT_EQ(outcome.streamed.reconnects, 1u);
        else
            EXPECT_LE(outcome.streamed.reconnects, 1u) << takes;
        EXPECT_EQ(outcome.not_final.failed, 0u);
        expectSamePixels(outcome.picture, expected.picture);
    }
}

TEST_F(ReconnectTest, AColdPictureBeginsWithTheGreeting) {
    RenderRequest framed = request();
    framed.camera.reset();
    framed.density_scale = 0.05;
    for (const RenderRequest& request : {ReconnectTest::request(), framed}) {
        const RenderOutcome expected = draw(*connect(), request);
        auto hinted = RemoteSource::open(address(), "", timeouts_, startHint(request, std::nullopt));
        ASSERT_TRUE(hinted);
        const RenderOutcome outcome = draw(**hinted, request);
        expectSamePixels(outcome.picture, expected.picture);
        EXPECT_EQ(outcome.streamed.bytes_streamed, expected.streamed.bytes_streamed);
        EXPECT_EQ(outcome.streamed.round_trips + 2, expected.streamed.round_trips)
            << "frame and overview cost none of their own";
    }
}

TEST_F(ReconnectTest, WhatHasArrivedIsNotAskedForAgain) {
    auto source = connect();
    const auto footer = source->openFrame(0);
    ASSERT_TRUE(footer);
    const PageWish wish = bricksOf(*source, *footer);
    ASSERT_GT(wish.pages.size(), 100u);
    const std::uint64_t before = source->counters().pages_streamed;
    ASSERT_TRUE(source->wish(wish));
    ASSERT_FALSE(source->take(Clock::now() + std::chrono::seconds(5))->empty());
    stop();
    start();
    takeAll(*source);
    EXPECT_TRUE(source->wishDone());
    EXPECT_EQ(source->counters().pages_streamed - before, wish.pages.size());
}

TEST_F(ReconnectTest, SourcesThatShareAConnectionComeBackTogether) {
    RemoteServer server(address(), "", timeouts_);
    auto one = std::move(*server.open("one"));
    auto two = std::move(*server.open("two"));
    const auto footer = one->openFrame(0);
    ASSERT_TRUE(footer && two->openFrame(0));
    const PageWish wish = bricksOf(*one, *footer);
    ASSERT_TRUE(one->wish(wish));
    ASSERT_TRUE(two->wish(wish));
    stop();
    start();
    EXPECT_EQ(takeAll(*one), wish.pages.size());
    EXPECT_EQ(takeAll(*two), wish.pages.size());
    EXPECT_EQ(one->counters().reconnects, 1u);
    EXPECT_EQ(two->counters().reconnects, 1u);
}

TEST_F(ReconnectTest, PatienceEndsWithANamedError) {
    timeouts_.reconnect = milliseconds(400);
    auto source = connect();
    const auto footer = source->openFrame(0);
    ASSERT_TRUE(footer);
    const PageWish wish = bricksOf(*source, *footer);
    stop();
    ASSERT_TRUE(source->wish(wish));
    const auto begin = Clock::now();
    Result<std::vector<Arrival>> lost = source->take(begin + std::chrono::seconds(20));
    while (lost && !lost->empty()) lost = source->take(begin + std::chrono::seconds(20));
    ASSERT_FALSE(lost);
    EXPECT_LT(Clock::now() - begin, std::chrono::seconds(5));
    EXPECT_EQ(lost.error().code, ErrorCode::kTimeout);
    EXPECT_THAT(lost.error().message, HasSubstr(std::to_string(port_)));
    EXPECT_THAT(lost.error().message, HasSubstr("0.4 s"));
    EXPECT_FALSE(source->openFrame(0)) << "it stays lost";
}

TEST_F(ReconnectTest, NoPatienceIsAnErrorAtOnce) {
    timeouts_.reconnect = milliseconds(0);
    auto source = connect();
    stop();
    const auto begin = Clock::now();
    const auto footer = source->openFrame(0);
    ASSERT_FALSE(footer);
    EXPECT_LT(Clock::now() - begin, std::chrono::seconds(5));
    EXPECT_THAT(footer.error().message, HasSubstr("the connection was lost"));
}

TEST_F(ReconnectTest, APictureKeepsItsDeadlineWhileTheServerIsAway) {
    RenderRequest limited = request();
    limited.deadline = std::chrono::duration<double>(1.0);
    limited.quality.max_error = 1e-6;
    InterruptedSource source(connect(), 3, [&] { stop(); });
    const auto begin = Clock::now();
    const RenderOutcome outcome = draw(source, limited);
    EXPECT_LT(Clock::now() - begin, std::chrono::seconds(8)) << "the sanitizers' share of it is large";
    EXPECT_FALSE(outcome.final);
    EXPECT_GT(outcome.not_final.queued, 0u);
    const auto late = source.openFrame(0, Clock::now() + milliseconds(50));
    ASSERT_FALSE(late);
    EXPECT_EQ(late.error().code, ErrorCode::kTimeout);
    EXPECT_THAT(late.error().message, HasSubstr("frame 0"));
}

TEST_F(ReconnectTest, AFrameThatWasConvertedAgainIsNamed) {
    auto source = connect();
    ASSERT_TRUE(source->openFrame(0));
    stop();
    const FormulaField other("density", {{0, 0, 0}, {20, 20, 20}},
                             [](auto x, auto y, auto z, int) { return double(x + y + z + 1); });
    ASSERT_TRUE(storeFields(folder_ / "one.bricks", {&other}));
    start();
    PageWish wish;
    wish.pages.push_back({true, {0, 0, 0}});
    wish.credit_bytes = 1u << 20;
    ASSERT_TRUE(source->wish(wish));
    const auto taken = source->take(Clock::now() + std::chrono::seconds(20));
    ASSERT_FALSE(taken);
    EXPECT_THAT(taken.error().message, HasSubstr("converted again"));
}

TEST_F(ReconnectTest, ADatasetThatIsGoneIsNamedAndTheOtherGoesOn) {
    RemoteServer server(address(), "", timeouts_);
    auto one = std::move(*server.open("one"));
    auto two = std::move(*server.open("two"));
    stop();
    auto catalog = Catalog::open({folder_ / "two.bricks"}, 8, 1u << 20);
    ASSERT_TRUE(catalog);
    ServerOptions options;
    options.port = port_;
    server_ = std::move(*Server::start(std::move(*catalog), options));
    EXPECT_TRUE(two->openFrame(0));
    const auto gone = one->openFrame(0);
    ASSERT_FALSE(gone);
    EXPECT_EQ(gone.error().code, ErrorCode::kNotFound);
    EXPECT_THAT(gone.error().message, HasSubstr("/one"));
}

}  // namespace
}  // namespace brickyard

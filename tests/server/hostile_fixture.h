// A server that somebody hostile meets, another client beside him, and whether all is as before when he is
// gone.
#pragma once

#include <gmock/gmock.h>

#include "live_server.h"
#include "raw_stream.h"
#include "tiny_dataset.h"

namespace brickyard {

class HostileTest : public testing::Test {
protected:
    static void SetUpTestSuite() {
        tiny_ = new TinyDataset("tiny", {.levels = 4, .payload_bytes = 4096});
        bricks_ = new std::vector<PageAddress>(tiny_->bricks(0));
    }
    static void TearDownTestSuite() {
        delete tiny_;
        delete bricks_;
    }
    void SetUp() override { start({}); }
    void TearDown() override {
        if (!live_) return;
        EXPECT_TRUE(live_->isHealthy());
        EXPECT_TRUE(comesTrue([&] { return live_->isQuiet(); }, seconds(20))) << live_->get("/metrics").body;
        EXPECT_TRUE(comesTrue([&] { return openDescriptors() <= descriptors_; }))
            << openDescriptors() << " descriptors are open, of " << descriptors_ << " before";
    }

    void start(ServerOptions options) {
        live_.reset();
        live_ = std::make_unique<LiveServer>(std::vector{tiny_->folder()}, options);
        // What stays open for good: the frame.
        EXPECT_EQ(live_->get("/v1/datasets/tiny/frames/30").status, 200);
        ASSERT_TRUE(comesTrue([&] { return live_->isQuiet(); }));
        descriptors_ = openDescriptors();
    }
    std::uint16_t port() const { return live_->port(); }
    static StreamHeader wishOfPages(std::uint64_t epoch, std::size_t pages) {
        StreamHeader wish = wishMessage(epoch, 4ull << 30);
        for (std::size_t i = 0; i < pages; ++i) addPage(wish, (*bricks_)[i % bricks_->size()]);
        return wish;
    }
    // Another client, who is served as if nobody else was there.
    void expectServed() {
        const auto begin = Clock::now();
        RawStream client(port());
        ASSERT_TRUE(client.establish());
        client.send(wishOfPages(1, 5));
        for (std::size_t i = 0; i < 5; ++i) {
            const auto page = client.receive();
            ASSERT_TRUE(page && page->header.has_page());
            EXPECT_EQ(page->payload.size(), 4096u);
        }
        const auto done = client.receive();
        EXPECT_TRUE(done && done->header.has_wish_done());
        EXPECT_LT(Clock::now() - begin, seconds(5));
    }
    bool streamsEnd(milliseconds patience = seconds(15)) {
        return comesTrue([&] { return live_->metric(R"(brickyard_connections{kind="stream"})") == 0; },
                         patience);
    }

    inline static TinyDataset* tiny_ = nullptr;
    inline static std::vector<PageAddress>* bricks_ = nullptr;
    std::unique_ptr<LiveServer> live_;
    std::size_t descriptors_ = 0;
};

}  // namespace brickyard

#include "client/local_source.h"

#include <gmock/gmock.h>

#include <fstream>

#include "client/stream_address.h"
#include "tiny_dataset.h"

namespace brickyard {
namespace {

using testing::HasSubstr;
using Clock = std::chrono::steady_clock;

class LocalSourceTest : public testing::Test {
protected:
    void SetUp() override {
        auto source = openSource(tiny_.folder().string(), "");
        ASSERT_TRUE(source) << source.error().message;
        source_ = std::move(*source);
    }
    std::vector<Arrival> takeAll() {
        std::vector<Arrival> all;
        while (true) {
            auto chunk = source_->take(Clock::now() + std::chrono::seconds(10));
            EXPECT_TRUE(chunk);
            if (!chunk || chunk->empty()) return all;
            EXPECT_LE(chunk->size(), 64u);
            for (Arrival& arrival : *chunk) all.push_back(std::move(arrival));
        }
    }

    TinyDataset tiny_{"tiny", {.levels = 4}};
    std::unique_ptr<BrickSource> source_;
};

TEST_F(LocalSourceTest, TellsWhenFramesCome) {
    using std::chrono::milliseconds;
    const TinyDataset one("tiny", {.frames = {30}}), two("tiny", {.frames = {30, 31}});
    auto source = std::move(*openSource(one.folder().string(), ""));
    const Manifest& before = source->manifest();
    EXPECT_FALSE(*source->waitForChange(std::chrono::steady_clock::now() + milliseconds(20)));
    for (const char* what : {"frames", "manifest.json"})
        std::filesystem::copy(
            two.folder() / what, one.folder() / what,
            std::filesystem::copy_options::recursive | std::filesystem::copy_options::overwrite_existing);
    EXPECT_TRUE(*source->waitForChange(std::chrono::steady_clock::now() + std::chrono::seconds(10)));
    EXPECT_EQ(source->latestManifest()->frames_size(), 2);
    EXPECT_EQ(before.frames_size(), 1) << "what was handed out stays";
    EXPECT_TRUE(source->openFrame(31));
    EXPECT_FALSE(*source->waitForChange(std::chrono::steady_clock::now() + milliseconds(20)));
}

TEST_F(LocalSourceTest, GivesTheFooterOfAFrame) {
    EXPECT_EQ(source_->manifest().frames(0).frame(), 30u);
    EXPECT_EQ(source_->openFrame(30)->channels_size(), 2);
    EXPECT_EQ(source_->openFrame(31).error().code, ErrorCode::kNotFound);
}

TEST_F(LocalSourceTest, GivesAListInChunksAndCountsIt) {
    ASSERT_TRUE(source_->openFrame(30));
    const auto bricks = tiny_.bricks(0);
    PageWish wish;
    wish.credit_bytes = 1u << 30;
    wish.pages.push_back({true, {0, 0, 0}});
    for (const PageAddress& brick : bricks) wish.pages.push_back({false, brick});
    ASSERT_TRUE(source_->wish(wish));
    EXPECT_FALSE(source_->wishDone());
    const auto arrivals = takeAll();
    EXPECT_TRUE(source_->wishDone());
    ASSERT_EQ(arrivals.size(), wish.pages.size());
    std::uint64_t bytes = 0;
    for (std::size_t i = 0; i < arrivals.size(); ++i) {
        EXPECT_EQ(arrivals[i].page.address, wish.pages[i].address);
        bytes += arrivals[i].bytes->size();
    }
    EXPECT_EQ(arrivals[7].bytes.value(), tiny_.payload(bricks[6]));
    const SourceCounters counters = source_->counters();
    EXPECT_EQ(counters.bytes_streamed, bytes);
    EXPECT_EQ(counters.pages_streamed, bricks.size());
    EXPECT_EQ(counters.blocks_streamed, 1u);
    EXPECT_EQ(counters.round_trips, 3u);
}

TEST_F(LocalSourceTest, KeepsTheCreditAndTellsOfPagesThatAreNotThere) {
    ASSERT_TRUE(source_->openFrame(30));
    PageWish wish;
    wish.credit_bytes = 100;
    wish.pages = {{false, {0, 9, 9}}, {false, tiny_.bricks(0)[0]}, {false, tiny_.bricks(0)[1]}};
    ASSERT_TRUE(source_->wish(wish));
    const auto arrivals = takeAll();
    ASSERT_EQ(arrivals.size(), 2u);
    EXPECT_FALSE(arrivals[0].bytes);
    EXPECT_TRUE(arrivals[1].bytes);
    EXPECT_TRUE(source_->wishDone());
}

TEST_F(LocalSourceTest, ANewWishReplacesTheOlderOne) {
    ASSERT_TRUE(source_->openFrame(30));
    PageWish wish;
    wish.credit_bytes = 1u << 20;
    for (const PageAddress& brick : tiny_.bricks(0)) wish.pages.push_back({false, brick});
    ASSERT_TRUE(source_->wish(wish));
    EXPECT_EQ(source_->take(Clock::now())->size(), 1u) << "a deadline that has passed still gives progress";
    wish.pages.resize(1);
    ASSERT_TRUE(source_->wish(wish));
    EXPECT_EQ(takeAll().size(), 1u);
}

TEST_F(LocalSourceTest, RefusesAWishBeforeAFrameIsOpen) { EXPECT_FALSE(source_->wish({})); }

TEST_F(LocalSourceTest, SaysWhatIsNoSource) {
    EXPECT_EQ(openSource("/nonexistent/plume.bricks", "").error().code, ErrorCode::kNotFound);
    const auto file = tiny_.folder() / "manifest.json";
    EXPECT_EQ(openSource(file.string(), "").error().code, ErrorCode::kInvalid);
    const auto empty = tiny_.folder() / "empty";
    std::filesystem::create_directory(empty);
    EXPECT_EQ(openSource(empty.string(), "").error().code, ErrorCode::kNotFound);
    EXPECT_EQ(openSource("http://127.0.0.1:1/x", "").error().code, ErrorCode::kInvalid);
    EXPECT_EQ(openSource("wss://127.0.0.1:1/x", "").error().code, ErrorCode::kRefused);
}

TEST(StreamAddress, TakesAddressesApart) {
    const auto expect = [](const char* url, const char* host, int port, const char* dataset) {
        const auto address = StreamAddress::parse(url);
        ASSERT_TRUE(address) << address.error().message;
        EXPECT_EQ(address->host, host) << url;
        EXPECT_EQ(address->port, port) << url;
        EXPECT_EQ(address->dataset, dataset) << url;
        EXPECT_EQ(StreamAddress::parse(address->url())->dataset, dataset);
    };
    expect("ws://127.0.0.1:8750/plume", "127.0.0.1", 8750, "plume");
    expect("ws://farm.example/plume/", "farm.example", 8750, "plume");
    expect("ws://[::1]:99/a%20b", "::1", 99, "a b");
    expect("ws://[fe80::1]/x%2Fy", "fe80::1", 8750, "x/y");
    EXPECT_EQ(StreamAddress::parse("ws://[::1]:99/a b")->url(), "ws://[::1]:99/a%20b");
}

TEST(StreamAddress, RefusesWhatIsNone) {
    for (const char* bad :
         {"", "ws:/", "ws://", "ws:///plume", "ws://host", "ws://host/", "ws://host:/plume",
          "ws://host:0/plume", "ws://host:65536/plume", "ws://host:8x/plume", "ws://[::1/plume",
          "ws://[::1]8750/plume", "ws://host/a/b", "ws://host/%zz", "tcp://host/plume"}) {
        const auto address = StreamAddress::parse(bad);
        ASSERT_FALSE(address) << bad;
        EXPECT_EQ(address.error().code, ErrorCode::kInvalid) << bad;
    }
}

}  // namespace
}  // namespace brickyard

// Many datasets over one connection, and a start that asks for everything at once.
#include "client/remote_server.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <thread>

#include "client/local_source.h"
#include "core/camera_framing.h"
#include "server/server.h"
#include "tiny_dataset.h"

namespace brickyard {
namespace {

using testing::HasSubstr;
using Clock = std::chrono::steady_clock;

class RemoteServerTest : public testing::Test {
protected:
    RemoteServerTest() {
        ServerOptions options;
        options.port = 0;
        server_ = std::move(*Server::start(
            std::move(*Catalog::open({plume_.folder(), jets_.folder()}, 8, 1u << 20)), options));
        address_.host = "127.0.0.1";
        address_.port = server_->port();
        address_.dataset = "plume";
    }
    static PageWish listOf(const TinyDataset& dataset, std::size_t pages, std::uint64_t credit = 1u << 30) {
        PageWish wish;
        wish.credit_bytes = credit;
        const auto bricks = dataset.bricks(0);
        for (std::size_t i = 0; i < std::min(pages, bricks.size()); ++i)
            wish.pages.push_back({false, bricks[i]});
        return wish;
    }
    static std::vector<Arrival> takeAll(BrickSource& source) {
        std::vector<Arrival> all;
        while (true) {
            auto chunk = source.take(Clock::now() + std::chrono::seconds(20));
            EXPECT_TRUE(chunk) << chunk.error().message;
            if (!chunk || chunk->empty()) return all;
            std::move(chunk->begin(), chunk->end(), std::back_inserter(all));
        }
    }
    static void expectPages(const std::vector<Arrival>& arrivals, const PageWish& wish,
                            const TinyDataset& dataset) {
        ASSERT_EQ(arrivals.size(), wish.pages.size());
        for (std::size_t i = 0; i < arrivals.size(); ++i) {
            ASSERT_EQ(arrivals[i].page.address, wish.pages[i].address) << i;
            ASSERT_TRUE(arrivals[i].bytes) << arrivals[i].bytes.error().message;
            ASSERT_EQ(*arrivals[i].bytes, dataset.payload(arrivals[i].page.address)) << i;
        }
    }
    // What a cold picture of 64 x 48 would wish of the density.
    static StartHint hint(std::optional<std::uint32_t> frame) {
        StartHint hint{frame, StartView()};
        hint.view->width = 64;
        hint.view->height = 48;
        hint.view->channels = {"density"};
        hint.view->credit_bytes = 1u << 20;
        return hint;
    }
    static PageWish sameAs(const StartHint& hint, const FrameFooter& footer) {
        PageWish wish;
        wish.credit_bytes = hint.view->credit_bytes;
        wish.views.push_back({frameChannel(footer.channels(0), 64.0 / 48), 64, 48, {0}, 1});
        return wish;
    }

    // What `later` has, over what `now` has.
    static void replace(const TinyDataset& now, const TinyDataset& later) {
        for (const char* what : {"frames", "manifest.json"})
            std::filesystem::copy(
                later.folder() / what, now.folder() / what,
                std::filesystem::copy_options::recursive | std::filesystem::copy_options::overwrite_existing);
    }

    // Several megabytes each, so that wishes last for turns.
    TinyDataset plume_{"plume", {.frames = {7, 30}, .levels = 4, .payload_bytes = 8192}};
    TinyDataset jets_{"jets", {.frames = {1}, .levels = 4, .payload_bytes = 8192}};
    std::unique_ptr<Server> server_;
    StreamAddress address_;
};

TEST_F(RemoteServerTest, SourcesOfOneConnectionGetEachTheirOwn) {
    RemoteServer server(address_, "");
    std::vector<std::thread> threads;
    for (int t = 0; t < 4; ++t)
        threads.emplace_back([&, t] {
            const TinyDataset& dataset = t % 2 ? jets_ : plume_;
            auto source = server.open(t % 2 ? "jets" : "plume");
            ASSERT_TRUE(source) << source.error().message;
            ASSERT_TRUE((*source)->openFrame(t % 2 ? 1 : 7));
            for (int round = 0; round < 3; ++round) {
                const PageWish wish = listOf(dataset, 500);
                ASSERT_TRUE((*source)->wish(wish));
                expectPages(takeAll(**source), wish, dataset);
                EXPECT_TRUE((*source)->wishDone());
            }
        });
    for (std::thread& thread : threads) thread.join();
}

TEST_F(RemoteServerTest, ASourceThatGoesLeavesTheOthersWhatIsTheirs) {
    RemoteServer server(address_, "");
    auto stays = std::move(*server.open("jets"));
    ASSERT_TRUE(stays->openFrame(1));
    for (int i = 0; i < 10; ++i) {
        auto goes = std::move(*server.open("plume"));
        ASSERT_TRUE(goes->openFrame(7));
        ASSERT_TRUE(goes->wish(listOf(plume_, 500)));
        const PageWish wish = listOf(jets_, 50);
        ASSERT_TRUE(stays->wish(wish));
        if (i % 2) EXPECT_FALSE(goes->take(Clock::now() + std::chrono::seconds(20))->empty());
        goes.reset();
        expectPages(takeAll(*stays), wish, jets_);
    }
}

TEST_F(RemoteServerTest, OutlivesItsSourcesAndTheyIt) {
    auto server = std::make_unique<RemoteServer>(address_, "");
    auto source = std::move(*server->open("plume"));
    server.reset();
    EXPECT_TRUE(source->openFrame(30));
    source.reset();
    RemoteServer unused(address_, "");
}

TEST_F(RemoteServerTest, ADatasetThatIsNotThereCostsTheOthersNothing) {
    RemoteServer server(address_, "");
    const auto missing = server.open("smoke", hint(std::nullopt));
    ASSERT_FALSE(missing);
    EXPECT_EQ(missing.error().code, ErrorCode::kNotFound);
    EXPECT_THAT(missing.error().message, HasSubstr("/smoke"));
    EXPECT_TRUE(server.open("jets"));
}

TEST_F(RemoteServerTest, AWholeStartIsOneRoundTrip) {
    for (const std::optional<std::uint32_t> frame : {std::optional<std::uint32_t>(30), {}, {7}}) {
        const StartHint start = hint(frame);
        auto source = RemoteSource::open(address_, "", {}, start);
        ASSERT_TRUE(source) << source.error().message;
        const auto footer = (*source)->openFrame(frame.value_or(7));
        ASSERT_TRUE(footer) << footer.error().message;
        ASSERT_TRUE((*source)->wish(sameAs(start, *footer)));
        const std::vector<Arrival> early = takeAll(**source);
        EXPECT_GT(early.size(), 10u);
        EXPECT_TRUE((*source)->wishDone());
        EXPECT_EQ((*source)->counters().round_trips, 1u);

        // The folder gives the same.
        auto local = std::move(*LocalSource::open(plume_.folder()));
        ASSERT_TRUE(local->openFrame(frame.value_or(7)));
        ASSERT_TRUE(local->wish(sameAs(start, *footer)));
        const std::vector<Arrival> expected = takeAll(*local);
        ASSERT_EQ(early.size(), expected.size());
        for (std::size_t i = 0; i < early.size(); ++i)
            EXPECT_EQ(early[i].page.address, expected[i].page.address);
        // And the next wish is one like any other.
        const PageWish wish = listOf(plume_, 20);
        ASSERT_TRUE((*source)->wish(wish));
        EXPECT_EQ(takeAll(**source).size(), 20u);
    }
}

TEST_F(RemoteServerTest, AHintMayBeWrong) {
    auto other_frame = std::move(*RemoteSource::open(address_, "", {}, hint(7)));
    const auto footer = other_frame->openFrame(30);
    ASSERT_TRUE(footer) << footer.error().message;
    const PageWish wish = listOf(plume_, 30);
    ASSERT_TRUE(other_frame->wish(wish));
    EXPECT_EQ(takeAll(*other_frame).size(), 30u);

    auto other_wish = std::move(*RemoteSource::open(address_, "", {}, hint(7)));
    ASSERT_TRUE(other_wish->openFrame(7));
    ASSERT_TRUE(other_wish->wish(wish));
    const auto arrivals = takeAll(*other_wish);
    for (const WishedPage& page : wish.pages)
        EXPECT_TRUE(std::any_of(arrivals.begin(), arrivals.end(), [&](const Arrival& arrival) {
            return !arrival.page.is_block && arrival.page.address == page.address;
        }));

    auto no_frame = std::move(*RemoteSource::open(address_, "", {}, hint(8)));
    const auto missing = no_frame->openFrame(8);
    ASSERT_FALSE(missing);
    EXPECT_EQ(missing.error().code, ErrorCode::kNotFound);
    EXPECT_TRUE(no_frame->openFrame(30)) << "the connection goes on";

    address_.dataset = "smoke";
    const auto no_dataset = RemoteSource::open(address_, "", {}, hint(8));
    ASSERT_FALSE(no_dataset);
    EXPECT_EQ(no_dataset.error().code, ErrorCode::kNotFound);
    EXPECT_THAT(no_dataset.error().message, HasSubstr("/smoke"));
}

TEST_F(RemoteServerTest, AHintOfALaterDatasetIsFollowedToo) {
    RemoteServer server(address_, "");
    auto first = std::move(*server.open("jets"));
    const StartHint start = hint(std::nullopt);
    auto second = std::move(*server.open("plume", start));
    const auto footer = second->openFrame(7);
    ASSERT_TRUE(footer);
    ASSERT_TRUE(second->wish(sameAs(start, *footer)));
    EXPECT_GT(takeAll(*second).size(), 10u);
    EXPECT_EQ(second->counters().round_trips, 2u) << "it waits for the answer to Open";
}

TEST_F(RemoteServerTest, TellsWhenFramesCome) {
    RemoteServer server(address_, "");
    auto jets = std::move(*server.open("jets"));
    auto plume = std::move(*server.open("plume"));
    const Manifest& before = jets->manifest();
    const TinyDataset later("jets", {.frames = {1, 2}, .levels = 4, .payload_bytes = 8192});
    replace(jets_, later);
    const auto told = jets->waitForChange(Clock::now() + std::chrono::seconds(20));
    ASSERT_TRUE(told) << told.error().message;
    EXPECT_TRUE(*told);
    EXPECT_EQ(jets->latestManifest()->frames_size(), 2);
    EXPECT_EQ(before.frames_size(), 1) << "what was handed out stays";
    EXPECT_TRUE(jets->openFrame(2));
    EXPECT_FALSE(*jets->waitForChange(Clock::now() + std::chrono::milliseconds(20)));
    EXPECT_FALSE(*plume->waitForChange(Clock::now() + std::chrono::milliseconds(20)));
}

TEST_F(RemoteServerTest, MoreDatasetsThanAServerTakesIsAnErrorOfThatOneOnly) {
    std::vector<std::unique_ptr<TinyDataset>> many;
    std::vector<std::filesystem::path> folders;
    for (int i = 0; i < 17; ++i) {
        many.push_back(std::make_unique<TinyDataset>("d" + std::to_string(i), TinyOptions{.levels = 2}));
        folders.push_back(many.back()->folder());
    }
    ServerOptions options;
    options.port = 0;
    auto big = std::move(*Server::start(std::move(*Catalog::open(folders, 8, 1u << 20)), options));
    address_.port = big->port();
    RemoteServer server(address_, "");
    std::vector<std::unique_ptr<RemoteSource>> sources;
    for (int i = 0; i < 16; ++i) sources.push_back(std::move(*server.open("d" + std::to_string(i))));
    const auto one_more = server.open("d16");
    ASSERT_FALSE(one_more);
    EXPECT_EQ(one_more.error().code, ErrorCode::kInvalid);
    EXPECT_THAT(one_more.error().message, HasSubstr("16"));
    EXPECT_TRUE(sources[3]->openFrame(30));
    EXPECT_TRUE(server.open("d3")) << "one that is open may be opened again";
}

}  // namespace
}  // namespace brickyard

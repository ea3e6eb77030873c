// What changes on the disk reaches those who want to know, soon, and nobody else.
#include <gmock/gmock.h>
#include <poll.h>

#include "growing_dataset.h"
#include "live_server.h"
#include "raw_stream.h"
#include "stored_file.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::ElementsAre;

constexpr milliseconds kRescan{200};
// Sanitizers and a busy machine: what is promised is 100 ms.
constexpr milliseconds kLate{100}, kPatience{3000};

class NewsTest : public testing::Test {
protected:
    void start(const std::vector<fs::path>& datasets) {
        ServerOptions options;
        options.rescan = kRescan;
        live_ = std::make_unique<LiveServer>(datasets, options);
    }
    // Whether it is told nothing for a while.
    static bool isLeftAlone(RawStream& stream) {
        pollfd one{stream.socket().descriptor(), POLLIN, 0};
        return ::poll(&one, 1, int(3 * kRescan.count())) == 0;
    }
    static fs::path put(const TinyDataset& dataset, const fs::path& folder) {
        // Aside first, so that nobody sees half of it.
        const fs::path aside = folder.string() + ".making";
        fs::copy(dataset.folder(), aside, fs::copy_options::recursive);
        fs::rename(aside, folder);
        return folder;
    }

    std::unique_ptr<LiveServer> live_;
};

TEST_F(NewsTest, FramesThatAreAppendedReachClientsOf11AndNotOf10) {
    GrowingDataset growing("tiny", {.frames = {30}});
    const TinyDataset longer("tiny", {.frames = {30, 31}});
    start({growing.folder()});
    RawStream current(live_->port()), old(live_->port()), elsewhere(live_->port());
    ASSERT_TRUE(current.establish("tiny", 1));
    ASSERT_TRUE(old.establish("tiny", 0));
    elsewhere.hello(1);
    growing.become(longer);
    const auto begin = Clock::now();
    const auto changed = current.receive();
    const auto took = std::chrono::duration_cast<milliseconds>(Clock::now() - begin);
    ASSERT_TRUE(changed && changed->header.has_dataset_changed());
    EXPECT_EQ(changed->header.dataset_changed().dataset_id(), 1u);
    EXPECT_EQ(changed->header.dataset_changed().manifest().frames_size(), 2);
    EXPECT_FALSE(changed->header.dataset_changed().removed());
    EXPECT_LE(took, kRescan + kPatience);
    RecordProperty("milliseconds", int(took.count()));
    if (took > kRescan + kLate) std::cout << "told after " << took.count() << " ms: later than promised\n";
    EXPECT_TRUE(isLeftAlone(old));
    EXPECT_TRUE(isLeftAlone(current)) << "told twice";
    EXPECT_TRUE(isLeftAlone(elsewhere)) << "it has no dataset open";
    // A client that was not told can still open the frame.
    old.send(openFrameMessage(1, 31));
    EXPECT_TRUE(old.receive()->header.has_frame_opened());
}

TEST_F(NewsTest, ReachAStreamAlthoughOthersAskAllTheTime) {
    GrowingDataset growing("tiny", {.frames = {30}});
    const TinyDataset longer("tiny", {.frames = {30, 31}});
    start({growing.folder()});
    RawStream stream(live_->port());
    ASSERT_TRUE(stream.establish("tiny", 1));
    std::atomic<bool> over{false};
    std::thread asking([&] {
        while (!over) live_->get("/v1/datasets");
    });
    growing.become(longer);
    const auto changed = stream.receive();
    EXPECT_TRUE(changed && changed->header.has_dataset_changed());
    over = true;
    asking.join();
}

TEST_F(NewsTest, ComeBetweenThePagesOfAWish) {
    GrowingDataset growing("tiny", {.frames = {30}, .levels = 4, .payload_bytes = 4096});
    const TinyDataset longer("tiny", {.frames = {30, 31}, .levels = 4, .payload_bytes = 4096});
    const auto bricks = growing.first().bricks(0);
    start({growing.folder()});
    RawStream stream(live_->port());
    ASSERT_TRUE(stream.establish("tiny", 1));
    growing.become(longer);
    bool told = false;
    const auto end = Clock::now() + kRescan + kPatience;
    for (std::uint64_t epoch = 1; !told && Clock::now() < end; ++epoch) {
        StreamHeader wish = wishMessage(epoch, 4ull << 30);
        for (std::size_t i = 0; i < 200; ++i) addPage(wish, bricks[i]);
        stream.send(wish);
        for (;;) {
            const auto message = stream.receive();
            ASSERT_TRUE(message);
            told = told || message->header.has_dataset_changed();
            if (message->header.has_wish_done()) break;
        }
    }
    EXPECT_TRUE(told);
}

TEST_F(NewsTest, ANewDatasetOfAServedFolderReachesClientsOf11AndNotOf10) {
    const StoredFolder library;
    const TinyDataset tiny;
    put(tiny, library.path() / "one.bricks");
    start({library.path()});
    RawStream current(live_->port()), old(live_->port());
    ASSERT_TRUE(current.establish("one", 1));
    ASSERT_TRUE(old.establish("one", 0));
    put(tiny, library.path() / "two.bricks");
    auto changed = current.receive();
    ASSERT_TRUE(changed && changed->header.has_catalog_changed());
    EXPECT_THAT(changed->header.catalog_changed().datasets(), ElementsAre("one", "two"));
    current.send(openMessage("two"));
    EXPECT_TRUE(current.receive()->header.has_welcome());
    fs::remove_all(library.path() / "two.bricks");
    // Both are told, in either order: the name is gone, and so is what this client has open.
    bool names = false, removed = false;
    for (int i = 0; i < 2; ++i) {
        changed = current.receive();
        ASSERT_TRUE(changed);
        names = names || changed->header.has_catalog_changed();
        removed = removed || changed->header.dataset_changed().removed();
    }
    EXPECT_TRUE(names && removed);
    EXPECT_TRUE(isLeftAlone(old));
}

TEST_F(NewsTest, OfADatasetThatIsHalfThereNobodyIsTold) {
    const StoredFolder library;
    const TinyDataset tiny;
    put(tiny, library.path() / "one.bricks");
    start({library.path()});
    RawStream stream(live_->port());
    ASSERT_TRUE(stream.establish("one", 1));
    const fs::path half = library.path() / "half.bricks";
    fs::create_directories(half);
    fs::copy_file(tiny.folder() / kManifestName, half / kManifestName);
    EXPECT_TRUE(isLeftAlone(stream));
    EXPECT_EQ(live_->get("/v1/datasets/half").status, 404);
    const fs::path frame = Dataset::open(tiny.folder())->manifest().frames(0).file();
    fs::create_directories((half / frame).parent_path());
    fs::copy_file(tiny.folder() / frame, half / frame);
    const auto changed = stream.receive();
    ASSERT_TRUE(changed && changed->header.has_catalog_changed());
    EXPECT_THAT(changed->header.catalog_changed().datasets(), ElementsAre("half", "one"));
}

}  // namespace
}  // namespace brickyard

// Folders of datasets: what comes, goes, is half there, or leads out of them.
#include "server/catalog.h"

#include <gmock/gmock.h>
#include <sys/stat.h>

#include <fstream>
#include <thread>

#include "stored_file.h"
#include "tiny_dataset.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

class CatalogTest : public testing::Test {
protected:
    void open() {
        auto catalog = Catalog::open({library()}, 8, 1u << 20);
        ASSERT_TRUE(catalog) << catalog.error().message;
        catalog_ = std::move(*catalog);
    }
    fs::path library() const { return library_.path() / "served"; }
    fs::path at(const std::string& folder) const { return library() / folder; }
    // Manifest last, as a dataset is made.
    void put(const std::string& folder) const {
        fs::copy(tiny_.folder(), at(folder), fs::copy_options::recursive);
    }
    static fs::path frameOf(const fs::path& dataset) {
        return dataset / Dataset::open(dataset)->manifest().frames(0).file();
    }
    void SetUp() override { fs::create_directories(library()); }

    TinyDataset tiny_;
    StoredFolder library_;
    std::unique_ptr<Catalog> catalog_;
};

TEST_F(CatalogTest, AFolderOfDatasetsMayBeEmptyAtFirst) {
    open();
    EXPECT_THAT(catalog_->names(), IsEmpty());
    EXPECT_EQ(catalog_->dataset("tiny").error().code, ErrorCode::kNotFound);
    put("one.bricks");
    fs::create_directories(at("no-dataset"));
    const auto changes = catalog_->refresh();
    EXPECT_TRUE(changes.names);
    EXPECT_THAT(changes.warnings, IsEmpty());
    EXPECT_THAT(catalog_->names(), ElementsAre("one"));
    EXPECT_TRUE(catalog_->frame("one", 30));
    EXPECT_FALSE(catalog_->refresh().names);
}

TEST_F(CatalogTest, ForgetsWhatIsGoneButNotWhoReadsIt) {
    put("one.bricks");
    open();
    const auto frame = catalog_->frame("one", std::nullopt);
    ASSERT_TRUE(frame);
    EXPECT_NE(catalog_->openedFrame("one", 30), nullptr);
    fs::remove_all(at("one.bricks"));
    const auto changes = catalog_->refresh();
    EXPECT_TRUE(changes.names);
    EXPECT_THAT(changes.datasets, ElementsAre("one"));
    EXPECT_THAT(catalog_->names(), IsEmpty());
    EXPECT_EQ(catalog_->openedFrame("one", 30), nullptr);
    EXPECT_TRUE(frame->reader->block(0, 0));
    EXPECT_EQ(catalog_->counts().datasets, 0u);
    put("one.bricks");
    EXPECT_TRUE(catalog_->refresh().names);
}

// Whoever asks first must not keep the news from the others.
TEST_F(CatalogTest, TellsOfAChangeThatAQuestionNoticedBefore) {
    put("one.bricks");
    open();
    fs::rename(at("one.bricks") / kManifestName, at("manifest"));
    std::this_thread::sleep_for(std::chrono::milliseconds(150));
    EXPECT_FALSE(catalog_->dataset("one"));
    auto changes = catalog_->refresh();
    EXPECT_TRUE(changes.names);
    EXPECT_THAT(changes.datasets, ElementsAre("one"));
    changes = catalog_->refresh();
    EXPECT_FALSE(changes.names);
    EXPECT_THAT(changes.datasets, IsEmpty());
}

TEST_F(CatalogTest, WarnsOnceOfADatasetThatIsHalfThereAndServesItWhenItIsWhole) {
    open();
    fs::create_directories(at("half.bricks") / "frames");
    EXPECT_THAT(catalog_->refresh().warnings, IsEmpty()) << "without a manifest it is no dataset yet";
    fs::copy_file(tiny_.folder() / kManifestName, at("half.bricks") / kManifestName);
    const auto changes = catalog_->refresh();
    ASSERT_THAT(changes.warnings, ElementsAre(HasSubstr("half.bricks")));
    EXPECT_FALSE(changes.names);
    EXPECT_THAT(catalog_->names(), IsEmpty());
    EXPECT_THAT(catalog_->refresh().warnings, IsEmpty()) << "told twice";
    const auto frame = frameOf(tiny_.folder());
    fs::copy_file(frame, at("half.bricks") / frame.lexically_relative(tiny_.folder()));
    EXPECT_TRUE(catalog_->refresh().names) << "what was copied manifest first is never served";
    EXPECT_THAT(catalog_->names(), ElementsAre("half"));
}

TEST_F(CatalogTest, ServesNoLinkOutOfItsFolder) {
    open();
    fs::create_directory_symlink(tiny_.folder(), at("linked.bricks"));
    EXPECT_THAT(catalog_->refresh().warnings, ElementsAre(HasSubstr("is a link out of")));
    EXPECT_THAT(catalog_->refresh().warnings, IsEmpty());
    EXPECT_THAT(catalog_->names(), IsEmpty());
    // A link within the folder is no harm.
    put("one.bricks");
    fs::create_directory_symlink(at("one.bricks"), at("two.bricks"));
    catalog_->refresh();
    EXPECT_THAT(catalog_->names(), ElementsAre("one", "two"));
}

TEST_F(CatalogTest, ServesNoDatasetThatBecameALinkOutOfItsFolder) {
    put("one.bricks");
    open();
    EXPECT_TRUE(catalog_->dataset("one"));
    fs::remove_all(at("one.bricks"));
    fs::create_directory_symlink(tiny_.folder(), at("one.bricks"));
    std::this_thread::sleep_for(std::chrono::milliseconds(150));
    EXPECT_FALSE(catalog_->dataset("one"));
    EXPECT_TRUE(catalog_->refresh().names);
    EXPECT_THAT(catalog_->names(), IsEmpty());
}

TEST_F(CatalogTest, OpensNoFrameThatIsALinkOutOfItsDataset) {
    put("one.bricks");
    open();
    const auto frame = frameOf(at("one.bricks"));
    fs::remove(frame);
    fs::create_symlink(frameOf(tiny_.folder()), frame);
    const auto opened = catalog_->frame("one", 30);
    ASSERT_FALSE(opened);
    EXPECT_THAT(opened.error().message, HasSubstr("is a link out of its dataset"));
}

TEST_F(CatalogTest, OpensNoPipe) {
    put("one.bricks");
    open();
    const auto frame = frameOf(at("one.bricks"));
    fs::remove(frame);
    ASSERT_EQ(::mkfifo(frame.c_str(), 0600), 0);
    const auto opened = catalog_->frame("one", 30);
    ASSERT_FALSE(opened) << "and did not wait for a writer";
    EXPECT_THAT(opened.error().message, HasSubstr("is not a file"));
}

TEST_F(CatalogTest, ServesNoNameThatIsNotUtf8) {
    open();
    put("bad\xff.bricks");
    EXPECT_THAT(catalog_->refresh().warnings, ElementsAre(HasSubstr("bad%FF.bricks")));
    EXPECT_THAT(catalog_->names(), IsEmpty());
    EXPECT_EQ(Catalog::open({at("bad\xff.bricks")}, 8, 1u << 20).error().code, ErrorCode::kInvalid);
}

TEST_F(CatalogTest, TakesTheFirstOfTwoDatasetsOfOneName) {
    const TinyDataset other;
    auto catalog = Catalog::open({other.folder(), library()}, 8, 1u << 20);
    ASSERT_TRUE(catalog);
    put("tiny.bricks");
    EXPECT_THAT((*catalog)->refresh().warnings, ElementsAre(HasSubstr("both datasets would be called tiny")));
    EXPECT_THAT((*catalog)->refresh().warnings, IsEmpty());
    EXPECT_THAT((*catalog)->names(), ElementsAre("tiny"));
}

TEST_F(CatalogTest, KeepsItsLimitOfOpenFrames) {
    for (int i = 0; i < 5; ++i) put(std::to_string(i) + ".bricks");
    auto catalog = Catalog::open({library()}, 2, 1u << 20);
    ASSERT_TRUE(catalog);
    for (int round = 0; round < 2; ++round)
        for (int i = 0; i < 5; ++i) {
            EXPECT_TRUE((*catalog)->frame(std::to_string(i), 30));
            EXPECT_LE((*catalog)->counts().open_frames, 2u);
        }
}

}  // namespace
}  // namespace brickyard

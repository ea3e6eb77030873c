#include "core/dataset_writer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/dataset.h"
#include "frame_fixture.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class DatasetWriterTest : public testing::Test {
protected:
    static Manifest settings(std::uint32_t brick_edge = 8) {
        Manifest manifest;
        manifest.set_format_major(kFormatMajor);
        manifest.set_brick_edge(brick_edge);
        manifest.set_nonfinite("reject");
        return manifest;
    }
    std::unique_ptr<DatasetWriter> open(ExistingDataset existing = ExistingDataset::kContinue) {
        auto writer = DatasetWriter::open(folder_, settings(), existing);
        EXPECT_TRUE(writer) << writer.error().message;
        return writer ? std::move(*writer) : nullptr;
    }
    static void add(DatasetWriter& writer, std::uint32_t frame, double radius = 5) {
        const auto temporary = writer.temporaryFrame(frame);
        ASSERT_TRUE(temporary) << temporary.error().message;
        const auto committed = writer.commitFrame(*temporary, writeBallFrame(*temporary, frame, radius));
        ASSERT_TRUE(committed) << committed.error().message;
    }
    std::string frames() const {
        const auto dataset = Dataset::open(folder_);
        return dataset ? describeFrames(dataset->manifest()) : dataset.error().message;
    }
    std::vector<std::string> listing(const fs::path& folder) const {
        std::vector<std::string> names;
        for (const auto& entry : fs::directory_iterator(folder)) names.push_back(entry.path().filename());
        std::sort(names.begin(), names.end());
        return names;
    }

    ScratchFolder scratch_;
    fs::path folder_ = scratch_ / "ball.bricks";
};

TEST_F(DatasetWriterTest, ANewDatasetHasNoFramesAndGoesAwayUnused) {
    {
        const auto writer = open();
        EXPECT_EQ(frames(), "none");
    }
    EXPECT_FALSE(fs::exists(folder_));
    EXPECT_TRUE(listing(scratch_.path()).empty());
}

TEST_F(DatasetWriterTest, FramesAreListedInOrderHoweverTheyCome) {
    {
        const auto writer = open();
        for (const std::uint32_t frame : {7u, 2u, 40u, 3u}) add(*writer, frame);
        ASSERT_TRUE(writer->finish());
    }
    EXPECT_EQ(frames(), "2-3, 7, 40");
    const auto dataset = Dataset::open(folder_);
    ASSERT_TRUE(dataset);
    for (const std::uint32_t frame : {2u, 3u, 7u, 40u}) EXPECT_TRUE(dataset->openFrame(frame));
    const auto missing = dataset->openFrame(5);
    ASSERT_FALSE(missing);
    EXPECT_THAT(missing.error().message, HasSubstr("2-3, 7, 40"));
}

TEST_F(DatasetWriterTest, AnUncommittedFrameLeavesNothing) {
    {
        const auto writer = open();
        add(*writer, 1);
        const auto temporary = writer->temporaryFrame(2);
        ASSERT_TRUE(temporary);
        writeBallFrame(*temporary, 2, 5);
    }
    EXPECT_EQ(frames(), "1");
    EXPECT_EQ(listing(folder_ / "frames"), std::vector<std::string>{"000001.brk"});
}

TEST_F(DatasetWriterTest, AReplacedFrameIsReadableThroughTheOldManifestAndTheNew) {
    const auto writer = open();
    add(*writer, 1, 4);
    const auto before = Dataset::open(folder_);
    const auto old_store = before->openFrame(1);
    ASSERT_TRUE(old_store);
    add(*writer, 1, 6);
    EXPECT_TRUE((*old_store)->readBlock(0, 0)) << "an open frame outlives its replacement";
    const auto after = Dataset::open(folder_)->openFrame(1);
    ASSERT_TRUE(after) << after.error().message;
    EXPECT_EQ((*after)->footer().channels(0).active_voxels(), BallField(6).info().active_voxels);
    EXPECT_EQ(listing(folder_ / "frames"), std::vector<std::string>{"000001.1.brk"});
}

TEST_F(DatasetWriterTest, LitterIsRemovedAndWhatALivingWriterHoldsIsNot) {
    const auto living = open();
    add(*living, 1);
    const auto held = living->temporaryFrame(2);
    ASSERT_TRUE(held);
    writeFile(folder_ / "frames" / ".tmp-000003-1-1", "left by a killed writer");
    writeFile(folder_ / "frames" / "000009.brk", "renamed, but never listed");
    writeFile(folder_ / ".tmp-manifest-1-1", "{");
    const auto second = open();
    EXPECT_EQ(listing(folder_ / "frames"), (std::vector<std::string>{held->filename(), "000001.brk"}));
    EXPECT_EQ(listing(folder_), (std::vector<std::string>{".claim-2", "frames", "manifest.json"}));
    ASSERT_TRUE(living->commitFrame(*held, writeBallFrame(*held, 2, 5)));
    EXPECT_EQ(frames(), "1-2");
}

TEST_F(DatasetWriterTest, TwoWritersLoseNothingOfEachOther) {
    const auto one = open(), two = open();
    for (std::uint32_t frame = 0; frame < 10; ++frame) add(frame % 2 ? *one : *two, frame);
    EXPECT_EQ(frames(), "0-9");
}

// As if a writer had been killed between its claim and the rename, or had been so slow that its rename came
// last.
TEST_F(DatasetWriterTest, AClaimedManifestIsTheDatasetsEvenIfItIsNotSeenYet) {
    add(*open(), 1);
    const std::string old = readFile(folder_ / "manifest.json");
    add(*open(), 2);
    add(*open(), 3);
    fs::remove(folder_ / "manifest.json");
    writeFile(folder_ / "manifest.json", old);
    EXPECT_EQ(frames(), "1");
    add(*open(), 4);
    EXPECT_EQ(frames(), "1-4");
}

TEST_F(DatasetWriterTest, LitterOfAnotherMachineStaysForADay) {
    add(*open(), 1);
    const fs::path foreign = folder_ / "frames" / ".tmp-000003-1-1@elsewhere";
    writeFile(foreign, "perhaps alive");
    open();
    EXPECT_TRUE(fs::exists(foreign));
    fs::last_write_time(foreign, fs::file_time_type::clock::now() - std::chrono::hours(25));
    open();
    EXPECT_FALSE(fs::exists(foreign));
}

// A frame that another machine has named and is about to list.
TEST_F(DatasetWriterTest, AFrameWithItsTemporaryNameIsNoLitter) {
    add(*open(), 1);
    const fs::path foreign = folder_ / "frames" / ".tmp-000003-1-1@elsewhere";
    writeFile(foreign, "a frame");
    fs::create_hard_link(foreign, folder_ / "frames" / "000003.brk");
    const auto writer = open();
    EXPECT_TRUE(fs::exists(folder_ / "frames" / "000003.brk"));
    add(*writer, 3);
    EXPECT_EQ(readFile(folder_ / "frames" / "000003.brk"), "a frame");
    EXPECT_TRUE(Dataset::open(folder_)->openFrame(3));
}

TEST_F(DatasetWriterTest, AWriterThatFailsKeepsTheFramesOfAnother) {
    auto creator = open();
    const auto other = open();
    add(*other, 3);
    creator.reset();
    EXPECT_EQ(frames(), "3");
}

TEST_F(DatasetWriterTest, OverwritingShowsTheOldDatasetUntilItIsFinished) {
    add(*open(), 1, 4);
    {
        const auto writer = open(ExistingDataset::kOverwrite);
        add(*writer, 2, 6);
        EXPECT_EQ(frames(), "1");
        ASSERT_TRUE(writer->finish());
        EXPECT_EQ(frames(), "2");
    }
    EXPECT_EQ(frames(), "2");
    EXPECT_EQ(listing(scratch_.path()), std::vector<std::string>{"ball.bricks"});
}

TEST_F(DatasetWriterTest, AnOverwriteThatFailsLeavesTheOldDataset) {
    add(*open(), 1, 4);
    add(*open(ExistingDataset::kOverwrite), 2, 6);
    EXPECT_EQ(frames(), "1");
    EXPECT_EQ(listing(scratch_.path()), std::vector<std::string>{"ball.bricks"});
}

TEST_F(DatasetWriterTest, StaleFoldersBesideItAreRemovedAndLivingOnesStay) {
    add(*open(), 1, 4);
    const auto living = open(ExistingDataset::kOverwrite);
    fs::create_directories(scratch_ / "ball.bricks.tmp-1-1/frames");
    fs::create_directories(scratch_ / "ball.bricks.previous-1-1/frames");
    fs::create_directories(scratch_ / "another.bricks.tmp-1-1");
    const auto writer = open();
    EXPECT_EQ(listing(scratch_.path()).size(), 3u)
        << "the dataset, what is being built, and what is not ours";
    EXPECT_TRUE(fs::exists(scratch_ / "another.bricks.tmp-1-1"));
    add(*living, 5);
    ASSERT_TRUE(living->finish());
    EXPECT_EQ(frames(), "5");
}

TEST_F(DatasetWriterTest, AnInterruptedExchangeIsUndoneAtTheNextOpen) {
    add(*open(), 1, 4);
    fs::rename(folder_, scratch_ / "ball.bricks.previous-1-1");
    open();
    EXPECT_EQ(frames(), "1");
}

TEST_F(DatasetWriterTest, OtherSettingsAreRefusedByName) {
    add(*open(), 1);
    const auto writer = DatasetWriter::open(folder_, settings(16), ExistingDataset::kAppend);
    ASSERT_FALSE(writer);
    EXPECT_EQ(writer.error().code, ErrorCode::kInvalid);
    EXPECT_THAT(writer.error().message, HasSubstr("--brick 8, not 16"));
    EXPECT_THAT(writer.error().message, HasSubstr("--overwrite"));
}

TEST_F(DatasetWriterTest, AFolderOfSomebodyElseIsNeverTouched) {
    fs::create_directory(folder_);
    writeFile(folder_ / "thesis.tex", "years of work");
    for (const auto existing :
         {ExistingDataset::kContinue, ExistingDataset::kAppend, ExistingDataset::kOverwrite}) {
        const auto writer = DatasetWriter::open(folder_, settings(), existing);
        ASSERT_FALSE(writer);
        EXPECT_THAT(writer.error().message, HasSubstr("is no dataset"));
    }
    EXPECT_EQ(readFile(folder_ / "thesis.tex"), "years of work");
    writeFile(scratch_ / "file", "x");
    EXPECT_FALSE(DatasetWriter::open(scratch_ / "file", settings(), ExistingDataset::kOverwrite));
    EXPECT_FALSE(DatasetWriter::open(scratch_ / "no/such/parent", settings(), ExistingDataset::kContinue));
}

TEST_F(DatasetWriterTest, AnEmptyFolderBecomesTheDataset) {
    fs::create_directory(folder_);
    add(*open(), 1);
    EXPECT_EQ(frames(), "1");
}

class ManifestTest : public DatasetWriterTest {
protected:
    ManifestTest() {
        add(*open(), 1);
        text_ = readFile(folder_ / kManifestName);
    }
    std::string text_;
};

TEST_F(ManifestTest, ReadsWhatItPrints) {
    const auto manifest = parseManifest(text_, "here");
    ASSERT_TRUE(manifest) << manifest.error().message;
    EXPECT_EQ(printManifest(*manifest), text_);
}

TEST_F(ManifestTest, EveryFlippedBitIsRefusedOrLosesTheChecksum) {
    for (std::size_t at = 0; at < text_.size(); ++at)
        for (int bit = 0; bit < 8; ++bit) {
            std::string changed = text_;
            changed[at] = char(changed[at] ^ (1 << bit));
            const auto manifest = parseManifest(changed, "here");
            EXPECT_TRUE(!manifest || manifest->checksum().empty())
                << "bit " << bit << " of byte " << at << " went unnoticed";
            if (!manifest)
                EXPECT_EQ(manifest.error().message.find('\n'), std::string::npos) << manifest.error().message;
        }
}

TEST_F(ManifestTest, APersonMayEditItAndRemoveTheChecksum) {
    Manifest manifest = *parseManifest(text_, "here");
    std::string edited = text_;
    const std::size_t digits = edited.find(manifest.checksum());
    ASSERT_NE(digits, std::string::npos);
    edited.erase(digits, manifest.checksum().size());
    EXPECT_TRUE(parseManifest(edited, "here"));
}

TEST_F(ManifestTest, RefusesWhatCannotBe) {
    const auto refused = [&](ErrorCode code, const std::function<void(Manifest&)>& change) {
        Manifest manifest = *parseManifest(text_, "here");
        change(manifest);
        const auto parsed = parseManifest(printManifest(manifest), "here");
        ASSERT_FALSE(parsed);
        EXPECT_EQ(parsed.error().code, code);
        EXPECT_THAT(parsed.error().message, HasSubstr("here"));
    };
    refused(ErrorCode::kTooNew, [](Manifest& m) { m.set_format_major(kFormatMajor + 1); });
    refused(ErrorCode::kCorrupt, [](Manifest& m) { m.set_format_major(0); });
    refused(ErrorCode::kCorrupt, [](Manifest& m) { m.set_brick_edge(7); });
    refused(ErrorCode::kCorrupt, [](Manifest& m) { *m.add_frames() = m.frames(0); });
    for (const char* file : {"", "/etc/passwd", "../x.brk", "frames/../../x", "frames/./x", "frames/"})
        refused(ErrorCode::kCorrupt, [&](Manifest& m) { m.mutable_frames(0)->set_file(file); });
}

TEST_F(ManifestTest, AFrameFileOfAnotherDatasetIsRefused) {
    const FrameEntry entry = Dataset::open(folder_)->manifest().frames(0);
    writeBallFrame(folder_ / entry.file(), 1, 7);
    const auto frame = Dataset::open(folder_)->openFrame(1);
    ASSERT_FALSE(frame);
    EXPECT_EQ(frame.error().code, ErrorCode::kCorrupt);
}

TEST(DatasetTest, SaysWhatIsNotADataset) {
    const ScratchFolder scratch;
    for (const std::filesystem::path& path : {scratch / "missing", scratch.path()}) {
        const auto dataset = Dataset::open(path);
        ASSERT_FALSE(dataset);
        EXPECT_EQ(dataset.error().code, ErrorCode::kNotFound);
        EXPECT_THAT(dataset.error().message, HasSubstr(path.string()));
    }
}

}  // namespace
}  // namespace brickyard

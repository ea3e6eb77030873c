#include "core/brick_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/frame_format.h"
#include "frame_fixture.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

class BrickStoreTest : public testing::Test {
protected:
    BrickStoreTest() {
        entry_ = writeBallFrame(file_, 1, 4);
        frame_ = readFile(file_);
    }
    Result<std::shared_ptr<const BrickStore>> openChanged(const std::string& bytes) {
        writeFile(changed_, bytes);
        return BrickStore::open(changed_);
    }

    ScratchFolder scratch_;
    std::filesystem::path file_ = scratch_ / "ball.brk", changed_ = scratch_ / "changed.brk";
    FrameEntry entry_;
    std::string frame_;
};

TEST_F(BrickStoreTest, GivesBackWhatTheWriterSaid) {
    const auto store = BrickStore::open(file_);
    ASSERT_TRUE(store) << store.error().message;
    EXPECT_EQ((*store)->fileBytes(), entry_.file_bytes());
    EXPECT_EQ((*store)->footerChecksum(), entry_.footer_xxh64());
    ASSERT_EQ((*store)->footer().channels_size(), 1);
    EXPECT_EQ((*store)->footer().channels(0).name(), "density");
    EXPECT_EQ((*store)->footer().channels(0).active_voxels(), BallField(4).info().active_voxels);
    const auto block = (*store)->loadBlock(0, 0);
    ASSERT_TRUE(block) << block.error().message;
    ASSERT_TRUE(block->record(0).hasBrick());
    EXPECT_TRUE((*store)->readPayload(block->record(0), "the root"));
}

TEST_F(BrickStoreTest, RefusesEveryTruncation) {
    writeFile(changed_, frame_);
    for (std::size_t size = frame_.size(); size-- > 0;) {
        std::filesystem::resize_file(changed_, size);
        const auto store = BrickStore::open(changed_);
        ASSERT_FALSE(store) << "accepted the first " << size << " of " << frame_.size() << " bytes";
        EXPECT_THAT(store.error().message, HasSubstr(changed_.string()));
        EXPECT_EQ(store.error().message.find('\n'), std::string::npos);
    }
}

TEST_F(BrickStoreTest, RefusesAnyFlippedBitOfFooterAndTrailerButTheVersion) {
    const auto trailer =
        frame_format::decodeTrailer(std::as_bytes(std::span(frame_)).last<frame_format::kTrailerBytes>());
    ASSERT_TRUE(trailer);
    const std::size_t version = frame_.size() - frame_format::kTrailerBytes + 12;
    for (std::size_t at = trailer->footer_offset; at < frame_.size(); ++at)
        for (int bit = 0; bit < 8; ++bit) {
            if (at >= version && at < version + 4) continue;
            std::string changed = frame_;
            changed[at] = char(changed[at] ^ (1 << bit));
            ASSERT_FALSE(openChanged(changed))
                << "bit " << bit << " of byte " << at << " of " << frame_.size();
        }
}

TEST_F(BrickStoreTest, SaysThatANewerMajorVersionIsTooNew) {
    std::string changed = frame_;
    changed[frame_.size() - frame_format::kTrailerBytes + 12] = char(kFormatMajor + 1);
    const auto store = openChanged(changed);
    ASSERT_FALSE(store);
    EXPECT_EQ(store.error().code, ErrorCode::kTooNew);
    EXPECT_THAT(store.error().message, HasSubstr("2.0"));
}

// A footer that says `change` and has a checksum to match: what a hostile writer would make.
TEST_F(BrickStoreTest, RefusesFootersThatCannotBe) {
    const auto original = BrickStore::open(file_);
    ASSERT_TRUE(original);
    const auto refused = [&](const char* what, const std::function<void(FrameFooter&)>& change) {
        FrameFooter footer = (*original)->footer();
        change(footer);
        auto writer = FrameWriter::create(changed_);
        ASSERT_TRUE(writer);
        const std::string filler(frame_.size(), 'x');
        ASSERT_TRUE((*writer)->append(std::as_bytes(std::span(filler))));
        ASSERT_TRUE((*writer)->finish(footer));
        const auto store = BrickStore::open(changed_);
        EXPECT_FALSE(store) << what;
        if (!store) EXPECT_EQ(store.error().code, ErrorCode::kCorrupt) << what;
    };
    const auto channel = [](FrameFooter& footer) { return footer.mutable_channels(0); };
    refused("brick edge", [](FrameFooter& f) { f.set_brick_edge(12); });
    refused("coarse_begin", [](FrameFooter& f) { f.set_coarse_begin(UINT64_MAX); });
    refused("twins", [](FrameFooter& f) { *f.add_channels() = f.channels(0); });
    refused("components", [&](FrameFooter& f) { channel(f)->set_components(2); });
    refused("background", [&](FrameFooter& f) { channel(f)->add_background(0); });
    refused("transform", [&](FrameFooter& f) { channel(f)->set_index_to_world(0, NAN); });
    refused("short transform", [&](FrameFooter& f) { channel(f)->mutable_index_to_world()->RemoveLast(); });
    refused("box", [&](FrameFooter& f) { channel(f)->set_active_min(0, channel(f)->active_max(0) + 1); });
    refused("block offset", [&](FrameFooter& f) { channel(f)->mutable_blocks(0)->set_offset(UINT64_MAX); });
    refused("block bytes", [&](FrameFooter& f) { channel(f)->mutable_blocks(0)->set_bytes(UINT32_MAX); });
    refused("raw bytes",
            [&](FrameFooter& f) { channel(f)->mutable_blocks(0)->set_raw_bytes(kMaxBlockRawBytes + 1); });
    refused("root level", [&](FrameFooter& f) { channel(f)->mutable_roots(0)->set_level(77); });
    refused("far root", [&](FrameFooter& f) { channel(f)->mutable_roots(0)->set_x(INT32_MAX); });
    refused("no blocks", [&](FrameFooter& f) { channel(f)->clear_blocks(); });
    refused("many roots", [&](FrameFooter& f) {
        while (channel(f)->roots_size() <= 8)
            channel(f)->mutable_roots()->Add()->CopyFrom(channel(f)->roots(0));
    });
}

TEST_F(BrickStoreTest, NamesFileNodeAndBytesOfADamagedPayload) {
    auto store = BrickStore::open(file_);
    ASSERT_TRUE(store);
    const NodeRecord record = (*store)->loadBlock(0, 0)->record(0);
    std::string changed = frame_;
    changed[record.payload_offset] = char(~changed[record.payload_offset]);
    store = openChanged(changed);
    ASSERT_TRUE(store) << "payloads are checked when they are read";
    const auto payload = (*store)->readPayload(record, "density L1(0,0,0)");
    ASSERT_FALSE(payload);
    EXPECT_THAT(payload.error().message, HasSubstr(changed_.string()));
    EXPECT_THAT(payload.error().message, HasSubstr("density L1(0,0,0)"));
    EXPECT_THAT(payload.error().message, HasSubstr(std::to_string(record.payload_offset)));
}

TEST_F(BrickStoreTest, ReadsNothingOutsideTheFile) {
    const auto store = BrickStore::open(file_);
    ASSERT_TRUE(store);
    NodeRecord record;
    record.payload_bytes = 2;
    for (const std::uint64_t offset :
         {std::uint64_t(frame_.size() - 1), std::uint64_t(frame_.size() + 1), UINT64_MAX}) {
        record.payload_offset = offset;
        const auto payload = (*store)->readPayloadUnchecked(record);
        ASSERT_FALSE(payload);
        EXPECT_EQ(payload.error().code, ErrorCode::kCorrupt);
    }
    EXPECT_FALSE((*store)->readBlock(0, 1000));
    EXPECT_FALSE((*store)->readBlock(1, 0));
}

TEST(BrickStore, SaysThatAFileIsNotThere) {
    const auto store = BrickStore::open("/nonexistent/frame.brk");
    ASSERT_FALSE(store);
    EXPECT_EQ(store.error().code, ErrorCode::kNotFound);
}

}  // namespace
}  // namespace brickyard

#include "core/wish_walk.h"

#include <gtest/gtest.h>

#include <map>

#include "core/dataset.h"
#include "tiny_dataset.h"

namespace brickyard {
namespace {

class WishWalkTest : public testing::Test {
protected:
    void SetUp() override {
        frame_ = std::make_shared<const FrameReader>(tiny_.store(), blocks_);
        bricks_ = tiny_.bricks(0);
    }

    PageWish listOf(std::size_t begin, std::size_t end, std::uint64_t credit) const {
        PageWish wish;
        wish.credit_bytes = credit;
        for (std::size_t i = begin; i < end; ++i) wish.pages.push_back({false, bricks_[i]});
        return wish;
    }
    PageWish viewOf(std::vector<std::uint32_t> channels, std::uint64_t credit) const {
        PageWish wish;
        wish.credit_bytes = credit;
        CameraView& view = wish.views.emplace_back();
        for (const double x : {16.0, 16.0, 100.0}) view.camera.add_eye(x);
        for (const double x : {16.0, 16.0, 16.0}) view.camera.add_target(x);
        view.width = view.height = 4096;
        view.channels = std::move(channels);
        return wish;
    }
    static std::vector<WishWalk::Step> walk(WishWalk& walk) {
        std::vector<WishWalk::Step> steps;
        while (auto step = walk.next()) steps.push_back(std::move(*step));
        return steps;
    }

    TinyDataset tiny_;
    std::shared_ptr<BlockCache> blocks_ = std::make_shared<BlockCache>(1u << 20);
    std::shared_ptr<const FrameReader> frame_;
    std::vector<PageAddress> bricks_;
};

TEST_F(WishWalkTest, GivesAListInItsOrderWithTheStoredBytes) {
    PageWish wish = listOf(0, 5, 1u << 20);
    std::reverse(wish.pages.begin(), wish.pages.end());
    auto walked = WishWalk::create(frame_, wish);
    const auto steps = walk(*walked);
    ASSERT_EQ(steps.size(), 5u);
    for (std::size_t i = 0; i < 5; ++i) {
        EXPECT_EQ(steps[i].page.address, bricks_[4 - i]);
        EXPECT_EQ(steps[i].bytes.value(), tiny_.payload(bricks_[4 - i]));
    }
    EXPECT_FALSE(walked->creditExhausted());
    EXPECT_EQ(walked->sentBytes(), 5u * 96);
}

TEST_F(WishWalkTest, StopsBeforeThePageThatExceedsItsCredit) {
    for (const auto& [credit, pages] :
         std::map<std::uint64_t, std::size_t>{{0, 0}, {95, 0}, {96, 1}, {287, 2}, {288, 3}}) {
        auto walked = WishWalk::create(frame_, listOf(0, 3, credit));
        EXPECT_EQ(walk(*walked).size(), pages) << credit;
        EXPECT_EQ(walked->creditExhausted(), pages < 3) << credit;
        EXPECT_LE(walked->sentBytes(), credit);
    }
}

TEST_F(WishWalkTest, SaysOfEachUnknownPageThatItIsNotThereAndGoesOn) {
    PageWish wish = listOf(0, 1, 1u << 20);
    wish.pages.insert(wish.pages.begin(),
                      {{false, {9, 0, 0}}, {false, {0, 99, 0}}, {false, {0, 0, 99999}}, {true, {0, 7, 0}}});
    auto walked = WishWalk::create(frame_, wish);
    const auto steps = walk(*walked);
    ASSERT_EQ(steps.size(), 5u);
    for (std::size_t i = 0; i < 4; ++i) {
        ASSERT_FALSE(steps[i].bytes) << i;
        EXPECT_EQ(steps[i].bytes.error().code, ErrorCode::kNotFound) << i;
    }
    EXPECT_TRUE(steps[4].bytes);
}

TEST_F(WishWalkTest, ANodeOfOneValueHasNoPage) {
    const auto block = *frame_->block(0, 0);
    for (std::uint32_t n = 0; n < block->nodeCount(); ++n)
        if (!block->record(n).hasBrick()) {
            const auto found = frame_->findBrick({0, 0, n});
            ASSERT_FALSE(found);
            EXPECT_EQ(found.error().code, ErrorCode::kNotFound);
            return;
        }
    FAIL() << "the dataset has no such node";
}

TEST_F(WishWalkTest, AViewBringsTwoChannelsSideBySide) {
    auto walked = WishWalk::create(frame_, viewOf({0, 1}, 1u << 20));
    const auto steps = walk(*walked);
    EXPECT_EQ(steps.size(), 2 * (bricks_.size() + tiny_.blockCount(0)));
    int ahead = 0;
    for (const auto& step : steps) {
        ahead += step.page.address.channel == 0 ? 1 : -1;
        EXPECT_LE(std::abs(ahead), 1);
    }
    EXPECT_FALSE(walked->creditExhausted());
}

TEST_F(WishWalkTest, AViewKeepsItsCredit) {
    auto all = WishWalk::create(frame_, viewOf({0}, 1u << 20));
    walk(*all);
    for (const std::uint64_t credit : {std::uint64_t(0), std::uint64_t(500), all->sentBytes() - 1}) {
        auto walked = WishWalk::create(frame_, viewOf({0}, credit));
        walk(*walked);
        EXPECT_TRUE(walked->creditExhausted()) << credit;
        EXPECT_LE(walked->sentBytes(), credit);
    }
    auto exact = WishWalk::create(frame_, viewOf({0}, all->sentBytes()));
    walk(*exact);
    EXPECT_FALSE(exact->creditExhausted());
}

TEST_F(WishWalkTest, AViewDoesNotRepeatTheList) {
    PageWish wish = viewOf({0}, 1u << 20);
    wish.pages = {{true, {0, 0, 0}}, {false, bricks_[0]}};
    auto walked = WishWalk::create(frame_, wish);
    EXPECT_EQ(walk(*walked).size(), bricks_.size() + tiny_.blockCount(0));
}

TEST_F(WishWalkTest, RefusesAViewThatCannotBe) {
    EXPECT_FALSE(WishWalk::create(frame_, viewOf({0, 2}, 1u << 20)));
    PageWish wish = viewOf({0}, 1u << 20);
    wish.views[0].camera.clear_eye();
    EXPECT_FALSE(WishWalk::create(frame_, wish));
}

TEST_F(WishWalkTest, ACacheOfBlocksKeepsItsBudget) {
    const auto block = *frame_->block(0, 0);
    BlockCache cache(block->memoryBytes() * 2);
    for (std::uint64_t id = 0; id < 3; ++id) {
        cache.insert({id, 0, 0}, block);
        cache.find({0, 0, 0});  // used again, so that another one goes
        EXPECT_LE(cache.usedBytes(), block->memoryBytes() * 2);
    }
    EXPECT_TRUE(cache.find({0, 0, 0}));
    EXPECT_FALSE(cache.find({1, 0, 0}));
    EXPECT_TRUE(cache.find({2, 0, 0}));
}

}  // namespace
}  // namespace brickyard

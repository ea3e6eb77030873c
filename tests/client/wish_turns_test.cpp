// Several sources on one connection: who is served when, and with what.
#include "client/wish_turns.h"

#include <gmock/gmock.h>

namespace brickyard {
namespace {

class WishTurnsTest : public testing::Test {
protected:
    WishTurnsTest() {
        for (DatasetStream* stream : {&a_, &b_, &c_}) {
            stream->dataset_id = 1;
            stream->frame = 30;
            stream->frame_open = true;
        }
    }
    // Wishes bricks [0, pages) of 1024 bytes.
    void wish(DatasetStream& stream, std::uint32_t pages, std::uint64_t credit = 1u << 30) {
        PageWish list;
        for (std::uint32_t i = 0; i < pages; ++i) list.pages.push_back({false, {0, 0, i}});
        enter(stream, list, credit);
    }
    void enter(DatasetStream& stream, const PageWish& list, std::uint64_t credit) {
        stream.forgetWish();
        stream.wanted = wishMessage(list);
        stream.done = false;
        stream.credit_granted = stream.credit_left = credit;
        turns_.enter(stream);
    }
    // The server sends the first so many pages of a wish.
    void arrive(const Wish& wish, int pages, std::uint64_t bytes = 1024) {
        DatasetStream* owner = turns_.ownerOf(wish.epoch());
        ASSERT_TRUE(owner);
        for (int i = 0; i < pages; ++i) {
            owner->had.insert({false, {0, 0, wish.pages(i).node()}});
            owner->credit_left -= bytes;
        }
    }

    DatasetStream a_{"a", {}}, b_{"b", {}}, c_{"c", {}};
    WishTurns turns_;
};

TEST_F(WishTurnsTest, AloneAWishIsSentWhole) {
    wish(a_, 10'000);
    const auto sent = turns_.next();
    ASSERT_TRUE(sent);
    EXPECT_EQ(sent->pages_size(), 10'000);
    EXPECT_EQ(sent->credit_bytes(), 1u << 30);
    EXPECT_FALSE(turns_.next()) << "nothing else is to be sent";
    arrive(*sent, 10'000);
    EXPECT_TRUE(turns_.finish(sent->epoch(), false));
}

TEST_F(WishTurnsTest, TheNewestWishOfASourceReplacesItsOlder) {
    wish(a_, 5);
    const auto old = turns_.next();
    wish(a_, 3);
    const auto newer = turns_.next();
    ASSERT_TRUE(newer);
    EXPECT_GT(newer->epoch(), old->epoch());
    EXPECT_EQ(newer->pages_size(), 3);
    EXPECT_FALSE(turns_.finish(old->epoch(), false)) << "of a wish that was replaced";
    EXPECT_TRUE(turns_.finish(newer->epoch(), false));
}

TEST_F(WishTurnsTest, ANewcomerIsServedAtOnceAndTheOtherGoesOnWhereItWas) {
    wish(a_, 10'000);
    const auto first = turns_.next();
    arrive(*first, 4'000);
    wish(b_, 10);
    const auto second = turns_.next();
    ASSERT_TRUE(second);
    EXPECT_EQ(second->pages_size(), 10);
    // What was on the way still arrives, for whom it was wished.
    EXPECT_EQ(turns_.ownerOf(first->epoch()), &a_);
    arrive(*first, 4'100);
    arrive(*second, 10);
    EXPECT_TRUE(turns_.finish(second->epoch(), false));
    const auto third = turns_.next();
    ASSERT_TRUE(third);
    EXPECT_EQ(third->pages_size(), 5'900);
    EXPECT_EQ(third->pages(0).node(), 4'100u);
    EXPECT_EQ(turns_.ownerOf(third->epoch()), &a_);
}

TEST_F(WishTurnsTest, LongWishesTakeTurnsBySlices) {
    wish(a_, 3'000);
    wish(b_, 3'000);
    std::uint64_t left[2] = {3'000, 3'000};
    int turns = 0;
    bool done[2] = {};
    while (!(done[0] && done[1]) && turns < 20) {
        const auto sent = turns_.next();
        ASSERT_TRUE(sent);
        DatasetStream* owner = turns_.ownerOf(sent->epoch());
        const int which = owner == &b_;
        if (!done[!which]) EXPECT_LE(sent->credit_bytes(), WishTurns::kTurnBytes);
        const int fit = int(std::min<std::uint64_t>(sent->credit_bytes() / 1024, sent->pages_size()));
        arrive(*sent, fit);
        left[which] -= std::uint64_t(fit);
        done[which] = turns_.finish(sent->epoch(), fit < sent->pages_size());
        EXPECT_EQ(done[which], left[which] == 0);
        ++turns;
    }
    EXPECT_TRUE(done[0] && done[1]);
    EXPECT_GE(turns, 5);
}

TEST_F(WishTurnsTest, TheCreditOfAWishIsKeptOverItsTurns) {
    wish(a_, 3'000, 1'500 * 1024);
    wish(b_, 10);
    const auto first = turns_.next();
    arrive(*first, 1'024);
    EXPECT_FALSE(turns_.finish(first->epoch(), true));
    const auto other = turns_.next();
    arrive(*other, 10);
    EXPECT_TRUE(turns_.finish(other->epoch(), false));
    const auto rest = turns_.next();
    ASSERT_TRUE(rest);
    EXPECT_EQ(rest->credit_bytes(), (1'500u - 1'024u) * 1024u);
    EXPECT_TRUE(turns_.finish(rest->epoch(), true));
}

TEST_F(WishTurnsTest, APageLargerThanASliceComesAllTheSame) {
    wish(a_, 4);
    wish(b_, 4);
    const auto slice = turns_.next();
    EXPECT_FALSE(turns_.finish(slice->epoch(), true)) << "nothing came: the page did not fit";
    const auto other = turns_.next();
    arrive(*other, 4);
    EXPECT_TRUE(turns_.finish(other->epoch(), false));
    wish(b_, 4);
    wish(c_, 4);
    const auto whole = turns_.next();
    ASSERT_TRUE(whole);
    EXPECT_EQ(turns_.ownerOf(whole->epoch()), &a_);
    EXPECT_GT(whole->credit_bytes(), WishTurns::kTurnBytes);
    wish(c_, 5);
    EXPECT_FALSE(turns_.next()) << "it is left alone until it is done";
}

TEST_F(WishTurnsTest, ACameraIsLeftAlone) {
    PageWish seen;
    CameraView& view = seen.views.emplace_back();
    view.width = view.height = 10;
    enter(a_, seen, 1u << 30);
    const auto first = turns_.next();
    wish(b_, 3);
    EXPECT_FALSE(turns_.next());
    EXPECT_TRUE(turns_.finish(first->epoch(), false));
    EXPECT_TRUE(turns_.next());
}

TEST_F(WishTurnsTest, WhoLeavesIsForgotten) {
    wish(a_, 10);
    const auto first = turns_.next();
    wish(b_, 3);
    EXPECT_FALSE(turns_.leave(a_));
    EXPECT_EQ(turns_.ownerOf(first->epoch()), nullptr);
    const auto second = turns_.next();
    EXPECT_EQ(turns_.ownerOf(second->epoch()), &b_);
    EXPECT_TRUE(turns_.leave(b_)) << "its wish is at the server with nobody behind it";
    EXPECT_FALSE(turns_.next());
}

TEST_F(WishTurnsTest, ANewConnectionBeginsWithWhatWasAtTheServer) {
    wish(a_, 10);
    const auto first = turns_.next();
    arrive(*first, 4);
    a_.frame_open = b_.frame_open = false;
    turns_.restart();
    EXPECT_FALSE(turns_.next()) << "no frame is open yet";
    wish(b_, 3);
    a_.frame_open = b_.frame_open = true;
    const auto again = turns_.next();
    ASSERT_TRUE(again);
    EXPECT_EQ(again->pages_size(), 6);
    EXPECT_GT(again->epoch(), first->epoch());
    EXPECT_EQ(turns_.ownerOf(again->epoch()), &a_);
}

}  // namespace
}  // namespace brickyard

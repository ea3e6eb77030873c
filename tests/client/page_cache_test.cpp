#include "client/page_cache.h"

#include <gtest/gtest.h>

#include <thread>
#include <vector>

namespace brickyard {
namespace {

constexpr std::size_t kFloats = 27;
constexpr std::uint64_t kPageBytes = kFloats * sizeof(float);

class PageCacheTest : public testing::Test {
protected:
    static PageAddress page(std::uint32_t node) { return {0, 0, node}; }
    float* insert(std::uint32_t node) {
        float* slot = cache.insert(page(node));
        if (slot) std::fill_n(slot, kFloats, float(node));
        return slot;
    }
    PageCache cache{4 * kPageBytes + 5, kFloats};
};

TEST_F(PageCacheTest, HoldsWhatFitsAndNeverMore) {
    for (std::uint32_t node = 0; node < 100; ++node) {
        cache.beginPass();
        ASSERT_TRUE(insert(node));
        EXPECT_LE(cache.size(), 4u);
        EXPECT_LE(cache.peakBytes(), 4 * kPageBytes + 5);
        EXPECT_EQ(cache.find(page(node))[0], float(node));
    }
    EXPECT_EQ(cache.counters().evictions, 96u);
}

TEST_F(PageCacheTest, EvictsWhatNoRayUsedLongest) {
    for (std::uint32_t node = 0; node < 4; ++node) insert(node);
    cache.beginPass();  // an arrival counts as used in the pass it came for
    cache.beginPass();
    for (const std::uint32_t node : {0u, 1u, 3u}) EXPECT_TRUE(cache.find(page(node)));
    insert(4);
    EXPECT_FALSE(cache.contains(page(2)));
    cache.beginPass();
    for (const std::uint32_t node : {1u, 3u, 4u}) cache.find(page(node));
    insert(5);
    EXPECT_FALSE(cache.contains(page(0)));
}

TEST_F(PageCacheTest, WhatArrivedInThisPassIsNotEvictedByWhatArrivesNext) {
    for (std::uint32_t node = 0; node < 4; ++node) ASSERT_TRUE(insert(node));
    EXPECT_FALSE(insert(4)) << "all four slots were filled since the pass began";
    cache.beginPass();
    EXPECT_TRUE(insert(4));
}

TEST_F(PageCacheTest, PinnedPagesStayButNeverTakeMoreThanHalf) {
    for (std::uint32_t node = 0; node < 4; ++node) insert(node);
    for (std::uint32_t node = 0; node < 4; ++node) cache.pin(page(node));
    EXPECT_EQ(cache.room(), 2u);
    for (std::uint32_t node = 10; node < 30; ++node) {
        cache.beginPass();
        ASSERT_TRUE(insert(node));
    }
    EXPECT_TRUE(cache.contains(page(0)));
    EXPECT_TRUE(cache.contains(page(1)));
}

TEST_F(PageCacheTest, CountsWhatHadToComeTwice) {
    for (std::uint32_t node = 0; node < 8; ++node) {
        cache.beginPass();
        insert(node);
    }
    EXPECT_EQ(cache.counters().reloads, 0u);
    cache.beginPass();
    insert(0);
    EXPECT_EQ(cache.counters().reloads, 1u);
}

TEST_F(PageCacheTest, AHitIsAPageThatWasThereWhenThePictureBegan) {
    insert(0), insert(1);
    cache.beginPass();
    cache.find(page(0)), cache.find(page(1));
    EXPECT_EQ(cache.counters().hits, 0u) << "they came for this very picture";
    EXPECT_EQ(cache.counters().hitRate(), 0.0);

    const PageCacheCounters before = cache.counters();
    cache.beginPicture();
    for (int pass = 0; pass < 3; ++pass) {
        cache.beginPass();
        for (int ray = 0; ray < 5; ++ray) EXPECT_TRUE(cache.find(page(0)));
        EXPECT_FALSE(cache.find(page(2)));
    }
    insert(2);
    cache.beginPass();
    cache.find(page(2));
    const PageCacheCounters picture = cache.counters() - before;
    EXPECT_EQ(picture.hits, 1u) << "one page was used again, whatever the number of rays and passes";
    EXPECT_EQ(picture.loads, 1u);
    EXPECT_EQ(picture.hitRate(), 0.5);

    cache.beginPicture();
    cache.find(page(2));
    EXPECT_EQ((cache.counters() - before).hits, 2u) << "what came last time is a hit now";
}

TEST_F(PageCacheTest, RacingThreadsCountAHitOnce) {
    for (std::uint32_t node = 0; node < 4; ++node) insert(node);
    std::uint64_t expected = 0;
    for (int picture = 0; picture < 200; ++picture) {
        cache.beginPicture();
        std::vector<std::jthread> threads;
        for (int t = 0; t < 2; ++t)
            threads.emplace_back([this] {
                for (std::uint32_t node = 0; node < 4; ++node) cache.find(page(node));
            });
        threads.clear();
        expected += 4;
        ASSERT_EQ(cache.counters().hits, expected);
    }
}

TEST_F(PageCacheTest, ADraftAndItsBrickAreTwoPages) {
    cache.insert({0, 0, 7, true});
    EXPECT_TRUE(cache.contains({0, 0, 7, true}));
    EXPECT_FALSE(cache.contains({0, 0, 7, false}));
}

TEST(PageCacheBudgetTest, ABudgetBelowOnePageHoldsNone) {
    EXPECT_EQ(PageCache(kPageBytes - 1, kFloats).capacity(), 0u);
}

}  // namespace
}  // namespace brickyard

// Memory of what is on its way: the budget holds whoever takes, and who waits is served in turn.
#include "server/batch_pool.h"

#include <gmock/gmock.h>

#include <atomic>
#include <thread>

namespace brickyard {
namespace {

TEST(BatchPool, GivesNoMoreThanItsBudget) {
    BatchPool pool(3 * kBatchBytes);
    auto first = pool.take(), second = pool.take(1), third = pool.take(kBatchBytes);
    EXPECT_EQ(second.capacity(), kBatchBytes);
    EXPECT_FALSE(pool.take());
    EXPECT_EQ(pool.usedBytes(), 3 * kBatchBytes);
    first.reset();
    EXPECT_FALSE(pool.take(kBatchBytes + 1));
    EXPECT_TRUE(pool.take());
    second.reset();
    third.reset();
    EXPECT_EQ(pool.usedBytes(), 0u);
}

TEST(BatchPool, GivesWhatIsOverTheWholeBudgetWhenNothingElseIsOut) {
    BatchPool pool(kBatchBytes);
    auto small = pool.take();
    EXPECT_FALSE(pool.take(10 * kBatchBytes));
    small.reset();
    auto large = pool.take(10 * kBatchBytes);
    EXPECT_EQ(large.capacity(), 10 * kBatchBytes);
    EXPECT_FALSE(pool.take());
}

TEST(BatchPool, ServesThoseWhoWaitInTurn) {
    BatchPool pool(2 * kBatchBytes);
    auto first = pool.take(), second = pool.take();
    std::vector<int> order;
    std::vector<BatchMemory> held;
    for (int i = 0; i < 5; ++i)
        pool.await(1, [&, i](BatchMemory memory) {
            order.push_back(i);
            held.push_back(std::move(memory));
        });
    EXPECT_TRUE(order.empty());
    first.reset();
    EXPECT_THAT(order, testing::ElementsAre(0));
    EXPECT_FALSE(pool.take()) << "somebody went ahead of those who wait";
    second.reset();
    EXPECT_THAT(order, testing::ElementsAre(0, 1));
    while (!held.empty()) {
        const auto one = std::move(held.back());
        held.pop_back();
    }
    EXPECT_THAT(order, testing::ElementsAre(0, 1, 2, 3, 4));
    EXPECT_EQ(pool.usedBytes(), 0u);
}

TEST(BatchPool, OneWhoWaitsAndIsGoneStopsNobody) {
    BatchPool pool(kBatchBytes);
    auto out = pool.take();
    for (int i = 0; i < 100; ++i) pool.await(1, [](BatchMemory) {});
    bool served = false;
    pool.await(1, [&](BatchMemory memory) { served = bool(memory); });
    out.reset();
    EXPECT_TRUE(served);
    EXPECT_EQ(pool.usedBytes(), 0u);
}

TEST(BatchPool, SmallPiecesDoNotStarveALargeOne) {
    BatchPool pool(4 * kBatchBytes);
    std::vector<BatchMemory> small;
    for (int i = 0; i < 4; ++i) small.push_back(pool.take());
    BatchMemory large;
    pool.await(4 * kBatchBytes, [&](BatchMemory memory) { large = std::move(memory); });
    for (int i = 0; i < 3; ++i) {
        small.pop_back();
        EXPECT_FALSE(large);
        EXPECT_FALSE(pool.take()) << "a small piece went ahead of the large one";
    }
    small.clear();
    EXPECT_EQ(large.capacity(), 4 * kBatchBytes);
}

TEST(BatchPool, CallsNobodyWhoWasForgotten) {
    BatchPool pool(kBatchBytes);
    auto out = pool.take();
    bool called = false;
    pool.await(1, [&](BatchMemory) { called = true; });
    pool.forgetWaiting();
    out.reset();
    EXPECT_FALSE(called);
}

TEST(BatchPool, KeepsItsBudgetWhoeverTakesAtOnce) {
    constexpr std::uint64_t kBudget = 8 * kBatchBytes;
    BatchPool pool(kBudget);
    std::atomic<std::uint64_t> out{0}, most{0};
    std::atomic<int> served{0};
    const auto use = [&](BatchMemory memory) {
        const std::uint64_t now = out += memory.capacity();
        for (std::uint64_t seen = most; seen < now && !most.compare_exchange_weak(seen, now);) continue;
        memory.data()[memory.capacity() - 1] = std::byte{1};
        ++served;
        out -= memory.capacity();
    };
    std::vector<std::thread> threads;
    for (int t = 0; t < 4; ++t)
        threads.emplace_back([&, t] {
            for (int i = 0; i < 2000; ++i) {
                const std::size_t bytes = std::size_t(1 + (i + t) % 3) * kBatchBytes;
                if (auto memory = pool.take(bytes))
                    use(std::move(memory));
                else
                    pool.await(bytes, use);
            }
        });
    for (std::thread& thread : threads) thread.join();
    EXPECT_EQ(served, 4 * 2000);
    EXPECT_LE(most, kBudget);
    EXPECT_EQ(pool.usedBytes(), 0u);
}

}  // namespace
}  // namespace brickyard

#include "server/byte_budget.h"

#include <gtest/gtest.h>

#include <thread>
#include <vector>

namespace brickyard {
namespace {

TEST(ByteBudget, GivesWhatThereIsAndTakesItBack) {
    ByteBudget budget(100);
    auto first = budget.reserveUpTo(70);
    EXPECT_EQ(first.bytes(), 70u);
    auto second = budget.reserveUpTo(70);
    EXPECT_EQ(second.bytes(), 30u);
    EXPECT_EQ(budget.reserveUpTo(1).bytes(), 0u);
    first = std::move(second);
    EXPECT_EQ(first.bytes(), 30u);
    EXPECT_EQ(budget.usedBytes(), 30u);
    first.reset();
    EXPECT_EQ(budget.usedBytes(), 0u);
    EXPECT_EQ(budget.reserveUpTo(~0ull).bytes(), 100u);
}

TEST(ByteBudget, IsNeverOverdrawnByManyAtOnce) {
    ByteBudget budget(1000);
    std::vector<std::thread> threads;
    for (int t = 0; t < 4; ++t)
        threads.emplace_back([&, t] {
            for (std::uint64_t i = 0; i < 20'000; ++i) {
                const auto share = budget.reserveUpTo((i * 7 + std::uint64_t(t)) % 600);
                ASSERT_LE(budget.usedBytes(), 1000u);
            }
        });
    for (std::thread& thread : threads) thread.join();
    EXPECT_EQ(budget.usedBytes(), 0u);
}

}  // namespace
}  // namespace brickyard

// `brickyard serve` as a process: how it ends when it is told to.
#include <gmock/gmock.h>

#include <csignal>

#include "command_run.h"
#include "live_server.h"
#include "raw_stream.h"
#include "stored_file.h"
#include "tiny_dataset.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

class StopTest : public testing::Test {
protected:
    void SetUp() override {
        child_ = startProgram(scratch_.path(), BRICKYARD_COMMAND,
                              {"serve", tiny_.folder().string(), "--listen", "127.0.0.1:0", "--drain-timeout",
                               "1", "--threads", "2"});
        const std::string marker = "127.0.0.1:";
        ASSERT_TRUE(comesTrue([&] {
            const std::string out = readFile(scratch_.path() / "out");
            const auto at = out.find(marker);
            if (at == std::string::npos || out.find('\n') == std::string::npos) return false;
            port_ = std::uint16_t(std::atoi(out.c_str() + at + marker.size()));
            return true;
        })) << readFile(scratch_.path() / "err");
    }
    void TearDown() override {
        if (child_ > 0) finishProgram(scratch_.path(), child_);
    }
    // Its exit status, when it was told to stop and has stopped.
    int stop(int signal, milliseconds& took) {
        const auto begin = Clock::now();
        ::kill(child_, signal);
        const Outcome outcome = finishProgram(scratch_.path(), child_);
        child_ = 0;
        took = std::chrono::duration_cast<milliseconds>(Clock::now() - begin);
        EXPECT_EQ(outcome.err, "");
        return outcome.status;
    }
    StreamHeader wishOfMany() const {
        const auto bricks = tiny_.bricks(0);
        StreamHeader wish = wishMessage(1, 4ull << 30);
        for (std::size_t i = 0; i < 60'000; ++i) addPage(wish, bricks[i % bricks.size()]);
        return wish;
    }

    StoredFolder scratch_;
    TinyDataset tiny_{"tiny", {.levels = 4, .payload_bytes = 4096}};
    pid_t child_ = 0;
    std::uint16_t port_ = 0;
};

TEST_F(StopTest, SaysGoodbyeToClientsThatAreBeingServed) {
    RawStream stream(port_), idle(port_);
    ASSERT_TRUE(stream.establish());
    ASSERT_TRUE(idle.establish());
    stream.send(wishOfMany());
    ASSERT_TRUE(stream.receive());
    std::thread reader([&] {
        while (stream.receive()) continue;
    });
    milliseconds took{};
    EXPECT_EQ(stop(SIGTERM, took), 0);
    reader.join();
    EXPECT_EQ(stream.closeCode(), 1001);
    EXPECT_FALSE(idle.receive());
    EXPECT_EQ(idle.closeCode(), 1001);
    EXPECT_LT(took, seconds(3));
}

TEST_F(StopTest, WaitsForAReaderThatIsStuckOnlyAsLongAsItSaid) {
    RawStream stuck(port_, 4096), half(port_);
    ASSERT_TRUE(stuck.establish());
    stuck.send(wishOfMany());
    std::this_thread::sleep_for(milliseconds(300));
    milliseconds took{};
    EXPECT_EQ(stop(SIGTERM, took), 0);
    EXPECT_LT(took, seconds(4));
}

TEST_F(StopTest, StopsAtOnceWhereNobodyIsThere) {
    milliseconds took{};
    EXPECT_EQ(stop(SIGINT, took), 0);
    EXPECT_LT(took, seconds(1));
}

}  // namespace
}  // namespace brickyard

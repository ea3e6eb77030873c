// The convert command as the world treats it: killed, interrupted, started twice, and fed with files that are
// not complete. Whatever happens, a dataset is the old one or the new one, and the same command completes it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <random>
#include <thread>

#include "command_run.h"
#include "core/dataset.h"
#include "tools/dataset_check.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using Seconds = std::chrono::duration<double>;

const fs::path kPlume = fs::path(BRICKYARD_TEST_DATA) / "plume";

class InterruptionTest : public testing::Test {
protected:
    pid_t start(const std::vector<std::string>& arguments, const fs::path& logs) {
        return startProgram(logs, BRICKYARD_COMMAND, arguments);
    }
    Outcome brickyard(const std::vector<std::string>& arguments) {
        return finishProgram(logs_.path(), start(arguments, logs_.path()));
    }
    static std::string plume(int frame) {
        return (kPlume / ("plume.00" + std::to_string(frame) + ".vdb")).string();
    }
    std::string dataset() const { return (scratch_ / "out.bricks").string(); }
    std::string frames() const {
        const auto opened = Dataset::open(dataset());
        return opened ? describeFrames(opened->manifest()) : "no dataset";
    }
    void expectSound(const std::string& when) const {
        const CheckReport report = checkDataset(dataset(), serialFor, nullptr);
        ASSERT_TRUE(report.faults.empty()) << when << ": " << report.faults[0].message;
    }
    static std::vector<std::string> listing(const fs::path& folder) {
        std::vector<std::string> names;
        for (const auto& entry : fs::directory_iterator(folder)) names.push_back(entry.path().filename());
        std::sort(names.begin(), names.end());
        return names;
    }
    void expectNoLitter(const std::string& when) const {
        ASSERT_EQ(listing(scratch_.path()), std::vector<std::string>{"out.bricks"}) << when;
        for (const std::string& folder : {dataset(), dataset() + "/frames"})
            for (const std::string& name : listing(folder)) ASSERT_FALSE(name.starts_with(".tmp-")) << when;
        ASSERT_EQ(listing(dataset() + "/frames").size(),
                  std::size_t(Dataset::open(dataset())->manifest().frames_size()))
            << when;
    }
    // A copy that a test may cut short.
    std::string copyOf(int frame, const ScratchFolder& folder) {
        const fs::path copy = folder / fs::path(plume(frame)).filename();
        fs::copy_file(plume(frame), copy, fs::copy_options::overwrite_existing);
        return copy.string();
    }

    ScratchFolder scratch_, logs_;
};

// BRICKYARD_KILLS says how many; the default is what a run of all tests has time for.
TEST_F(InterruptionTest, KillsAtRandomMomentsNeverLeaveHalfADataset) {
    const char* set = std::getenv("BRICKYARD_KILLS");
    const int kills = set ? std::atoi(set) : 30;
    const std::vector<std::string> all{"convert", plume(18), plume(24), plume(30), dataset()};
    std::vector<std::string> append{"convert", plume(24), plume(30), dataset(), "--append"};
    std::vector<std::string> overwrite = all;
    overwrite.push_back("--overwrite");
    const auto begin = std::chrono::steady_clock::now();
    ASSERT_EQ(brickyard(all).status, 0);
    const double whole = Seconds(std::chrono::steady_clock::now() - begin).count();

    std::random_device seed;
    std::mt19937 random(seed());
    int came_in_time = 0;
    for (int round = 0; round < kills; ++round) {
        const int mode = round % 3;
        const std::string when = std::string(mode == 0   ? "convert"
                                             : mode == 1 ? "append"
                                                         : "overwrite") +
                                 " " + std::to_string(round);
        // To append to, frame 18; to overwrite, a complete dataset.
        if (mode < 2) fs::remove_all(dataset());
        if (mode == 1) ASSERT_EQ(brickyard({"convert", plume(18), dataset()}).status, 0);
        if (mode == 2) ASSERT_EQ(brickyard(all).status, 0);
        const std::string before = frames();

        const pid_t child = start(mode == 0 ? all : mode == 1 ? append : overwrite, logs_.path());
        std::this_thread::sleep_for(Seconds(std::uniform_real_distribution<double>(0, 1.1 * whole)(random)));
        ::kill(child, SIGKILL);
        came_in_time += finishProgram(logs_.path(), child).status == -SIGKILL;

        if (fs::exists(dataset())) expectSound(when);
        if (mode > 0) ASSERT_TRUE(fs::exists(dataset())) << when;
        if (mode == 1) ASSERT_EQ(frames().find("18"), 0u) << when << ": what was there is gone";
        if (mode == 2) ASSERT_EQ(frames(), before) << when;
        const Outcome again = brickyard(mode == 1 ? append : all);
        ASSERT_EQ(again.status, 0) << when << ": " << again.err;
        ASSERT_EQ(frames(), "18, 24, 30") << when;
        expectSound(when + ", completed");
        expectNoLitter(when);
        if (HasFatalFailure()) return;
    }
    EXPECT_GT(came_in_time, kills / 3) << "too few kills came in time to mean anything";
}

TEST_F(InterruptionTest, CtrlCKeepsFinishedFramesAndSaysHowToContinue) {
    for (const auto& [signal, status] : {std::pair{SIGINT, 130}, std::pair{SIGTERM, 143}}) {
        fs::remove_all(dataset());
        const std::vector<std::string> command{"convert", plume(18), plume(24), plume(30),
                                               dataset(), "--brick", "8"};
        const pid_t child = start(command, logs_.path());
        while (!fs::exists(dataset() + "/frames/000018.brk")) std::this_thread::sleep_for(Seconds(0.002));
        ::kill(child, signal);
        const Outcome outcome = finishProgram(logs_.path(), child);
        ASSERT_EQ(outcome.status, status) << outcome.err;
        EXPECT_THAT(outcome.err, HasSubstr("run the same command again"));
        EXPECT_THAT(outcome.err, HasSubstr(" of 3 frames are done"));
        EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1);
        EXPECT_EQ(frames().find("18"), 0u);
        expectSound("after the signal");
        expectNoLitter("after the signal");
        ASSERT_EQ(brickyard(command).status, 0);
        EXPECT_EQ(frames(), "18, 24, 30");
    }
}

TEST_F(InterruptionTest, CtrlCBeforeTheFirstFrameLeavesNothing) {
    // A frame may be faster than the signal, but not every time.
    for (int round = 0; round < 20; ++round) {
        const pid_t child = start({"convert", plume(30), dataset(), "--brick", "8"}, logs_.path());
        while (!fs::exists(dataset())) std::this_thread::sleep_for(Seconds(0.001));
        ::kill(child, SIGINT);
        const Outcome outcome = finishProgram(logs_.path(), child);
        if (outcome.status == 0) {
            fs::remove_all(dataset());
            continue;
        }
        EXPECT_EQ(outcome.status, 130);
        EXPECT_TRUE(listing(scratch_.path()).empty());
        return;
    }
    FAIL() << "no signal came before the end of its frame";
}

TEST_F(InterruptionTest, AnInputThatIsCutShortWhileItIsReadIsNotCommitted) {
    const ScratchFolder inputs;
    std::mt19937 random(7);
    int refused = 0;
    for (int round = 0; round < 12; ++round) {
        fs::remove_all(dataset());
        const std::string input = copyOf(30, inputs);
        const pid_t child = start({"convert", input, dataset(), "--brick", "8"}, logs_.path());
        std::this_thread::sleep_for(Seconds(std::uniform_real_distribution<double>(0, 0.4)(random)));
        fs::resize_file(input, fs::file_size(input) / 2);
        const Outcome outcome = finishProgram(logs_.path(), child);
        if (outcome.status == 0) {  // it was done before
            expectSound("a whole frame");
            continue;
        }
        ++refused;
        EXPECT_EQ(outcome.status, 1) << outcome.err;
        EXPECT_THAT(outcome.err, HasSubstr("plume.0030.vdb"));
        EXPECT_FALSE(fs::exists(dataset()));
    }
    EXPECT_GT(refused, 0);
}

TEST_F(InterruptionTest, TwoConvertersOfTheSameFramesAgree) {
    const ScratchFolder other_logs;
    for (int round = 0; round < 4; ++round) {
        fs::remove_all(dataset());
        const std::vector<std::string> command{"convert", plume(18), plume(24), plume(30), dataset()};
        const pid_t one = start(command, logs_.path()), other = start(command, other_logs.path());
        const Outcome first = finishProgram(logs_.path(), one),
                      second = finishProgram(other_logs.path(), other);
        EXPECT_EQ(first.status, 0) << first.err;
        EXPECT_EQ(second.status, 0) << second.err;
        EXPECT_EQ(frames(), "18, 24, 30");
        expectSound("two converters");
        ASSERT_EQ(brickyard(command).status, 0);
        expectNoLitter("two converters");
    }
}

TEST_F(InterruptionTest, ConvertersOfDifferentFramesLoseNone) {
    const ScratchFolder first_logs, second_logs, third_logs;
    for (int round = 0; round < 4; ++round) {
        fs::remove_all(dataset());
        const pid_t children[] = {start({"convert", plume(18), dataset(), "--append"}, first_logs.path()),
                                  start({"convert", plume(24), dataset(), "--append"}, second_logs.path()),
                                  start({"convert", plume(30), dataset(), "--append"}, third_logs.path())};
        EXPECT_EQ(finishProgram(first_logs.path(), children[0]).status, 0) << readFile(first_logs / "err");
        EXPECT_EQ(finishProgram(second_logs.path(), children[1]).status, 0) << readFile(second_logs / "err");
        EXPECT_EQ(finishProgram(third_logs.path(), children[2]).status, 0) << readFile(third_logs / "err");
        EXPECT_EQ(frames(), "18, 24, 30");
        expectSound("three converters");
        expectNoLitter("three converters");
    }
}

TEST_F(InterruptionTest, AFileThatIsStillWrittenIsLeftForTheNextRun) {
    const ScratchFolder inputs;
    const std::string done = copyOf(18, inputs), growing = copyOf(24, inputs);
    const std::string bytes = readFile(plume(24));
    std::atomic<bool> stop{false};
    std::thread simulation([&] {
        for (std::size_t size = 1000; !stop; size += 1000) {
            writeFile(growing, bytes.substr(0, size % bytes.size()));
            std::this_thread::sleep_for(Seconds(0.02));
        }
        writeFile(growing, bytes);
    });
    const std::vector<std::string> command{"convert",  done,       growing, dataset(),
                                           "--append", "--settle", "0.3"};
    const Outcome outcome = brickyard(command);
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    EXPECT_THAT(outcome.err, HasSubstr("is still being written"));
    EXPECT_EQ(frames(), "18");
    stop = true;
    simulation.join();
    ASSERT_EQ(brickyard(command).status, 0);
    EXPECT_EQ(frames(), "18, 24");
}

TEST_F(InterruptionTest, AWatchTakesEachFrameWhenItIsCompleteAndEnds) {
    const ScratchFolder inputs;
    copyOf(18, inputs);
    std::thread simulation([&] {
        // Slowly, in pieces; then at once under its name; then one that is broken until it is written again.
        const std::string bytes = readFile(plume(24));
        std::ofstream file(inputs / "plume.0024.vdb", std::ios::binary);
        for (std::size_t at = 0; at < bytes.size(); at += bytes.size() / 8 + 1) {
            file << bytes.substr(at, bytes.size() / 8 + 1) << std::flush;
            std::this_thread::sleep_for(Seconds(0.05));
        }
        file.close();
        writeFile(inputs / "plume.0030.vdb", readFile(plume(30)).substr(0, 5000));
        std::this_thread::sleep_for(Seconds(1.5));
        fs::copy_file(plume(30), inputs / "next");
        fs::rename(inputs / "next", inputs / "plume.0030.vdb");
    });
    const Outcome outcome = brickyard({"convert", "--watch", inputs.path().string(), "plume.*.vdb", dataset(),
                                       "--settle", "0.3", "--until-frame", "30", "--idle", "20"});
    simulation.join();
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    for (const char* line : {"frame 18: ", "frame 24: ", "frame 30: "})
        EXPECT_THAT(outcome.err, HasSubstr(line));
    EXPECT_EQ(frames(), "18, 24, 30");
    expectSound("a watch");
    expectNoLitter("a watch");
    const Outcome idle = brickyard(
        {"convert", "--watch", inputs.path().string(), dataset(), "--settle", "0.1", "--idle", "0.3"});
    EXPECT_EQ(idle.status, 0) << idle.err;
    EXPECT_THAT(idle.out, HasSubstr("0 frames taken"));
}

TEST_F(InterruptionTest, ADryRunWritesNothingAndIsNearTheTruth) {
    const std::vector<std::string> command{"convert", plume(18), plume(24), plume(30), dataset()};
    std::vector<std::string> dry = command;
    dry.push_back("--dry-run");
    const Outcome predicted = brickyard(dry);
    ASSERT_EQ(predicted.status, 0) << predicted.err;
    EXPECT_THAT(predicted.out, HasSubstr("nothing was written"));
    EXPECT_TRUE(listing(scratch_.path()).empty());
    dry.push_back("--json");
    const std::string json = brickyard(dry).out;
    const double bytes = std::atof(json.c_str() + json.find("\"predicted_bytes\": ") + 19);
    ASSERT_EQ(brickyard(command).status, 0);
    double made = 0;
    for (const auto& entry : fs::directory_iterator(dataset() + "/frames")) made += double(entry.file_size());
    EXPECT_NEAR(bytes / made, 1, 0.25);
    const Outcome none = brickyard(dry);
    EXPECT_THAT(none.out, HasSubstr("\"frames_done\": 3"));
}

}  // namespace
}  // namespace brickyard

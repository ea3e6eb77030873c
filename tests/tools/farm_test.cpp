// Many processes add frames to one dataset, with the file system's locks and without any.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <memory>

#include "command_run.h"
#include "core/dataset.h"
#include "tools/dataset_check.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;

// The parameter: a library that takes the locks away, or nothing.
class FarmTest : public testing::TestWithParam<const char*> {};

TEST_P(FarmTest, NoFrameIsLostWhenManyProcessesCommitAtOnce) {
    constexpr int kProcesses = 8, kFramesEach = 3;
    if (*GetParam()) ::setenv("LD_PRELOAD", GetParam(), 1);
    const ScratchFolder inputs;
    const fs::path plume = fs::path(BRICKYARD_TEST_DATA) / "plume/plume.0018.vdb";
    for (int frame = 1; frame <= kProcesses * kFramesEach; ++frame)
        fs::copy_file(plume, inputs / ("a." + std::to_string(frame) + ".vdb"));
    for (int round = 0; round < 3; ++round) {
        const ScratchFolder scratch;
        const std::string dataset = (scratch / "farm.bricks").string();
        std::vector<std::unique_ptr<ScratchFolder>> logs;
        std::vector<pid_t> children;
        for (int process = 0; process < kProcesses; ++process) {
            std::vector<std::string> arguments{"convert"};
            for (int i = 0; i < kFramesEach; ++i)
                arguments.push_back(
                    (inputs / ("a." + std::to_string(1 + process + i * kProcesses) + ".vdb")).string());
            for (const char* argument : {dataset.c_str(), "--append", "--jobs", "1", "--channel", "flame"})
                arguments.push_back(argument);
            logs.push_back(std::make_unique<ScratchFolder>());
            children.push_back(startProgram(logs.back()->path(), BRICKYARD_COMMAND, arguments));
        }
        for (int process = 0; process < kProcesses; ++process) {
            const Outcome outcome =
                finishProgram(logs[std::size_t(process)]->path(), children[std::size_t(process)]);
            EXPECT_EQ(outcome.status, 0) << outcome.err;
        }
        const auto opened = Dataset::open(dataset);
        ASSERT_TRUE(opened) << opened.error().message;
        EXPECT_EQ(describeFrames(opened->manifest()), "1-24");
        const CheckReport report = checkDataset(dataset, serialFor, nullptr);
        EXPECT_TRUE(report.faults.empty()) << report.faults[0].message;
        for (const std::string& folder : {dataset, dataset + "/frames"})
            for (const auto& entry : fs::directory_iterator(folder))
                EXPECT_FALSE(entry.path().filename().string().starts_with(".tmp-")) << entry.path();
    }
    ::unsetenv("LD_PRELOAD");
}

INSTANTIATE_TEST_SUITE_P(Locks, FarmTest, testing::Values(""));
#ifdef BRICKYARD_NO_FLOCK
INSTANTIATE_TEST_SUITE_P(NoLocks, FarmTest, testing::Values(BRICKYARD_NO_FLOCK));
#endif

}  // namespace
}  // namespace brickyard

// The convert command from outside: killed, on a full disk, and given files that nobody should have to read.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mount.h>
#include <sys/wait.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <random>
#include <thread>

#include "frame_fixture.h"
#include "tools/dataset_check.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

const fs::path kPlume = fs::path(BRICKYARD_TEST_DATA) / "plume";

struct Outcome {
    int status = -1;  // exit status, or minus the signal
    std::string out, err;
};

// Starts the command with stdout and stderr in files.
pid_t start(const fs::path& scratch, const std::vector<std::string>& arguments) {
    const pid_t child = ::fork();
    if (child != 0) return child;
    std::vector<char*> argv{const_cast<char*>(BRICKYARD_COMMAND)};
    for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
    argv.push_back(nullptr);
    if (!std::freopen((scratch / "out").c_str(), "w", stdout) ||
        !std::freopen((scratch / "err").c_str(), "w", stderr))
        ::_exit(126);
    ::execv(argv[0], argv.data());
    ::_exit(127);
}

Outcome finish(const fs::path& scratch, pid_t child) {
    int status = 0;
    ::waitpid(child, &status, 0);
    return {WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status), readFile(scratch / "out"),
            readFile(scratch / "err")};
}

Outcome brickyard(const fs::path& scratch, const std::vector<std::string>& arguments) {
    return finish(scratch, start(scratch, arguments));
}

void expectOneLine(const std::string& text) {
    EXPECT_FALSE(text.empty());
    EXPECT_EQ(text.find('\n'), text.size() - 1) << text;
}

std::vector<std::string> listing(const fs::path& folder) {
    std::vector<std::string> names;
    for (const auto& entry : fs::directory_iterator(folder)) names.push_back(entry.path().filename());
    std::sort(names.begin(), names.end());
    return names;
}

TEST(ConvertCommand, AKillAtAnyMomentLeavesASoundDatasetThatTheSameCommandCompletes) {
    const ScratchFolder scratch, logs;
    const std::vector<std::string> command{"convert", (kPlume / "plume.0018.vdb").string(),
                                           (kPlume / "plume.0024.vdb").string(),
                                           (scratch / "out.bricks").string()};
    // How long an undisturbed run takes says where the moments lie.
    const auto begin = std::chrono::steady_clock::now();
    ASSERT_EQ(brickyard(logs.path(), command).status, 0);
    const auto whole = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    const std::string complete = readFile(scratch / "out.bricks/manifest.json");

    std::mt19937 random(1);
    int killed = 0, with_frames = 0;
    for (int round = 0; round < 50; ++round) {
        fs::remove_all(scratch / "out.bricks");
        const pid_t child = start(logs.path(), command);
        std::this_thread::sleep_for(
            std::chrono::duration<double>(std::uniform_real_distribution<double>(0, 1.1 * whole)(random)));
        ::kill(child, SIGKILL);
        killed += finish(logs.path(), child).status == -SIGKILL;

        // Killed before the folder stood there is fine, too.
        if (fs::exists(scratch / "out.bricks")) {
            const CheckReport report = checkDataset(scratch / "out.bricks", serialFor, nullptr);
            ASSERT_TRUE(report.faults.empty()) << "round " << round << ": " << report.faults[0].message;
            with_frames += report.frames == 1;
        }
        const Outcome again = brickyard(logs.path(), command);
        ASSERT_EQ(again.status, 0) << again.err;
        ASSERT_EQ(readFile(scratch / "out.bricks/manifest.json"), complete) << "round " << round;
        ASSERT_EQ(listing(scratch.path()), std::vector<std::string>{"out.bricks"}) << "round " << round;
        ASSERT_EQ(listing(scratch / "out.bricks/frames"),
                  (std::vector<std::string>{"000018.brk", "000024.brk"}));
    }
    EXPECT_GT(killed, 20) << "too few kills came in time to mean anything";
    EXPECT_GT(with_frames, 0) << "no kill came between the two frames";
}

TEST(ConvertCommand, AFullDiskIsOneLineAndLeavesNothing) {
    const ScratchFolder scratch, logs;
    fs::create_directory(scratch / "disk");
    if (::mount("tmpfs", (scratch / "disk").c_str(), "tmpfs", 0, "size=256k") != 0)
        GTEST_SKIP() << "a tmpfs cannot be mounted here";
    const Outcome outcome = brickyard(logs.path(), {"convert", (kPlume / "plume.0030.vdb").string(),
                                                    (scratch / "disk/out.bricks").string()});
    const std::vector<std::string> left = listing(scratch / "disk");
    ::umount((scratch / "disk").c_str());
    EXPECT_EQ(outcome.status, 1);
    expectOneLine(outcome.err);
    EXPECT_THAT(outcome.err, HasSubstr("no space left"));
    EXPECT_TRUE(left.empty());
}

TEST(ConvertCommand, JsonHasWhatTheContractPromises) {
    const ScratchFolder scratch, logs;
    const Outcome outcome = brickyard(logs.path(), {"convert", (kPlume / "plume.0018.vdb").string(), "--json",
                                                    (scratch / "out.bricks").string()});
    ASSERT_EQ(outcome.status, 0) << outcome.err;
    EXPECT_EQ(outcome.err, "") << "no progress line where nobody watches";
    const auto json = nlohmann::json::parse(outcome.out);
    for (const char* key : {"frames", "active_voxels", "bricks", "levels", "input_bytes", "output_bytes",
                            "seconds", "peak_memory_bytes"})
        EXPECT_TRUE(json.at(key).is_number()) << key;
    EXPECT_EQ(json["frames"], 1);
    EXPECT_EQ(json["output_bytes"], fs::file_size(scratch / "out.bricks/frames/000018.brk"));
    ASSERT_EQ(json["channels"].size(), 5u);
    for (const auto& channel : json["channels"])
        for (const char* key : {"name", "range", "error_bound", "error_made"})
            EXPECT_TRUE(channel.contains(key)) << key;
    for (const char* command : {"info", "verify"}) {
        const Outcome described =
            brickyard(logs.path(), {command, (scratch / "out.bricks").string(), "--json"});
        EXPECT_EQ(described.status, 0) << described.err;
        EXPECT_TRUE(nlohmann::json::accept(described.out)) << described.out;
    }
}

TEST(ConvertCommand, WrongUsageIsStatusTwoAndWrongInputStatusOne) {
    const ScratchFolder scratch, logs;
    const std::string input = (kPlume / "plume.0018.vdb").string(),
                      output = (scratch / "out.bricks").string();
    const std::vector<std::vector<std::string>> wrong{{input},
                                                      {input, output, "--brick", "12"},
                                                      {input, output, "--error", "-1"},
                                                      {input, output, "--error", "density="},
                                                      {input, output, "--memory", "lots"},
                                                      {input, output, "--nonfinite", "maybe"},
                                                      {input, output, "--append", "--overwrite"}};
    for (std::vector<std::string> arguments : wrong) {
        arguments.insert(arguments.begin(), "convert");
        const Outcome outcome = brickyard(logs.path(), arguments);
        EXPECT_EQ(outcome.status, 2) << testing::PrintToString(arguments);
        expectOneLine(outcome.err);
    }
    for (const std::string& missing : {std::string("/nonexistent.vdb"), scratch.path().string()}) {
        const Outcome outcome = brickyard(logs.path(), {"convert", missing, output});
        EXPECT_EQ(outcome.status, 1);
        expectOneLine(outcome.err);
        EXPECT_FALSE(fs::exists(output));
    }
}

TEST(ConvertCommand, SampleAndExportAnswerWhatVerifyAccepts) {
    const ScratchFolder scratch, logs;
    const std::string output = (scratch / "out.bricks").string();
    ASSERT_EQ(brickyard(logs.path(), {"convert", (kPlume / "plume.0018.vdb").string(), output}).status, 0);
    const Outcome raw = brickyard(
        logs.path(), {"export", output, (scratch / "density.raw").string(), "--channel", "density"});
    ASSERT_EQ(raw.status, 0) << raw.err;
    // "--raw 41x41x41:float32": the file has exactly these voxels.
    unsigned nx = 0, ny = 0, nz = 0;
    ASSERT_EQ(std::sscanf(raw.out.c_str() + raw.out.find("--raw "), "--raw %ux%ux%u:float32", &nx, &ny, &nz),
              3)
        << raw.out;
    EXPECT_EQ(fs::file_size(scratch / "density.raw"), 4ull * nx * ny * nz);
    const Outcome unknown = brickyard(logs.path(), {"export", output, (scratch / "a.abc").string()});
    EXPECT_EQ(unknown.status, 1);
    expectOneLine(unknown.err);
}

// Each converts and is then the same as its source, or is refused with one line.
class Extremes : public testing::Test {
protected:
    static fs::path folder() {
        const char* shared = std::getenv("BRICKYARD_SHARED_DATA");
        return fs::path(shared ? shared : BRICKYARD_TEST_DATA "/../../../shared/data") / "extremes";
    }
};

TEST_F(Extremes, EachFileConvertsOrIsRefusedWithOneLine) {
    if (!fs::is_directory(folder())) GTEST_SKIP() << "no shared data at " << folder();
    const ScratchFolder scratch, logs;
    int converted = 0, refused = 0;
    for (const auto& entry : fs::directory_iterator(folder())) {
        const std::string name = entry.path().filename();
        if (entry.path().extension() != ".vdb") continue;
        // 400 000 bricks in the faces of tiles: minutes of work, and nothing that tiles_only_8 lacks.
        if (name == "tiles_only_all_levels.vdb") continue;
        const std::string output = (scratch / "out.bricks").string();
        const Outcome outcome = brickyard(logs.path(), {"convert", entry.path().string(), output});
        if (outcome.status == 0) {
            ++converted;
            const Outcome same =
                brickyard(logs.path(), {"verify", output, "--against", entry.path().string()});
            EXPECT_EQ(same.status, 0) << name << ": " << same.err;
        } else {
            ++refused;
            EXPECT_EQ(outcome.status, 1) << name;
            expectOneLine(outcome.err);
            EXPECT_THAT(outcome.err, HasSubstr(name));
            EXPECT_TRUE(listing(scratch.path()).empty()) << name << " left something behind";
        }
        fs::remove_all(output);
    }
    EXPECT_GT(converted, 40);
    EXPECT_GT(refused, 20);
}

}  // namespace
}  // namespace brickyard

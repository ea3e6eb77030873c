// The command as a shell sees it: what it prints where, and its exit status.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace brickyard {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

struct Outcome {
    int status = -1;
    std::string out;
    std::string err;
};

std::string readFile(const std::string& path) {
    std::ostringstream text;
    text << std::ifstream(path, std::ios::binary).rdbuf();
    return text.str();
}

Outcome brickyard(const std::string& arguments) {
    const std::string base = testing::TempDir() + "command_line_test." + std::to_string(getpid());
    const std::string line = std::string("'") + BRICKYARD_COMMAND + "' " + arguments + " >'" + base +
                             ".out' 2>'" + base + ".err' </dev/null";
    const int status = std::system(line.c_str());
    Outcome outcome{WIFEXITED(status) ? WEXITSTATUS(status) : -1, readFile(base + ".out"),
                    readFile(base + ".err")};
    std::remove((base + ".out").c_str());
    std::remove((base + ".err").c_str());
    return outcome;
}

void expectOneLine(const std::string& text) {
    EXPECT_FALSE(text.empty());
    EXPECT_EQ(text.find('\n'), text.size() - 1) << text;
}

TEST(CommandLine, HelpNamesEveryCommandAndTheExitStatuses) {
    const Outcome help = brickyard("--help");
    EXPECT_EQ(help.status, 0);
    EXPECT_EQ(help.err, "");
    for (const char* word :
         {"convert", "info", "verify", "serve", "render", "bench", "--version", "Exit status"})
        EXPECT_THAT(help.out, HasSubstr(word));
}

TEST(CommandLine, VersionIsOneLine) {
    const Outcome version = brickyard("--version");
    EXPECT_EQ(version.status, 0);
    EXPECT_THAT(version.out, StartsWith("brickyard "));
    expectOneLine(version.out);
}

TEST(CommandLine, EveryCommandHasHelp) {
    for (const char* command : {"convert", "info", "verify", "serve", "render", "bench"}) {
        const Outcome help = brickyard(std::string(command) + " --help");
        EXPECT_EQ(help.status, 0) << command << ": " << help.err;
        EXPECT_THAT(help.out, HasSubstr(command));
    }
}

TEST(CommandLine, WrongUsageIsOneLineThatPointsToTheHelp) {
    for (const char* arguments :
         {"", "nonsense", "--nonsense", "info", "info --nonsense x", "info a.bricks b.bricks"}) {
        const Outcome outcome = brickyard(arguments);
        EXPECT_EQ(outcome.status, 2) << "brickyard " << arguments << ": " << outcome.err;
        EXPECT_EQ(outcome.out, "");
        expectOneLine(outcome.err);
        EXPECT_THAT(outcome.err, HasSubstr("--help"));
    }
}

// Only a build without one of the options can show this.
TEST(CommandLine, ACommandThatWasLeftOutNamesItsOption) {
    std::vector<std::pair<std::string, std::string>> left_out;
#ifndef BRICKYARD_WITH_OPENVDB
    left_out.emplace_back("convert", "-DBRICKYARD_OPENVDB=ON");
#endif
#ifndef BRICKYARD_WITH_SERVER
    left_out.emplace_back("serve", "-DBRICKYARD_SERVER=ON");
#endif
#ifndef BRICKYARD_WITH_CLIENT
    left_out.emplace_back("render", "-DBRICKYARD_CLIENT=ON");
#endif
#if defined(BRICKYARD_WITH_OPENVDB) && defined(BRICKYARD_WITH_CLIENT) && !defined(BRICKYARD_WITH_BENCH)
    left_out.emplace_back("bench", "-DBRICKYARD_BENCH=ON");
#endif
    if (left_out.empty()) GTEST_SKIP() << "this build has every command";
    for (const auto& [command, option] : left_out) {
        const Outcome outcome = brickyard(command + " whatever --json");
        EXPECT_EQ(outcome.status, 1);
        EXPECT_EQ(outcome.out, "");
        expectOneLine(outcome.err);
        EXPECT_THAT(outcome.err, HasSubstr(option));
    }
}

TEST(CommandLine, AMissingDatasetIsOneLineThatNamesIt) {
    const Outcome outcome = brickyard("info /nonexistent/plume.bricks");
    EXPECT_EQ(outcome.status, 1) << outcome.err;
    EXPECT_EQ(outcome.out, "");
    expectOneLine(outcome.err);
    EXPECT_THAT(outcome.err, HasSubstr("/nonexistent/plume.bricks"));
}

}  // namespace
}  // namespace brickyard

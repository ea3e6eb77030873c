// Runs the `brickyard` command as a user does, with what it prints.
#pragma once

#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <string>
#include <vector>

#include "frame_fixture.h"

namespace brickyard {

struct CommandOutcome {
    int status = -1;  // exit status, or minus the signal
    std::string out, err;
};

inline CommandOutcome runCommand(const std::filesystem::path& scratch,
                                 const std::vector<std::string>& arguments) {
    const pid_t child = ::fork();
    if (child == 0) {
        std::vector<char*> argv{const_cast<char*>(BRICKYARD_COMMAND)};
        for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
        argv.push_back(nullptr);
        if (!std::freopen((scratch / "out").c_str(), "w", stdout) ||
            !std::freopen((scratch / "err").c_str(), "w", stderr))
            ::_exit(126);
        ::execv(argv[0], argv.data());
        ::_exit(127);
    }
    int status = 0;
    ::waitpid(child, &status, 0);
    return {WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status), readFile(scratch / "out"),
            readFile(scratch / "err")};
}

inline void expectOneLineOf(const CommandOutcome& outcome, const std::string& text) {
    EXPECT_EQ(outcome.status, 1) << outcome.err;
    EXPECT_NE(outcome.err.find(text), std::string::npos) << outcome.err << "lacks: " << text;
    EXPECT_EQ(outcome.err.find('\n'), outcome.err.size() - 1) << outcome.err;
}

}  // namespace brickyard

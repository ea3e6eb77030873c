// The real command, from outside: started, waited for, killed.
#pragma once

#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "frame_fixture.h"

namespace brickyard {

struct Outcome {
    int status = -1;  // exit status, or minus the signal
    std::string out, err;
};

// Any program, with stdout and stderr in files of `scratch`.
inline pid_t startProgram(const std::filesystem::path& scratch, const std::string& program,
                          const std::vector<std::string>& arguments) {
    const pid_t child = ::fork();
    if (child != 0) return child;
    std::vector<char*> argv{const_cast<char*>(program.c_str())};
    for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
    argv.push_back(nullptr);
    if (!std::freopen((scratch / "out").c_str(), "w", stdout) ||
        !std::freopen((scratch / "err").c_str(), "w", stderr))
        ::_exit(126);
    ::execvp(argv[0], argv.data());
    ::_exit(127);
}

inline Outcome finishProgram(const std::filesystem::path& scratch, pid_t child) {
    int status = 0;
    ::waitpid(child, &status, 0);
    return {WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status), readFile(scratch / "out"),
            readFile(scratch / "err")};
}

inline Outcome runProgram(const std::filesystem::path& scratch, const std::string& program,
                          const std::vector<std::string>& arguments) {
    return finishProgram(scratch, startProgram(scratch, program, arguments));
}

#ifdef BRICKYARD_COMMAND
// The command of this build.
inline Outcome runCommand(const std::filesystem::path& scratch, const std::vector<std::string>& arguments) {
    return runProgram(scratch, BRICKYARD_COMMAND, arguments);
}
#endif

inline void expectOneLineOf(const Outcome& outcome, const std::string& text) {
    EXPECT_EQ(outcome.status, 1) << outcome.err;
    EXPECT_NE(outcome.err.find(text), std::string::npos) << outcome.err << "lacks: " << text;
    EXPECT_EQ(outcome.err.find('\n'), outcome.err.size() - 1) << outcome.err;
}

inline bool isInstalled(const std::string& program) {
    return std::system(("command -v " + program + " >/dev/null 2>&1").c_str()) == 0;
}

}  // namespace brickyard

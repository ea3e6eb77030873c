// Another program, run to its end and measured as a whole: what a person who types its name waits and pays
// for. Any thread.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/result.h"

namespace brickyard {

struct ChildRun {
    int status = 0;          // its exit status; -1 where a signal ended it
    double seconds = 0;      // from its start to its end
    double cpu_seconds = 0;  // of all its threads and of the programs that it ran, in user and system mode
    // Largest resident set. Linux counts it from before the program is loaded, so it is never below what this
    // process had resident when it started the child.
    std::uint64_t peak_bytes = 0;
    double coresBusy() const { return seconds > 0 ? cpu_seconds / seconds : 0; }
};

// Where PATH has a program of this name, or nothing.
std::optional<std::filesystem::path> findProgram(const std::string& name);

// The command that is running now. Errors: kIo.
Result<std::filesystem::path> ownProgram();

// `arguments` begin with the program's path. Its stdout goes to `out`, its stderr to `err`, which may be the
// same file. Errors: kIo; kTimeout: it is ended at the deadline.
Result<ChildRun> runChild(std::vector<std::string> arguments, const std::filesystem::path& out,
                          const std::filesystem::path& err, std::chrono::seconds deadline);

}  // namespace brickyard

#include "tools/bench/child_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <sstream>

#include "core/io_error.h"

namespace brickyard {
namespace {

double secondsIn(const timeval& time) { return double(time.tv_sec) + 1e-6 * double(time.tv_usec); }

// The child's number, or the system's error below 0.
pid_t spawn(std::vector<std::string>& arguments, const std::filesystem::path& out,
            const std::filesystem::path& err) {
    std::vector<char*> pointers;
    for (std::string& argument : arguments) pointers.push_back(argument.data());
    pointers.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, out.c_str(), O_WRONLY | O_CREAT | O_TRUNC,
                                       0600);
    if (out == err)
        ::posix_spawn_file_actions_adddup2(&actions, STDOUT_FILENO, STDERR_FILENO);
    else
        ::posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, err.c_str(), O_WRONLY | O_CREAT | O_TRUNC,
                                           0600);
    // Signals that we have blocked for ourselves must end the child.
    posix_spawnattr_t attributes;
    ::posix_spawnattr_init(&attributes);
    sigset_t none;
    sigemptyset(&none);
    ::posix_spawnattr_setsigmask(&attributes, &none);
    ::posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK);
    pid_t child = 0;
    const int error = ::posix_spawn(&child, pointers[0], &actions, &attributes, pointers.data(), environ);
    ::posix_spawnattr_destroy(&attributes);
    ::posix_spawn_file_actions_destroy(&actions);
    return error != 0 ? -error : child;
}

// True when the child has ended. Sleeps on the child itself: a pause between looks would be in the time
// measured.
bool waitForEnd(pid_t child, std::chrono::steady_clock::time_point deadline) {
    // glibc 2.36 declares pidfd_open without extern "C".
    const int descriptor = int(::syscall(SYS_pidfd_open, child, 0));
    if (descriptor < 0) return true;  // no such call here: wait4 waits without a deadline
    pollfd ended{descriptor, POLLIN, 0};
    int found = 0;
    do {
        const auto left =
            std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
        if (left.count() <= 0) break;
        found = ::poll(&ended, 1, int(left.count()));
    } while (found <= 0);
    ::close(descriptor);
    return found > 0;
}

}  // namespace

std::optional<std::filesystem::path> findProgram(const std::string& name) {
    const char* path = std::getenv("PATH");
    std::istringstream folders(path ? path : "");
    for (std::string folder; std::getline(folders, folder, ':');) {
        const std::filesystem::path program = std::filesystem::path(folder) / name;
        if (!folder.empty() && ::access(program.c_str(), X_OK) == 0) return program;
    }
    return std::nullopt;
}

Result<std::filesystem::path> ownProgram() {
    std::error_code error;
    std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
    if (error) return ioError("find", "/proc/self/exe", error.value());
    return program;
}

Result<ChildRun> runChild(std::vector<std::string> arguments, const std::filesystem::path& out,
                          const std::filesystem::path& err, std::chrono::seconds deadline) {
    const auto started = std::chrono::steady_clock::now();
    const pid_t child = spawn(arguments, out, err);
    if (child < 0) return ioError("start", arguments[0], -child);
    const bool in_time = waitForEnd(child, started + deadline);
    if (!in_time) ::kill(child, SIGKILL);
    int status = 0;
    rusage usage{};
    while (::wait4(child, &status, 0, &usage) < 0)
        if (errno != EINTR) return ioError("wait for", arguments[0], errno);
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - started;
    if (!in_time)
        return fail(ErrorCode::kTimeout,
                    fmt::format("{}: was not done in {} minutes; use a smaller --size", arguments[0],
                                std::chrono::duration_cast<std::chrono::minutes>(deadline).count()));
    ChildRun run;
    run.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    run.seconds = seconds.count();
    run.cpu_seconds = secondsIn(usage.ru_utime) + secondsIn(usage.ru_stime);
    run.peak_bytes = std::uint64_t(usage.ru_maxrss) * 1024;
    return run;
}

}  // namespace brickyard

#include "tools/bench/server_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <charconv>
#include <chrono>
#include <fstream>
#include <sstream>
#include <thread>

#include "core/io_error.h"
#include "tools/bench/child_process.h"
#include "tools/bench/raw_stream.h"

namespace brickyard {
namespace {

constexpr std::chrono::seconds kPatience{30};

// The child's number, or the system's error below 0. Not posix_spawn: the server must end with us, however we
// end. Between fork and exec only what is safe there.
pid_t spawnServer(std::vector<std::string>& arguments, int out, const std::filesystem::path& err) {
    std::vector<char*> pointers;
    for (std::string& argument : arguments) pointers.push_back(argument.data());
    pointers.push_back(nullptr);
    const pid_t parent = ::getpid();
    const pid_t child = ::fork();
    if (child != 0) return child > 0 ? child : -errno;

    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (::getppid() != parent) ::_exit(127);
    // Signals that we have blocked for ourselves must end the child.
    sigset_t none;
    sigemptyset(&none);
    ::sigprocmask(SIG_SETMASK, &none, nullptr);
    ::dup2(out, STDOUT_FILENO);
    const int log = ::open(err.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    if (log >= 0) ::dup2(log, STDERR_FILENO);
    ::execv(pointers[0], pointers.data());
    ::_exit(127);
}

std::string textOf(const std::filesystem::path& file) {
    std::ostringstream text;
    text << std::ifstream(file).rdbuf();
    return text.str();
}

// "VmRSS:	  1234 kB" in bytes; 0 where there is no such line.
std::uint64_t statusBytes(const std::string& status, const std::string& key) {
    const auto at = status.find("\n" + key + ":");
    return at == std::string::npos ? 0
                                   : std::strtoull(status.c_str() + at + key.size() + 2, nullptr, 10) << 10;
}

// All series of a counter, added up.
double metric(const std::string& metrics, const std::string& name) {
    double sum = 0;
    std::istringstream lines(metrics);
    for (std::string line; std::getline(lines, line);) {
        if (!line.starts_with(name) || line.size() <= name.size()) continue;
        if (line[name.size()] != ' ' && line[name.size()] != '{') continue;
        sum += std::strtod(line.c_str() + line.rfind(' '), nullptr);
    }
    return sum;
}

}  // namespace

Result<std::unique_ptr<ServerProcess>> ServerProcess::start(const std::filesystem::path& folder,
                                                            const std::filesystem::path& scratch,
                                                            std::vector<std::string> options) {
    const Result<std::filesystem::path> program = ownProgram();
    if (!program) return tl::unexpected(program.error());
    std::vector<std::string> arguments{program->string(), "serve", folder.string(), "--listen",
                                       "127.0.0.1:0"};
    arguments.insert(arguments.end(), options.begin(), options.end());

    std::unique_ptr<ServerProcess> server(new ServerProcess);
    server->dataset_ = folder.stem().string();
    server->err_ = scratch / "serve.err";
    int ends[2];
    if (::pipe2(ends, O_CLOEXEC) != 0) return ioError("make", "a pipe", errno);
    server->out_ = ends[0];
    server->child_ = spawnServer(arguments, ends[1], server->err_);
    ::close(ends[1]);
    if (server->child_ < 0) return ioError("start", *program, -server->child_);
    if (Result<void> listens = server->awaitPort(); !listens) return tl::unexpected(listens.error());
    return server;
}

Result<void> ServerProcess::awaitPort() {
    const std::string before = "listening on http://127.0.0.1:";
    std::string said;
    const auto deadline = std::chrono::steady_clock::now() + kPatience;
    for (;;) {
        const auto at = said.find(before);
        if (at != std::string::npos && said.find(' ', at + before.size()) != std::string::npos) {
            const char* digits = said.data() + at + before.size();
            if (std::from_chars(digits, said.data() + said.size(), port_).ec == std::errc()) return {};
        }
        const auto left =
            std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
        pollfd ready{out_, POLLIN, 0};
        char buffer[512];
        const ssize_t got = left.count() > 0 && ::poll(&ready, 1, int(left.count())) > 0
                                ? ::read(out_, buffer, sizeof buffer)
                                : 0;
        if (got <= 0)
            return fail(ErrorCode::kIo, fmt::format("brickyard serve does not listen: {}", textOf(err_)));
        said.append(buffer, std::size_t(got));
    }
}

ServerProcess::~ServerProcess() {
    if (out_ >= 0) ::close(out_);
    if (child_ <= 0) return;
    ::kill(child_, SIGTERM);
    const auto deadline = std::chrono::steady_clock::now() + kPatience;
    while (::waitpid(child_, nullptr, WNOHANG) == 0) {
        if (std::chrono::steady_clock::now() > deadline) ::kill(child_, SIGKILL);
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
}

Result<ServerUsage> ServerProcess::usage() const {
    const std::filesystem::path folder = fmt::format("/proc/{}", child_);
    const std::string status = textOf(folder / "status"), stat = textOf(folder / "stat");
    ServerUsage usage;
    usage.resident_bytes = statusBytes(status, "VmRSS");
    usage.peak_bytes = statusBytes(status, "VmHWM");
    // The program's name stands in brackets and may have anything in it; utime and stime are the 12th and
    // 13th field behind it.
    std::istringstream fields(stat.substr(std::min(stat.rfind(')') + 1, stat.size())));
    std::string skipped;
    for (int i = 0; i < 11; ++i) fields >> skipped;
    double user = 0, system = 0;
    fields >> user >> system;
    usage.cpu_seconds = (user + system) / double(::sysconf(_SC_CLK_TCK));

    const Result<std::string> metrics = loopbackGet(port_, "/metrics");
    if (!metrics) return tl::unexpected(metrics.error());
    usage.errors = std::uint64_t(metric(*metrics, "brickyard_errors_total"));
    usage.refused = std::uint64_t(metric(*metrics, "brickyard_connections_refused_total"));
    usage.wishes = std::uint64_t(metric(*metrics, "brickyard_wishes_total"));
    usage.pages = std::uint64_t(metric(*metrics, "brickyard_pages_sent_total"));
    return usage;
}

nlohmann::json usageJson(const ServerUsage& before, const ServerUsage& after, double seconds) {
    const double cpu = after.cpu_seconds - before.cpu_seconds;
    return {{"cpu_seconds", cpu},
            {"cores_busy", cpu / seconds},
            {"resident_bytes", after.resident_bytes},
            {"peak_bytes", after.peak_bytes},
            {"errors", after.errors - before.errors},
            {"refused", after.refused - before.refused},
            {"wishes", after.wishes - before.wishes},
            {"pages_sent", after.pages - before.pages}};
}

std::string usageText(const ServerUsage& before, const ServerUsage& after, double seconds) {
    const double cpu = after.cpu_seconds - before.cpu_seconds;
    return fmt::format(
        "server: {:.2f} CPU s ({:.2f} cores), {:.1f} MB resident, {:.1f} MB at most, {} errors, "
        "{} refused",
        cpu, cpu / seconds, double(after.resident_bytes) * 1e-6, double(after.peak_bytes) * 1e-6,
        after.errors - before.errors, after.refused - before.refused);
}

}  // namespace brickyard

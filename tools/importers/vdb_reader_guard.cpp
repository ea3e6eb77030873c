#include "tools/importers/vdb_reader_guard.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <fstream>

#include "core/io_error.h"
#include "core/printable_name.h"
#include "tools/importers/openvdb_source.h"

// GCC defines macros, clang has features; neither understands the other's test.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define BRICKYARD_UNDER_SANITIZER
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer) || __has_feature(memory_sanitizer)
#define BRICKYARD_UNDER_SANITIZER
#endif
#endif

extern char** environ;

namespace brickyard {
namespace {

// libopenvdb 10 reads file versions from 212 on; those before 220 (2012) have no writer left and were never
// tested.
constexpr std::uint32_t kOldestVersion = 220;
constexpr std::uint32_t kNewestVersion = 224;
constexpr std::uint64_t kMagic = 0x56444220;

// Reads the beginning of a .vdb with every length compared with the file's size first.
class ShapeReader {
public:
    explicit ShapeReader(const std::filesystem::path& path) : path_(path), stream_(path, std::ios::binary) {
        stream_.seekg(0, std::ios::end);
        size_ = stream_ ? std::uint64_t(stream_.tellg()) : 0;
        stream_.seekg(0);
    }
    bool opened() const { return bool(stream_); }
    std::uint64_t size() const { return size_; }
    std::uint64_t position() const { return position_; }
    bool good() const { return good_; }

    template <class T>
    T number() {
        T value{};
        bytes(reinterpret_cast<char*>(&value), sizeof value);
        return value;
    }
    void skip(std::uint64_t count) {
        if (!good_ || count > size_ - position_) return void(good_ = false);
        position_ += count;
        stream_.seekg(std::streamoff(position_));
    }
    void seek(std::uint64_t to) {
        if (!good_ || to > size_) return void(good_ = false);
        position_ = to;
        stream_.seekg(std::streamoff(to));
    }
    void skipString() { skip(number<std::uint32_t>()); }
    std::string string() {
        const auto length = number<std::uint32_t>();
        if (!good_ || length > size_ - position_) return good_ = false, std::string();
        std::string text(length, '\0');
        bytes(text.data(), length);
        return text;
    }

private:
    void bytes(char* out, std::uint64_t count) {
        if (!good_ || count > size_ - position_ || !stream_.read(out, std::streamsize(count)))
            good_ = false;
        else
            position_ += count;
    }
    std::filesystem::path path_;
    std::ifstream stream_;
    std::uint64_t size_ = 0, position_ = 0;
    bool good_ = true;
};

// Every reader allocates: a leaf of one value is some tens of bytes in the file and 12 KiB in memory as
// vec3d.
std::uint64_t defaultMemory(std::uint64_t file_bytes) { return (std::uint64_t(2) << 30) + 256 * file_bytes; }
std::chrono::seconds defaultTime(std::uint64_t file_bytes) {
    return std::chrono::seconds(20 + file_bytes / (1u << 20));
}

std::uint64_t sizeOf(const std::filesystem::path& file) {
    struct stat status{};
    return ::stat(file.c_str(), &status) == 0 ? std::uint64_t(status.st_size) : 0;
}

VdbLimits filledIn(const std::filesystem::path& file, VdbLimits limits) {
    const std::uint64_t bytes = sizeOf(file);
    constexpr std::uint64_t kLeast = std::uint64_t(2) << 30;
    limits.memory_bytes =
        limits.memory_bytes == 0 ? defaultMemory(bytes) : std::max(limits.memory_bytes, kLeast);
    if (limits.cpu_time.count() == 0) limits.cpu_time = defaultTime(bytes);
    return limits;
}

// The child's verdict, at most this much of it.
constexpr std::size_t kMaxVerdict = 64u << 10;

struct ChildEnd {
    std::string output;
    int status = 0;
    bool timed_out = false;
};

// Runs the probe and gathers what it says. `deadline` is in wall time: a child may also hang without using
// any CPU.
Result<ChildEnd> runChild(const std::filesystem::path& program, std::vector<std::string> arguments,
                          std::chrono::seconds deadline) {
    int ends[2];
    if (::pipe2(ends, O_CLOEXEC) != 0) return ioError("make a pipe for", program, errno);
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawn_file_actions_adddup2(&actions, ends[1], STDOUT_FILENO);
    // What a crash handler or a sanitizer says there is no line of ours.
    ::posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
    ::posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    pid_t child = -1;
    const int spawned = ::posix_spawn(&child, program.c_str(), &actions, nullptr, argv.data(), environ);
    ::posix_spawn_file_actions_destroy(&actions);
    ::close(ends[1]);
    if (spawned != 0) {
        ::close(ends[0]);
        return ioError("start", program, spawned);
    }

    ChildEnd end;
    const auto give_up = std::chrono::steady_clock::now() + deadline;
    for (;;) {
        const auto left =
            std::chrono::duration_cast<std::chrono::milliseconds>(give_up - std::chrono::steady_clock::now());
        if (left.count() <= 0) {
            end.timed_out = true;
            break;
        }
        pollfd wait{ends[0], POLLIN, 0};
        const int ready = ::poll(&wait, 1, int(std::min<std::int64_t>(left.count(), 60'000)));
        if (ready < 0 && errno != EINTR) break;
        if (ready <= 0) continue;
        char buffer[4096];
        const ssize_t got = ::read(ends[0], buffer, sizeof buffer);
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0 || end.output.size() >= kMaxVerdict) break;
        end.output.append(buffer, std::size_t(got));
    }
    ::close(ends[0]);
    if (end.timed_out) ::kill(child, SIGKILL);
    while (::waitpid(child, &end.status, 0) < 0 && errno == EINTR) {
    }
    return end;
}

}  // namespace

Result<void> checkVdbShape(const std::filesystem::path& file) {
    struct stat status{};
    if (::stat(file.c_str(), &status) != 0) return ioError("open", file, errno);
    if (!S_ISREG(status.st_mode))
        return fail(ErrorCode::kInvalid, fmt::format("{}: not a file; give .vdb files", file.string()));
    ShapeReader reader(file);
    if (!reader.opened()) return ioError("open", file, EACCES);
    const auto corrupt = [&](const std::string& what) {
        return fail(ErrorCode::kCorrupt, fmt::format("{}: {}; write the file again", file.string(), what));
    };

    // Archive: i64 magic, u32 file version, 2 x u32 library version, u8 offsets are there, (u8 compression
    // before version 222), 36 bytes of UUID, metadata, i32 number of grids.
    if (reader.number<std::uint64_t>() != kMagic || !reader.good()) return corrupt("not an OpenVDB file");
    const auto version = reader.number<std::uint32_t>();
    if (!reader.good()) return corrupt(fmt::format("an OpenVDB file cut off after {} bytes", reader.size()));
    if (version > kNewestVersion)
        return fail(ErrorCode::kTooNew,
                    fmt::format("{}: OpenVDB file version {} is newer than {}; save it for OpenVDB "
                                "10 or older",
                                file.string(), version, kNewestVersion));
    if (version < kOldestVersion)
        return fail(ErrorCode::kUnsupported,
                    fmt::format("{}: OpenVDB file version {} is older than {}; save it with a "
                                "newer program",
                                file.string(), version, kOldestVersion));
    reader.skip(8);
    const bool has_offsets = reader.number<char>() != 0;
    if (version < 222) reader.skip(1);
    reader.skip(36);
    const auto metadata = reader.number<std::uint32_t>();
    for (std::uint32_t i = 0; i < metadata && reader.good(); ++i) {
        reader.skipString();
        reader.skipString();
        reader.skip(reader.number<std::uint32_t>());
    }
    const auto grids = reader.number<std::int32_t>();
    if (!reader.good() || grids < 0) return corrupt("its header is cut off or damaged");
    if (!has_offsets) return {};  // grids follow each other without a table: nothing more to see from here

    for (std::int32_t i = 0; i < grids; ++i) {
        const std::string name = reader.string();
        reader.skipString();  // type
        reader.skipString();  // instance parent
        const auto grid_at = reader.number<std::int64_t>();
        reader.skip(8);
        const auto end = reader.number<std::int64_t>();
        if (!reader.good())
            return corrupt(fmt::format("cut off or damaged at byte {}, in the head of grid {} of {}",
                                       reader.position(), i + 1, grids));
        if (grid_at < std::int64_t(reader.position()) || end < grid_at || end > std::int64_t(reader.size()))
            return corrupt(fmt::format("grid '{}' claims bytes [{}, {}) of {}",
                                       printableName(name.substr(0, name.find('\x1e'))), grid_at, end,
                                       reader.size()));
        reader.seek(std::uint64_t(end));
    }
    return {};
}

Result<void> checkVdb(const std::filesystem::path& file, const std::vector<std::string>& channels,
                      const VdbLimits& asked, const std::filesystem::path& program) {
    if (auto shape = checkVdbShape(file); !shape) return shape;
    const VdbLimits limits = filledIn(file, asked);
    std::error_code error;
    const std::filesystem::path self =
        program.empty() ? std::filesystem::read_symlink("/proc/self/exe", error) : program;
    std::vector<std::string> arguments{self.string(), kProbeCommand,
                                       "--memory",    std::to_string(limits.memory_bytes),
                                       "--seconds",   std::to_string(limits.cpu_time.count())};
    for (const std::string& channel : channels) arguments.insert(arguments.end(), {"--channel", channel});
    arguments.insert(arguments.end(), {"--", file.string()});

    // The machine may be busy: wall time is more patient than CPU time.
    const auto child = runChild(self, std::move(arguments), 5 * limits.cpu_time);
    if (!child) return tl::unexpected(child.error());
    const std::string again = "write the file again";
    const bool exited = WIFEXITED(child->status);
    if (exited && WEXITSTATUS(child->status) == 0 && child->output == "ok\n") return {};
    // "CODE message", one line.
    const std::size_t space = child->output.find(' ');
    if (exited && WEXITSTATUS(child->status) == 1 && space != std::string::npos &&
        child->output.ends_with('\n')) {
        const int code = std::atoi(child->output.c_str());
        return fail(ErrorCode(code), child->output.substr(space + 1, child->output.size() - space - 2));
    }
    const bool cpu = WIFSIGNALED(child->status) &&
                     (WTERMSIG(child->status) == SIGXCPU || WTERMSIG(child->status) == SIGKILL);
    if (child->timed_out || cpu)
        return fail(ErrorCode::kCorrupt,
                    fmt::format("{}: reading it did not end within {} s; it is probably damaged, {}",
                                file.string(), limits.cpu_time.count(), again));
    return fail(ErrorCode::kCorrupt,
                fmt::format("{}: damaged: it crashes OpenVDB's reader ({}); {}", file.string(),
                            exited ? fmt::format("status {}", WEXITSTATUS(child->status))
                                   : std::string(::strsignal(WTERMSIG(child->status))),
                            again));
}

int runVdbProbe(const std::filesystem::path& file, const std::vector<std::string>& channels,
                const VdbLimits& asked) {
    const VdbLimits limits = filledIn(file, asked);
    const auto set = [](decltype(RLIMIT_AS) what, std::uint64_t value) {
        rlimit limit{};
        if (::getrlimit(what, &limit) != 0) return;
        limit.rlim_cur = std::min<rlim_t>(limit.rlim_max, value);
        ::setrlimit(what, &limit);
    };
    set(RLIMIT_CORE, 0);
    set(RLIMIT_CPU, std::uint64_t(limits.cpu_time.count()));
#ifndef BRICKYARD_UNDER_SANITIZER
    // Without a sanitizer, which reserves terabytes for itself, a limit on address space is a limit on
    // memory.
    std::uint64_t pages = 0;
    std::ifstream("/proc/self/statm") >> pages;
    set(RLIMIT_AS, pages * std::uint64_t(::sysconf(_SC_PAGESIZE)) + limits.memory_bytes);
#endif
    const auto contents = readVdb(file, channels);
    if (contents) {
        fmt::print("ok\n");
        std::fflush(stdout);
        // Freeing a large tree takes as long as reading it, and nobody needs it any more.
        ::_exit(0);
    }
    fmt::print("{} {}\n", int(contents.error().code), contents.error().message);
    return 1;
}

}  // namespace brickyard

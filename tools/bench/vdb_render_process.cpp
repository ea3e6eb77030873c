#include "tools/bench/vdb_render_process.h"

#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputFile.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <thread>

#include "core/io_error.h"

namespace brickyard {
namespace {

constexpr std::chrono::minutes kDeadline{10};

template <class Numbers>
std::string triple(const Numbers& v) {
    return fmt::format("{:.17g},{:.17g},{:.17g}", v[0], v[1], v[2]);
}

std::vector<std::string> argumentsOf(const std::filesystem::path& program, const VdbRenderJob& job,
                                     const std::filesystem::path& picture) {
    const double scatter = job.extinction * job.albedo, absorb = job.extinction - scatter;
    const glm::dvec3 light(job.light);
    return {program.string(),
            job.file.string(),
            picture.string(),
            "-name",
            job.grid,
            "-res",
            fmt::format("{}x{}", job.size, job.size),
            "-translate",
            triple(job.camera.eye()),
            "-lookat",
            triple(job.camera.target()),
            "-up",
            triple(job.camera.up()),
            "-fov",
            fmt::format("{:.17g}", job.camera.vertical_fov_degrees()),
            "-scatter",
            triple(glm::dvec3(scatter)),
            "-absorb",
            triple(glm::dvec3(absorb)),
            "-light",
            triple(job.to_light) + "," + triple(light),
            "-gain",
            "0",
            "-v"};
}

// The child's exit status; what it says goes to `log`.
Result<int> runProgram(std::vector<std::string> arguments, const std::filesystem::path& log) {
    std::vector<char*> pointers;
    for (std::string& argument : arguments) pointers.push_back(argument.data());
    pointers.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, log.c_str(), O_WRONLY | O_CREAT | O_TRUNC,
                                       0600);
    ::posix_spawn_file_actions_adddup2(&actions, STDOUT_FILENO, STDERR_FILENO);
    pid_t child = 0;
    const int error = ::posix_spawn(&child, pointers[0], &actions, nullptr, pointers.data(), environ);
    ::posix_spawn_file_actions_destroy(&actions);
    if (error != 0) return ioError("start", arguments[0], error);

    const auto deadline = std::chrono::steady_clock::now() + kDeadline;
    int status = 0;
    for (;;) {
        const pid_t ended = ::waitpid(child, &status, WNOHANG);
        if (ended == child) return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
        if (ended < 0 && errno != EINTR) return ioError("wait for", arguments[0], errno);
        if (std::chrono::steady_clock::now() > deadline) {
            ::kill(child, SIGKILL);
            ::waitpid(child, &status, 0);
            return fail(
                ErrorCode::kTimeout,
                fmt::format("{}: gave no picture in ten minutes; use a smaller --size", arguments[0]));
        }
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
}

// It reports "ray-tracing NAME..." and then "...completed in 0.542 sec".
std::optional<double> tracingSeconds(const std::string& said) {
    const std::string begin = "ray-tracing", mark = "...completed in ";
    const std::size_t tracing = said.find(begin);
    const std::size_t found = tracing == std::string::npos ? tracing : said.find(mark, tracing);
    if (found == std::string::npos) return std::nullopt;
    double seconds = 0;
    const char* number = said.data() + found + mark.size();
    if (std::from_chars(number, said.data() + said.size(), seconds).ec != std::errc()) return std::nullopt;
    return seconds;
}

Result<std::vector<float>> readRed(const std::filesystem::path& file, std::uint32_t size) {
    try {
        Imf::InputFile input(file.c_str());
        const auto window = input.header().dataWindow();
        if (window.max.x - window.min.x + 1 != int(size) || window.max.y - window.min.y + 1 != int(size))
            return fail(ErrorCode::kUnsupported,
                        fmt::format("{}: is of another size than asked for", file.string()));
        std::vector<float> red(std::size_t(size) * size);
        Imf::FrameBuffer frame;
        frame.insert("R", Imf::Slice::Make(Imf::FLOAT, red.data(), window));
        input.setFrameBuffer(frame);
        input.readPixels(window.min.y, window.max.y);
        return red;
    } catch (const std::exception& error) {
        return fail(ErrorCode::kIo,
                    fmt::format("{}: OpenEXR cannot read it: {}", file.string(), error.what()));
    }
}

}  // namespace

std::optional<std::filesystem::path> findVdbRender() {
    const char* path = std::getenv("PATH");
    std::istringstream folders(path ? path : "");
    for (std::string folder; std::getline(folders, folder, ':');) {
        const std::filesystem::path program = std::filesystem::path(folder) / "vdb_render";
        if (!folder.empty() && ::access(program.c_str(), X_OK) == 0) return program;
    }
    return std::nullopt;
}

Result<VdbRenderPicture> runVdbRender(const std::filesystem::path& program, const VdbRenderJob& job,
                                      const std::filesystem::path& scratch) {
    const std::filesystem::path picture = scratch / "vdb_render.exr", log = scratch / "vdb_render.log";
    const Result<int> status = runProgram(argumentsOf(program, job, picture), log);
    if (!status) return tl::unexpected(status.error());
    std::ostringstream said;
    said << std::ifstream(log).rdbuf();
    const std::optional<double> seconds = tracingSeconds(said.str());
    if (*status != 0 || !seconds)
        return fail(ErrorCode::kUnsupported,
                    fmt::format("{}: {}; it is left out of the comparison", program.string(),
                                *status != 0 ? fmt::format("ended with status {}", *status)
                                             : "did not say how long it traced rays"));
    Result<std::vector<float>> red = readRed(picture, job.size);
    if (!red) return tl::unexpected(red.error());
    return VdbRenderPicture{*seconds, std::move(*red)};
}

}  // namespace brickyard

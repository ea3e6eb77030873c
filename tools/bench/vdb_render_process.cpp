#include "tools/bench/vdb_render_process.h"

#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputFile.h>
#include <fmt/format.h>

#include <charconv>
#include <chrono>
#include <fstream>
#include <sstream>

#include "tools/bench/child_process.h"

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

std::optional<std::filesystem::path> findVdbRender() { return findProgram("vdb_render"); }

Result<VdbRenderPicture> runVdbRender(const std::filesystem::path& program, const VdbRenderJob& job,
                                      const std::filesystem::path& scratch) {
    const std::filesystem::path picture = scratch / "vdb_render.exr", log = scratch / "vdb_render.log";
    const Result<ChildRun> run = runChild(argumentsOf(program, job, picture), log, log, kDeadline);
    if (!run) return tl::unexpected(run.error());
    std::ostringstream said;
    said << std::ifstream(log).rdbuf();
    const std::optional<double> seconds = tracingSeconds(said.str());
    if (run->status != 0 || !seconds)
        return fail(ErrorCode::kUnsupported,
                    fmt::format("{}: {}; it is left out of the comparison", program.string(),
                                run->status != 0 ? fmt::format("ended with status {}", run->status)
                                                 : "did not say how long it traced rays"));
    Result<std::vector<float>> red = readRed(picture, job.size);
    if (!red) return tl::unexpected(red.error());
    return VdbRenderPicture{*seconds, std::move(*red)};
}

}  // namespace brickyard

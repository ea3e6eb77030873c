#include "tools/frame_plan.h"

#include <fmt/format.h>
#include <glob.h>

#include <charconv>
#include <map>

namespace brickyard {

std::optional<std::uint32_t> frameNumber(const std::filesystem::path& file) {
    constexpr const char* kDigits = "0123456789";
    const std::string stem = file.stem();
    const std::size_t last = stem.find_last_of(kDigits);
    if (last == std::string::npos) return std::nullopt;
    const std::size_t before = stem.find_last_not_of(kDigits, last);
    const std::size_t first = before == std::string::npos ? 0 : before + 1;
    if (last + 1 - first > 9) return std::nullopt;
    std::uint32_t number = 0;
    std::from_chars(stem.data() + first, stem.data() + last + 1, number);
    return number;
}

Result<std::vector<std::filesystem::path>> expandInputs(const std::vector<std::string>& inputs) {
    std::vector<std::filesystem::path> files;
    for (const std::string& input : inputs) {
        std::error_code error;
        if (std::filesystem::exists(input, error)) {
            files.emplace_back(input);
            continue;
        }
        if (input.find_first_of("*?[") == std::string::npos)
            return fail(ErrorCode::kNotFound, fmt::format("{}: no such file; check the path", input));
        glob_t found{};
        if (::glob(input.c_str(), 0, nullptr, &found) == 0)
            files.insert(files.end(), found.gl_pathv, found.gl_pathv + found.gl_pathc);
        const bool none = found.gl_pathc == 0;
        ::globfree(&found);
        if (none)
            return fail(ErrorCode::kNotFound, fmt::format("{}: no file matches; check the pattern", input));
    }
    return files;
}

std::vector<FrameInputs> planFrames(const std::vector<std::filesystem::path>& files) {
    std::map<std::uint32_t, FrameInputs> frames;
    std::uint32_t unnumbered = 0;
    for (const std::filesystem::path& file : files) {
        const auto number = frameNumber(file);
        const std::uint32_t frame = number ? *number : unnumbered++;
        frames[frame].frame = frame;
        frames[frame].files.push_back(file);
    }
    std::vector<FrameInputs> plan;
    for (auto& [number, frame] : frames) plan.push_back(std::move(frame));
    return plan;
}

}  // namespace brickyard

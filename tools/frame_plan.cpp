#include "tools/frame_plan.h"

#include <fmt/format.h>
#include <glob.h>

#include <algorithm>
#include <charconv>
#include <map>

namespace brickyard {
namespace {

constexpr const char* kDigits = "0123456789";
// Nine digits: what frameNumber takes for a frame.
constexpr std::uint32_t kLastFrame = 999'999'999;

struct NumberedFile {
    std::filesystem::path path;
    std::optional<std::uint32_t> frame;
};

// Where a pattern has its frame number.
struct NumberPlace {
    std::filesystem::path folder;
    std::string prefix, suffix;  // of the file's name
    std::size_t least_digits;    // shorter numbers have zeros in front, longer ones none
};

std::optional<NumberPlace> findNumberPlace(const std::string& pattern) {
    const std::filesystem::path path(pattern);
    const std::string name = path.filename();
    NumberPlace place{path.parent_path(), "", "", 1};
    const auto split = [&](std::size_t begin, std::size_t end) {
        place.prefix = name.substr(0, begin);
        place.suffix = name.substr(end);
        return place;
    };
    for (std::size_t begin = 0; begin < name.size(); ++begin) {
        if (name[begin] == '#') {
            const std::size_t end = std::min(name.find_first_not_of('#', begin), name.size());
            place.least_digits = end - begin;
            return split(begin, end);
        }
        const bool houdini = name.compare(begin, 2, "$F") == 0;
        if (!houdini && name[begin] != '%') continue;
        // %d, %04d; $F, $F4.
        const std::size_t digits = begin + (houdini ? 2 : 1);
        std::size_t end = std::min(name.find_first_not_of(kDigits, digits), name.size());
        if (end - digits > 2) continue;
        if (end > digits) std::from_chars(name.data() + digits, name.data() + end, place.least_digits);
        if (!houdini && (end == name.size() || name[end++] != 'd')) continue;
        return split(begin, end);
    }
    return std::nullopt;
}

void addSequence(const NumberPlace& place, std::vector<NumberedFile>& files) {
    std::map<std::uint32_t, std::filesystem::path> found;
    std::error_code error;
    const std::filesystem::path folder = place.folder.empty() ? "." : place.folder;
    for (std::filesystem::directory_iterator it(folder, error), end; !error && it != end;
         it.increment(error)) {
        const std::string name = it->path().filename();
        if (name.size() <= place.prefix.size() + place.suffix.size() || !name.starts_with(place.prefix) ||
            !name.ends_with(place.suffix))
            continue;
        const std::string digits =
            name.substr(place.prefix.size(), name.size() - place.prefix.size() - place.suffix.size());
        const bool padded = digits.size() > place.least_digits && digits[0] == '0';
        if (digits.find_first_not_of(kDigits) != std::string::npos || digits.size() < place.least_digits ||
            digits.size() > 9 || padded)
            continue;
        std::uint32_t number = 0;
        std::from_chars(digits.data(), digits.data() + digits.size(), number);
        found.emplace(number, place.folder / name);
    }
    for (const auto& [number, path] : found) files.push_back({path, number});
}

void addGlob(const std::string& pattern, std::vector<NumberedFile>& files) {
    glob_t found{};
    if (::glob(pattern.c_str(), 0, nullptr, &found) == 0)
        for (std::size_t i = 0; i < found.gl_pathc; ++i)
            files.push_back({found.gl_pathv[i], frameNumber(found.gl_pathv[i])});
    ::globfree(&found);
}

}  // namespace

std::optional<std::uint32_t> frameNumber(const std::filesystem::path& file) {
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

Result<FrameSet> FrameSet::parse(const std::string& text) {
    const auto invalid = [&] {
        return fail(ErrorCode::kInvalid,
                    fmt::format("'{}' does not list frames; write 10-19, or 1,5,10-20:2", text));
    };
    FrameSet set;
    const char* at = text.data();
    const char* const end = at + text.size();
    const auto number = [&](std::uint32_t& value) {
        const auto parsed = std::from_chars(at, end, value);
        at = parsed.ptr;
        return parsed.ec == std::errc() && value <= kLastFrame;
    };
    const auto accept = [&](char c) { return at != end && *at == c && ++at; };
    do {
        Range range{0, 0, 1};
        if (!number(range.first)) return invalid();
        range.last = range.first;
        if (accept('-') && (!number(range.last) || range.last < range.first)) return invalid();
        if ((accept(':') || accept('x')) && (!number(range.step) || range.step == 0)) return invalid();
        set.ranges_.push_back(range);
    } while (accept(','));
    if (at != end) return invalid();
    return set;
}

bool FrameSet::contains(std::uint32_t frame) const {
    return std::ranges::any_of(ranges_, [&](const Range& range) {
        return frame >= range.first && frame <= range.last && (frame - range.first) % range.step == 0;
    });
}

std::optional<std::uint32_t> FrameSet::firstMissing(const std::set<std::uint32_t>& there) const {
    std::optional<std::uint32_t> missing;
    for (const Range& range : ranges_)
        // In 64 bits: a step may lead beyond the last number there can be.
        for (std::uint64_t frame = range.first; frame <= range.last; frame += range.step)
            if (!there.contains(std::uint32_t(frame))) {
                missing = std::min(missing.value_or(UINT32_MAX), std::uint32_t(frame));
                break;
            }
    return missing;
}

Result<std::vector<FrameInputs>> planInputs(const std::vector<std::string>& inputs) {
    std::vector<NumberedFile> files;
    for (const std::string& input : inputs) {
        std::error_code error;
        if (std::filesystem::exists(input, error)) {
            files.push_back({input, frameNumber(input)});
            continue;
        }
        const auto place = findNumberPlace(input);
        const bool pattern = input.find_first_of("*?[") != std::string::npos;
        if (!place && !pattern)
            return fail(ErrorCode::kNotFound, fmt::format("{}: no such file; check the path", input));
        const std::size_t before = files.size();
        if (place)
            addSequence(*place, files);
        else
            addGlob(input, files);
        if (files.size() == before)
            return fail(ErrorCode::kNotFound, fmt::format("{}: no file matches; check the pattern", input));
    }

    std::map<std::uint32_t, FrameInputs> frames;
    std::uint32_t unnumbered = 0;
    for (const NumberedFile& file : files) {
        const std::uint32_t frame = file.frame ? *file.frame : unnumbered++;
        frames[frame].frame = frame;
        frames[frame].files.push_back(file.path);
    }
    std::vector<FrameInputs> plan;
    for (auto& [number, frame] : frames) plan.push_back(std::move(frame));
    return plan;
}

}  // namespace brickyard

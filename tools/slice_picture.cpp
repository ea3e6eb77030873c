#include "tools/slice_picture.h"

#include <fmt/format.h>
#include <png.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>

#include "core/printable_name.h"
#include "tools/field_walk.h"
#include "tools/output_file.h"

namespace brickyard {
namespace {

constexpr std::int64_t kMaxPixels = 1 << 26;

using Color = std::array<std::uint8_t, 3>;

// `at` in [-1, 1]: blue, white, red; evenly light, so that the sign is told by the hue alone.
Color divergingColor(double at) {
    constexpr std::array<double, 3> kBlue{33, 102, 172}, kWhite{247, 247, 247}, kRed{178, 24, 43};
    const auto& end = at < 0 ? kBlue : kRed;
    Color color{};
    for (std::size_t c = 0; c < 3; ++c)
        color[c] = std::uint8_t(std::lround(kWhite[c] + std::abs(at) * (end[c] - kWhite[c])));
    return color;
}

Color colorOf(double value, const SliceReport& report) {
    const auto [low, high] = report.range;
    if (std::isnan(value)) return {255, 0, 255};
    if (report.diverging)
        return divergingColor(
            std::clamp(value / std::max({std::abs(low), std::abs(high), 1e-300}), -1.0, 1.0));
    const double at = high > low ? std::clamp((value - low) / (high - low), 0.0, 1.0) : value > low;
    const auto grey = std::uint8_t(std::lround(255 * at));
    return {grey, grey, grey};
}

// The box of active voxels, as voxels of a level.
IndexBox activeBox(const ChannelFooter& channel, int level) {
    IndexBox box;
    for (int a = 0; a < 3; ++a) {
        box.begin[std::size_t(a)] = std::int64_t(channel.active_min(a)) >> level;
        box.end[std::size_t(a)] = (std::int64_t(channel.active_max(a)) >> level) + 1;
    }
    return box;
}

std::array<double, 2> valueRange(const FieldReader& reader) {
    const double low = reader.channel().value_min(), high = reader.channel().value_max();
    if (reader.components() == 1) return {low, high};
    return {0, std::max(std::abs(low), std::abs(high))};
}

Result<void> writePng(const std::filesystem::path& file, const SliceReport& report,
                      const std::vector<Color>& pixels) {
    OutputFile output(file);
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    image.width = png_uint_32(report.width);
    image.height = png_uint_32(report.height);
    image.format = PNG_FORMAT_RGB;
    errno = 0;
    if (!png_image_write_to_file(&image, output.temporary().c_str(), 0, pixels.data(), 0, nullptr))
        return ioError("write", file, errno ? errno : EIO);
    return output.commit();
}

}  // namespace

Result<SliceRequest> parseSlice(const std::string& text) {
    SliceRequest request;
    std::int32_t position = 0;
    const char* const end = text.data() + text.size();
    const bool axis = text.size() > 2 && text[0] >= 'x' && text[0] <= 'z' && text[1] == '=';
    const auto parsed = axis ? std::from_chars(text.data() + 2, end, position) : std::from_chars_result{};
    if (!axis || parsed.ec != std::errc() || parsed.ptr != end)
        return fail(
            ErrorCode::kInvalid,
            fmt::format("'{}' is no slice; write x=, y= or z= and a voxel of level 0, for example z=40",
                        text));
    request.axis = text[0] - 'x';
    request.position = position;
    return request;
}

Result<SliceReport> writeSlice(const FieldReader& reader, const SliceRequest& request,
                               const std::filesystem::path& file) {
    const ChannelFooter& channel = reader.channel();
    const auto refuse = [&](const std::string& what) {
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: channel '{}' {}", file.string(), printableName(channel.name()), what));
    };
    if (channel.active_min().empty()) return refuse("has no active voxels to show; choose another");
    // Rightwards and upwards.
    const int right = request.axis == 0 ? 1 : 0, up = request.axis == 2 ? 1 : 2;
    SliceReport report;
    if (request.level) {
        report.level = *request.level;
        if (std::uint32_t(report.level) >= std::max(channel.levels(), 1u))
            return refuse(fmt::format("has {} levels; choose a lower --level", channel.levels()));
    } else {
        while (std::uint32_t(report.level) + 1 < channel.levels() &&
               std::max(activeBox(channel, report.level).extent(right),
                        activeBox(channel, report.level).extent(up)) > kSlicePixels)
            ++report.level;
    }
    report.box = activeBox(channel, report.level);
    const std::int64_t plane = request.position >> report.level;
    const auto axis = std::size_t(request.axis);
    if (plane < report.box.begin[axis] || plane >= report.box.end[axis])
        return refuse(fmt::format("has active voxels from {} to {} there, not at {}; choose one of these",
                                  channel.active_min(request.axis), channel.active_max(request.axis),
                                  request.position));
    report.box.begin[axis] = plane;
    report.box.end[axis] = plane + 1;
    report.width = report.box.extent(right);
    report.height = report.box.extent(up);
    if (report.width * report.height > kMaxPixels)
        return refuse(fmt::format("is {} x {} voxels there, too many for a picture; choose a coarser --level",
                                  report.width, report.height));
    report.range = request.range.value_or(valueRange(reader));
    report.diverging = report.range[0] < 0 && report.range[1] > 0;

    SampleBlock block;
    if (auto read = readLevel(reader, report.level, report.box, block); !read)
        return tl::unexpected(read.error());
    const SampleType type = walkedType(reader.type(), report.level);
    const std::size_t count = block.active.size();
    std::vector<Color> pixels(count);
    for (std::size_t i = 0; i < count; ++i) {
        double value = toDouble(type, sampleBits(type, block.values, i));
        if (reader.components() > 1) {
            double squares = 0;
            for (std::size_t c = 0; c < std::size_t(reader.components()); ++c)
                squares += std::pow(toDouble(type, sampleBits(type, block.values, c * count + i)), 2);
            value = std::sqrt(squares);
        }
        // The block runs along `right` first, then `up`; a picture's first row is its top.
        const std::size_t column = i % std::size_t(report.width), row = i / std::size_t(report.width);
        pixels[(std::size_t(report.height) - 1 - row) * std::size_t(report.width) + column] =
            colorOf(value, report);
    }
    if (auto written = writePng(file, report, pixels); !written) return tl::unexpected(written.error());
    return report;
}

}  // namespace brickyard

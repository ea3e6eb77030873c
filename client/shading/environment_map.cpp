#include "client/shading/environment_map.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <exception>
#include <glm/geometric.hpp>
#include <numbers>
#include <utility>

namespace brickyard {

namespace {

constexpr std::int64_t kMostTexels = std::int64_t(1) << 26;
constexpr double kTwoPi = 2 * std::numbers::pi, kSphere = 4 * std::numbers::pi;

// Rec. 709. Above 0 where any component is.
double luminance(const glm::dvec3& color) { return 0.2126 * color.x + 0.7152 * color.y + 0.0722 * color.z; }

// Columns: where column 0.5, a quarter left of it, and the pole lie.
glm::dmat3 mapToWorld(const glm::dvec3& up, double rotation_degrees) {
    const glm::dvec3 pole = glm::normalize(up);
    const glm::dvec3 axis = std::abs(pole.x) < 0.999 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0);
    const glm::dvec3 front = glm::normalize(axis - glm::dot(axis, pole) * pole),
                     left = glm::cross(pole, front);
    const double turn = rotation_degrees * std::numbers::pi / 180;
    return {std::cos(turn) * front + std::sin(turn) * left, std::cos(turn) * left - std::sin(turn) * front,
            pole};
}

struct Texels {
    std::vector<glm::vec3> values;
    std::uint32_t width = 0;
};

Result<Texels> readTexels(const std::filesystem::path& file) {
    std::error_code ignored;
    if (!std::filesystem::is_regular_file(file, ignored))
        return fail(ErrorCode::kNotFound, fmt::format("{}: no such environment image", file.string()));
    try {
        Imf::InputFile in(file.c_str());
        const auto window = in.header().dataWindow();
        const std::int64_t width = std::int64_t(window.max.x) - window.min.x + 1;
        const std::int64_t height = std::int64_t(window.max.y) - window.min.y + 1;
        if (width < 1 || height < 1 || width > kMostTexels / height)
            return fail(ErrorCode::kUnsupported,
                        fmt::format("{}: is {} x {} texels; an environment has at most 2^26, make it smaller",
                                    file.string(), width, height));
        Texels texels{std::vector<glm::vec3>(std::size_t(width * height)), std::uint32_t(width)};
        Imf::FrameBuffer frame;
        const char* const names[] = {"R", "G", "B"};
        for (std::size_t c = 0; c < 3; ++c) {
            if (!in.header().channels().findChannel(names[c]))
                return fail(ErrorCode::kCorrupt,
                            fmt::format("{}: has no channel {}; an environment is a picture with R, G and B",
                                        file.string(), names[c]));
            // OpenEXR counts from the pixel (0, 0) of the data window's coordinates, wherever that is.
            char* base = reinterpret_cast<char*>(texels.values.data()) + c * sizeof(float);
            base -= (std::int64_t(window.min.y) * width + window.min.x) * std::int64_t(sizeof(glm::vec3));
            frame.insert(names[c], Imf::Slice(Imf::FLOAT, base, sizeof(glm::vec3),
                                              sizeof(glm::vec3) * std::size_t(width), 1, 1, 0.0));
        }
        in.setFrameBuffer(frame);
        in.readPixels(window.min.y, window.max.y);
        return texels;
    } catch (const std::exception& e) {
        return fail(ErrorCode::kCorrupt, fmt::format("{}: cannot be read: {}", file.string(), e.what()));
    }
}

}  // namespace

EnvironmentMap::EnvironmentMap(const glm::dvec3& radiance)
    : constant_(radiance), total_(luminance(radiance) * kSphere) {}

EnvironmentMap::EnvironmentMap(std::vector<glm::vec3> texels, std::uint32_t width, const glm::dvec3& up,
                               double rotation)
    : width_(width),
      height_(std::uint32_t(texels.size() / width)),
      to_world_(mapToWorld(up, rotation)),
      to_map_(glm::transpose(to_world_)),
      texels_(std::move(texels)) {
    assert(width_ > 0 && height_ > 0 && std::size_t(width_) * height_ == texels_.size());
    texel_cdf_.reserve(texels_.size());
    row_cdf_.reserve(height_);
    for (std::uint32_t row = 0; row < height_; ++row) {
        const double solid = texelSolidAngle(row);
        double sum = 0;
        for (std::uint32_t column = 0; column < width_; ++column) {
            sum += solid * luminance(glm::dvec3(texels_[std::size_t(row) * width_ + column]));
            texel_cdf_.push_back(sum);
        }
        total_ += sum;
        row_cdf_.push_back(total_);
    }
}

Result<EnvironmentMap> EnvironmentMap::read(const std::filesystem::path& file, const glm::dvec3& factor,
                                            const glm::dvec3& up, double rotation) {
    Result<Texels> texels = readTexels(file);
    if (!texels) return tl::unexpected(texels.error());
    for (std::size_t i = 0; i < texels->values.size(); ++i) {
        glm::vec3& texel = texels->values[i];
        for (int c = 0; c < 3; ++c) {
            const float value = texel[c], scaled = float(double(value) * factor[c]);
            if (!(value >= 0) || !std::isfinite(scaled))
                return fail(
                    ErrorCode::kInvalid,
                    fmt::format("{}: texel {}, {} is {}; light is finite and not negative, mend the picture",
                                file.string(), i % texels->width, i / texels->width, value));
            texel[c] = scaled;
        }
    }
    return EnvironmentMap(std::move(texels->values), texels->width, up, rotation);
}

double EnvironmentMap::rowCosine(std::uint32_t row) const {
    // Exact at the equator and the poles.
    if (row == 0) return 1;
    if (row == height_) return -1;
    return 2 * row == height_ ? 0 : std::cos(std::numbers::pi * row / height_);
}

double EnvironmentMap::texelSolidAngle(std::uint32_t row) const {
    return (rowCosine(row) - rowCosine(row + 1)) * kTwoPi / width_;
}

glm::dvec3 EnvironmentMap::texelDirection(double column, double cosine) const {
    // To the right in the picture is clockwise seen from above: one stands inside.
    const double angle = (0.5 - column / width_) * kTwoPi;
    const double sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
    return to_world_ * glm::dvec3(sine * std::cos(angle), sine * std::sin(angle), cosine);
}

std::size_t EnvironmentMap::texelAt(const glm::dvec3& direction) const {
    const glm::dvec3 d = to_map_ * direction;
    const double across = (0.5 - std::atan2(d.y, d.x) / kTwoPi) * width_;
    const double down = std::acos(std::clamp(d.z, -1.0, 1.0)) / std::numbers::pi * height_;
    const std::size_t column = std::size_t(std::clamp(across, 0.0, width_ - 1.0));
    const std::size_t row = std::size_t(std::clamp(down, 0.0, height_ - 1.0));
    return row * width_ + column;
}

glm::dvec3 EnvironmentMap::radiance(const glm::dvec3& direction) const {
    return width_ == 0 ? constant_ : glm::dvec3(texels_[texelAt(direction)]);
}

glm::dvec3 EnvironmentMap::backdrop(const glm::dvec3& direction) const {
    if (width_ == 0) return constant_;
    const glm::dvec3 d = to_map_ * direction;
    // From texel middle to texel middle; around the poles the rows end.
    const double across = (0.5 - std::atan2(d.y, d.x) / kTwoPi) * width_ - 0.5;
    const double down = std::acos(std::clamp(d.z, -1.0, 1.0)) / std::numbers::pi * height_ - 0.5;
    const double column = std::floor(across), row = std::floor(down);
    const auto texel = [&](double x, double y) {
        const auto turned = std::size_t(std::fmod(x + width_, double(width_)));
        return glm::dvec3(texels_[std::size_t(std::clamp(y, 0.0, height_ - 1.0)) * width_ + turned]);
    };
    const double u = across - column, v = down - row;
    const glm::dvec3 above = texel(column, row) * (1 - u) + texel(column + 1, row) * u;
    const glm::dvec3 below = texel(column, row + 1) * (1 - u) + texel(column + 1, row + 1) * u;
    return above * (1 - v) + below * v;
}

double EnvironmentMap::density(const glm::dvec3& direction) const {
    return total_ > 0 ? luminance(radiance(direction)) / total_ : 0;
}

EnvironmentMap::Pick EnvironmentMap::pick(double u, double v) const {
    Pick pick;
    if (!(total_ > 0)) return pick;
    if (width_ == 0) {
        const double cosine = 1 - 2 * v, sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
        pick.direction = {sine * std::cos(kTwoPi * u), sine * std::sin(kTwoPi * u), cosine};
        pick.density = 1 / kSphere;
        pick.radiance = constant_;
        return pick;
    }
    // The first whose sum is above: never one of no weight. What is left of the number chooses within it.
    const auto choose = [](const double* begin, const double* end, double number, double& rest) {
        const double wanted = number * *(end - 1);
        const double* at = std::upper_bound(begin, end, wanted);
        if (at == end) at = std::lower_bound(begin, end, *(end - 1));  // rounded up to the sum itself
        const double below = at == begin ? 0 : *(at - 1);
        rest = std::clamp((wanted - below) / (*at - below), 0.0, 1.0);
        return std::uint32_t(at - begin);
    };
    double down = 0, across = 0;
    const std::uint32_t row = choose(row_cdf_.data(), row_cdf_.data() + height_, v, down);
    const double* const sums = texel_cdf_.data() + std::size_t(row) * width_;
    const std::uint32_t column = choose(sums, sums + width_, u, across);
    const double top = rowCosine(row), bottom = rowCosine(row + 1);
    pick.direction = texelDirection(column + across, top + down * (bottom - top));
    pick.radiance = glm::dvec3(texels_[std::size_t(row) * width_ + column]);
    pick.density = luminance(pick.radiance) / total_;
    return pick;
}

}  // namespace brickyard

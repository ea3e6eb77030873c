#include "client/picture.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <fmt/format.h>
#include <png.h>
#include <span>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <exception>

namespace brickyard {

namespace {

struct Layer {
    const char* name;
    std::size_t offset;
};

const std::array<Layer, 9>& layers() {
    static const std::array<Layer, 9> all{{
        {"R", offsetof(Pixel, radiance)},
        {"G", offsetof(Pixel, radiance) + sizeof(float)},
        {"B", offsetof(Pixel, radiance) + 2 * sizeof(float)},
        {"A", offsetof(Pixel, alpha)},
        {"Z", offsetof(Pixel, depth)},
        {"errorBound.A", offsetof(Pixel, bound_alpha)},
        {"errorBound.RGB", offsetof(Pixel, bound_radiance)},
        {"errorEstimate.A", offsetof(Pixel, estimate_alpha)},
        {"errorEstimate.RGB", offsetof(Pixel, estimate_radiance)},
    }};
    return all;
}

constexpr std::size_t kAlphaLayer = 3;
constexpr std::int64_t kMostPixels = std::int64_t(1) << 28;

float& valueOf(Pixel& pixel, std::size_t layer) {
    return *reinterpret_cast<float*>(reinterpret_cast<char*>(&pixel) + layers()[layer].offset);
}
float valueOf(const Pixel& pixel, std::size_t layer) {
    return *reinterpret_cast<const float*>(reinterpret_cast<const char*>(&pixel) + layers()[layer].offset);
}

// IEC 61966-2-1.
std::uint8_t encodeSrgb(float linear) {
    const float v = std::clamp(linear, 0.0f, 1.0f);
    const float encoded = v <= 0.0031308f ? 12.92f * v : 1.055f * std::pow(v, 1 / 2.4f) - 0.055f;
    return std::uint8_t(encoded * 255 + 0.5f);
}

// A file is written beside its place and renamed: a failed write leaves no half picture.
template <class Write>
Result<void> writeThenRename(const std::filesystem::path& file, Write&& write) {
    std::filesystem::path temporary = file;
    temporary += ".part";
    std::error_code ignored, error;
    if (Result<void> written = write(temporary); !written) {
        std::filesystem::remove(temporary, ignored);
        return written;
    }
    std::filesystem::rename(temporary, file, error);
    if (!error) return {};
    std::filesystem::remove(temporary, ignored);
    return fail(ErrorCode::kIo, fmt::format("{}: cannot be written: {}", file.string(), error.message()));
}

}  // namespace

Picture boxFiltered(const Picture& picture, std::uint32_t edge) {
    Picture out(picture.width / edge, picture.height / edge);
    const double part = 1.0 / (double(edge) * double(edge));
    for (std::uint32_t y = 0; y < out.height; ++y)
        for (std::uint32_t x = 0; x < out.width; ++x) {
            double sums[9] = {}, depth = 0;
            for (std::uint32_t j = 0; j < edge; ++j)
                for (std::uint32_t i = 0; i < edge; ++i) {
                    const Pixel& from =
                        picture.pixels[std::size_t(y * edge + j) * picture.width + x * edge + i];
                    for (std::size_t k = 0; k < layers().size(); ++k) sums[k] += double(valueOf(from, k));
                    depth += double(from.alpha) * double(from.depth);
                }
            Pixel& to = out.pixels[std::size_t(y) * out.width + x];
            const double alpha = sums[kAlphaLayer];
            for (std::size_t k = 0; k < layers().size(); ++k) valueOf(to, k) = float(sums[k] * part);
            to.depth = alpha > 0 ? float(depth / alpha) : 0;
        }
    return out;
}

Result<Picture> readExr(const std::filesystem::path& file) {
    std::error_code ignored;
    if (!std::filesystem::is_regular_file(file, ignored))
        return fail(ErrorCode::kNotFound, fmt::format("{}: no such file", file.string()));
    try {
        Imf::InputFile in(file.c_str());
        const auto window = in.header().dataWindow();
        const std::int64_t width = std::int64_t(window.max.x) - window.min.x + 1;
        const std::int64_t height = std::int64_t(window.max.y) - window.min.y + 1;
        if (width < 1 || height < 1 || width > kMostPixels / height)
            return fail(ErrorCode::kCorrupt, fmt::format("{}: is {} x {} pixels; at most 2^28 can be read",
                                                         file.string(), width, height));
        for (const char* name : {"R", "G", "B"})
            if (!in.header().channels().findChannel(name))
                return fail(ErrorCode::kCorrupt,
                            fmt::format("{}: has no channel {}; give a picture with R, G and B",
                                        file.string(), name));
        Picture picture{std::uint32_t(width), std::uint32_t(height)};
        Imf::FrameBuffer frame;
        for (std::size_t k = 0; k < layers().size(); ++k) {
            // OpenEXR counts from the pixel (0, 0) of the data window's coordinates, wherever that is.
            char* base = reinterpret_cast<char*>(picture.pixels.data()) + layers()[k].offset;
            base -= (std::int64_t(window.min.y) * width + window.min.x) * std::int64_t(sizeof(Pixel));
            frame.insert(layers()[k].name,
                         Imf::Slice(Imf::FLOAT, base, sizeof(Pixel), sizeof(Pixel) * std::size_t(width), 1, 1,
                                    k == kAlphaLayer ? 1.0 : 0.0));
        }
        in.setFrameBuffer(frame);
        in.readPixels(window.min.y, window.max.y);
        return picture;
    } catch (const std::exception& e) {
        return fail(ErrorCode::kCorrupt, fmt::format("{}: cannot be read: {}", file.string(), e.what()));
    }
}

namespace {

// `stride` bytes from pixel to pixel; layers are floats at their offsets.
Result<void> writeLayers(const void* pixels, std::size_t stride, std::uint32_t width, std::uint32_t height,
                         std::span<const Layer> layers, const std::filesystem::path& file) {
    return writeThenRename(file, [&](const std::filesystem::path& temporary) -> Result<void> {
        try {
            Imf::Header header{int(width), int(height)};
            header.compression() = Imf::ZIP_COMPRESSION;
            Imf::FrameBuffer frame;
            for (const Layer& layer : layers) {
                header.channels().insert(layer.name, Imf::Channel(Imf::FLOAT));
                // OpenEXR's slices are not const; writing only reads.
                char* base = const_cast<char*>(static_cast<const char*>(pixels)) + layer.offset;
                frame.insert(layer.name, Imf::Slice(Imf::FLOAT, base, stride, stride * width));
            }
            Imf::OutputFile out(temporary.c_str(), header);
            out.setFrameBuffer(frame);
            out.writePixels(int(height));
            return {};
        } catch (const std::exception& e) {
            return fail(ErrorCode::kIo, fmt::format("{}: cannot be written: {}", file.string(), e.what()));
        }
    });
}

}  // namespace

Result<void> writeExr(const Picture& picture, const std::filesystem::path& file) {
    return writeLayers(picture.pixels.data(), sizeof(Pixel), picture.width, picture.height, layers(), file);
}

Result<void> writeExplanation(std::uint32_t width, std::uint32_t height, const std::vector<PixelWhy>& why,
                              const std::filesystem::path& file) {
    static constexpr Layer kLayers[] = {{"level", offsetof(PixelWhy, level)},
                                        {"queued", offsetof(PixelWhy, queued)},
                                        {"overBudget", offsetof(PixelWhy, over_budget)},
                                        {"failed", offsetof(PixelWhy, failed)},
                                        {"noFinerData", offsetof(PixelWhy, no_finer_data)}};
    return writeLayers(why.data(), sizeof(PixelWhy), width, height, kLayers, file);
}

Result<void> writePng(const Picture& picture, const std::array<float, 3>& background,
                      const std::filesystem::path& file) {
    std::vector<std::uint8_t> bytes(picture.pixels.size() * 3);
    for (std::size_t i = 0; i < picture.pixels.size(); ++i)
        for (std::size_t c = 0; c < 3; ++c)
            bytes[3 * i + c] =
                encodeSrgb(picture.pixels[i].radiance[c] + (1 - picture.pixels[i].alpha) * background[c]);
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    image.width = picture.width;
    image.height = picture.height;
    image.format = PNG_FORMAT_RGB;
    return writeThenRename(file, [&](const std::filesystem::path& temporary) -> Result<void> {
        if (png_image_write_to_file(&image, temporary.c_str(), 0, bytes.data(), 0, nullptr)) return {};
        return fail(ErrorCode::kIo, fmt::format("{}: cannot be written: {}", file.string(), image.message));
    });
}

}  // namespace brickyard

// A rendered picture and its files. Layers as the picture contract names them (DESIGN.md, section 9). Plain
// value.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <vector>

#include "core/result.h"

namespace brickyard {

// Linear, premultiplied; row 0 is the top, x fastest.
struct Pixel {
    std::array<float, 3> radiance{};
    float alpha = 0;  // 1 - transmittance
    float depth = 0;  // world distance from the eye where half the final opacity is reached; 0 where empty
    float bound_alpha = 0;     // the true alpha lies within this, always
    float bound_radiance = 0;  // of the worst of the three
    float estimate_alpha = 0;  // one standard deviation of the expected error
    float estimate_radiance = 0;
};

// Why a pixel looks as it does.
struct PixelWhy {
    float level = 0;  // mean level of what was drawn, weighted by optical depth
    // Stretches of its ray that are drawn coarser than the data because pages are still queued, over the
    // budget of bytes, or cannot be had.
    float queued = 0, over_budget = 0, failed = 0;
    float no_finer_data = 0;  // 1 where the finest level leaves it above the error asked for
};

struct Picture {
    std::uint32_t width = 0, height = 0;
    std::vector<Pixel> pixels;

    Picture() = default;
    Picture(std::uint32_t w, std::uint32_t h) : width(w), height(h), pixels(std::size_t(w) * h) {}
};

// Each `edge` x `edge` pixels become their mean: a box filter. Means of bounds and estimates are bounds and
// (cautious) estimates of the mean; depth is weighted by alpha. REQUIRES: `edge` divides width and height.
Picture boxFiltered(const Picture& picture, std::uint32_t edge);

// Float32 EXR with channels R G B A Z errorBound.A errorBound.RGB errorEstimate.A errorEstimate.RGB. Errors:
// kIo.
Result<void> writeExr(const Picture& picture, const std::filesystem::path& file);
// Any scan-line EXR with at least R G B; its other channels where they have our names. Alpha is 1 where the
// file has none. Errors: kNotFound, kCorrupt (no EXR, damaged, no R G B, more than 2^28 pixels).
Result<Picture> readExr(const std::filesystem::path& file);
// Float32 EXR with channels level, queued, overBudget, failed, noFinerData. Errors: kIo.
Result<void> writeExplanation(std::uint32_t width, std::uint32_t height, const std::vector<PixelWhy>& why,
                              const std::filesystem::path& file);
// 8 bits, composed over `background` (linear RGB), sRGB-encoded, opaque. Errors: kIo.
Result<void> writePng(const Picture& picture, const std::array<float, 3>& background,
                      const std::filesystem::path& file);

}  // namespace brickyard

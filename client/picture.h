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

struct Picture {
    std::uint32_t width = 0, height = 0;
    std::vector<Pixel> pixels;

    Picture() = default;
    Picture(std::uint32_t w, std::uint32_t h) : width(w), height(h), pixels(std::size_t(w) * h) {}
};

// Float32 EXR with channels R G B A Z errorBound.A errorBound.RGB errorEstimate.A errorEstimate.RGB. Errors:
// kIo.
Result<void> writeExr(const Picture& picture, const std::filesystem::path& file);
// 8 bits, composed over `background` (linear RGB), sRGB-encoded, opaque. Errors: kIo.
Result<void> writePng(const Picture& picture, const std::array<float, 3>& background,
                      const std::filesystem::path& file);

}  // namespace brickyard

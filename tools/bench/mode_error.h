// How far a picture is from another one that stands for the truth, and whether what it says of itself holds:
// all of its colours, not its alpha alone as in picture_error.h. Plain values, any thread.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>

#include "client/picture.h"

namespace brickyard {

struct ModeError {
    double rms = 0, p99 = 0, worst = 0;  // over the pixels with something in them in either picture
    double mean_estimate = 0;
    // Of those pixels, the ones within three estimates. What the truth itself is uncertain by counts with it.
    double within_3 = 1;
    std::uint64_t pixels = 0;

    double estimateOverRms() const { return rms > 0 ? mean_estimate / rms : 0; }
};

// Of a pixel the worst of R, G and B, or its alpha where `of_alpha`. REQUIRES: pictures of one size.
ModeError modeError(const Picture& picture, const Picture& truth, bool of_alpha);

nlohmann::json toJson(const ModeError& error);

}  // namespace brickyard

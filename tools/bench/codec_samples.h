// Bricks of a cache's float channels, as the converter would give them to the encoder.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "core/brick_shape.h"
#include "core/result.h"
#include "core/sample_type.h"
#include "tools/bench/codec_peers.h"

namespace brickyard {

struct CodecChannel {
    std::string name;
    CodecShape shape;
    std::vector<ValueBits> background;
    // Each shape.samples() finite values, at least two of them different.
    std::vector<std::vector<float>> bricks;
    std::size_t places = 0;                        // where bricks may be; `bricks` is an even choice of them
    double least = 0, greatest = 0;                // of all samples in `bricks`
    double active_least = 0, active_greatest = 0;  // of the active ones: the channel's range

    std::size_t samples() const { return bricks.size() * shape.samples(); }
    double range() const { return active_greatest - active_least; }
};

// All float32 channels that have bricks of more than one value, each with at most `most_bytes` of samples:
// every n-th brick where there are more. Errors: those of openInput and of reading.
Result<std::vector<CodecChannel>> readCodecChannels(const std::filesystem::path& file, BrickShape shape,
                                                    std::size_t most_bytes);

}  // namespace brickyard

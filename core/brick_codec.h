// Payloads: one brick's samples and, at level 0, its voxels' active states, as bytes. docs/format.md, section
// "Payload". Each payload picks the cheapest encoding that keeps its error bound: one value, lossless, or
// k-bit linear quantisation; differences against the 3-D Lorenzo predictor (Ibarria et al., 2003) where they
// pay; zigzag and byte planes; zstd. An exact payload may begin with a draft: a prefix that decodes alone to
// an approximation, which the bytes behind it correct. Pure functions, any thread; contexts are kept per
// thread.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/brick_shape.h"
#include "core/result.h"
#include "core/sample_type.h"

namespace brickyard {

// A payload never exceeds this; a longer claim is refused before it is read.
inline constexpr std::size_t kMaxPayloadBytes = 32u << 20;

struct BrickToEncode {
    BrickShape shape;
    SampleType type = SampleType::kFloat32;
    int components = 1;
    // Planar, x fastest, shape.samples() * components values of sampleBytes(type). Any alignment; bools are 0
    // or 1.
    std::span<const std::byte> values;
    // One byte per owned voxel, shape.cells(), x fastest; empty where states are not kept (levels above 0).
    std::span<const std::uint8_t> active;
    // One per component; lets "active is what differs from the background" cost nothing.
    std::span<const ValueBits> background;
    // Largest allowed |decoded - value|. 0: bit-exact. Integers and bools are always bit-exact.
    double max_error = 0;
    // Above 0: begin the payload with a draft within this error, where one pays. Only floats with max_error
    // == 0 have drafts; for all others this is ignored.
    double draft_error = 0;
};

struct EncodedBrick {
    std::vector<std::byte> payload;
    double error_made = 0;  // measured on the samples that this payload decodes to
    double rms_made = 0;    // root mean square of the same deviation, over all samples and components
    // Prefix of `payload` that decodes alone, below payload.size(); 0: no draft, because none was asked for
    // or none paid (the whole would be over 17 % larger than without, or the draft not below half of that).
    std::size_t draft_bytes = 0;
    double draft_error_made = 0;  // measured on the samples that the draft decodes to; at most draft_error
    double draft_rms_made = 0;
};

// Never fails. A brick with NaN or infinity comes back bit for bit, whatever error is allowed; keeping them
// out is the caller's business.
EncodedBrick encodeBrick(const BrickToEncode& brick);

struct DecodedBrick {
    SampleType type = SampleType::kFloat32;
    std::vector<std::byte> values;     // planar, x fastest, as BrickToEncode::values
    std::vector<std::uint8_t> active;  // shape.cells() states; empty where the payload keeps none
};

// Bounded by the brick's own size whatever the payload says. `background` as given to the encoder.
// Errors: kCorrupt, without the place; the caller adds file and node.
Result<DecodedBrick> decodeBrick(std::span<const std::byte> payload, BrickShape shape, SampleType type,
                                 int components, std::span<const ValueBits> background);

// The same values as floats for a renderer, saturated to the finite range; states are skipped, not decoded.
// `out` has shape.samples() * components floats.
Result<void> decodeBrickToFloat(std::span<const std::byte> payload, BrickShape shape, SampleType type,
                                int components, std::span<float> out);

// The same two for the draft alone: exactly the first draft_bytes of a payload. No states. Bounded as above;
// costs what a quantised payload costs. Errors: kCorrupt, also for a payload without a draft and for one not
// cut at its end.
Result<DecodedBrick> decodeDraft(std::span<const std::byte> draft, BrickShape shape, SampleType type,
                                 int components);
Result<void> decodeDraftToFloat(std::span<const std::byte> draft, BrickShape shape, SampleType type,
                                int components, std::span<float> out);

}  // namespace brickyard

// What a payload is, byte by byte: docs/format.md, section "Payload". Writing it: brick_encoder.cpp; reading
// it: brick_decoder.cpp. None of the numbers below may change; a new meaning takes a new version byte.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "core/brick_shape.h"
#include "core/result.h"
#include "core/sample_type.h"

namespace brickyard {

inline constexpr std::uint8_t kPayloadVersion = 1;
// A section that keeps words of selected samples alone.
inline constexpr std::uint8_t kSelectingVersion = 2;

enum class PayloadEncoding : std::uint8_t { kConstant = 0, kLossless = 1, kQuantised = 2 };
// Set in the encoding of a draft: a quantised or constant section, behind which a lossless one with its
// corrections stands.
inline constexpr std::uint8_t kDraftFlag = 0x80;

// Set in the encoding of a section that keeps words of selected samples alone; all others have one word, the
// filler. With the second flag as well the samples are those that the draft in front selects.
inline constexpr std::uint8_t kSelectionFlag = 0x40;
inline constexpr std::uint8_t kDraftSelectionFlag = 0x20;

enum class PayloadPredictor : std::uint8_t {
    kNone = 0,
    kLorenzo = 1,   // all samples
    kPrevious = 2,  // selected samples: the one before, of the same component
};
enum class PayloadActivity : std::uint8_t {
    kNotKept = 0,
    kNoneActive = 1,
    kAllActive = 2,
    kDiffersFromBackground = 3,  // active where the bits of any component differ from the background's
    kMask = 4,                   // one bit per owned voxel, x fastest, lowest bit first
};

// How a run of bytes of known length is stored. Its entry in the header: mode << 30 | stored bytes.
enum class StreamMode : std::uint8_t { kUniform = 0, kStored = 1, kZstd = 2 };
inline constexpr unsigned kStreamModeShift = 30;
struct PayloadStream {
    StreamMode mode = StreamMode::kUniform;
    std::span<const std::byte> stored;  // kUniform: the one byte that repeats
};

inline constexpr int kMaxComponents = 3;
inline constexpr std::size_t kMaxWordBytes = 8;

// Quantised samples are step * (base + q) in double precision, then rounded to the sample's type. With |base|
// and q below 2^52 the sum is exact, so bricks that share a step agree on shared samples, and 0 is always
// among the values.
inline constexpr std::int64_t kMaxQuantiserBase = std::int64_t(1) << 52;
// Whether no value that `width` bytes can mean leaves the finite range of `type`.
bool isQuantiser(SampleType type, std::size_t width, double step, std::int64_t base);

// A section of a payload taken apart, its numbers checked; the streams are not decompressed yet.
struct PayloadParts {
    PayloadEncoding encoding = PayloadEncoding::kConstant;
    PayloadPredictor predictor = PayloadPredictor::kNone;
    PayloadActivity activity = PayloadActivity::kNotKept;
    std::size_t width = 0;                             // bytes of a stored word; 0 for kConstant
    std::array<ValueBits, kMaxComponents> constant{};  // kConstant
    std::array<std::uint64_t, kMaxComponents>
        offset{};     // kLossless integers: word = value - offset, modulo 2^64
    double step = 0;  // kQuantised
    std::array<std::int64_t, kMaxComponents> base{};     // kQuantised
    std::array<PayloadStream, kMaxWordBytes> planes;     // byte j of all words, lowest first; `width` of them
    PayloadStream mask;                                  // kMask
    bool selects = false;                                // only words of selected samples are kept
    bool selects_as_draft = false;                       // ... and the draft says which
    std::array<std::uint64_t, kMaxComponents> filler{};  // the word of all other samples
    PayloadStream selection;  // one bit per sample, lowest first; unless selects_as_draft
};

// Nearly all payloads are one section. With a draft, the words of `exact` are zigzagged differences to what
// the draft predicts (payload_words.h), or, with predictor kLorenzo, Lorenzo residuals of those differences.
struct ParsedPayload {
    std::optional<PayloadParts> draft;
    PayloadParts exact;  // all there is where there is no draft
};

// Errors: kCorrupt, without the place.
Result<ParsedPayload> parsePayload(std::span<const std::byte> payload, SampleType type, int components);
// The section of the draft, which must be all of `draft`. Errors as above.
Result<PayloadParts> parseDraft(std::span<const std::byte> draft, SampleType type, int components);

}  // namespace brickyard

// Reading a payload: parse, decompress the byte planes, merge them into words, undo the predictor, correct
// the draft where there is one, turn words into samples. Each step runs over a whole component and is a loop
// that the compiler vectorises.
#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cstring>
#include <type_traits>

#include "core/brick_codec.h"
#include "core/lorenzo.h"
#include "core/payload_activity.h"
#include "core/payload_format.h"
#include "core/payload_stream.h"
#include "core/payload_words.h"
#include "core/sample_selection.h"

namespace brickyard {
namespace {

tl::unexpected<Error> corrupt(const char* what) {
    return fail(ErrorCode::kCorrupt, fmt::format("payload {}; convert this frame again", what));
}

// Kept per thread, so that a brick costs no allocation. Grows to the largest brick met: at most 65^3 * 3
// words.
struct Scratch {
    std::vector<std::byte> planes;
    std::vector<std::byte> words;      // of whichever width the payload has
    std::vector<std::byte> draft;      // samples
    std::vector<std::byte> selected;   // words of selected samples
    std::vector<std::byte> selection;  // bits; those of a draft stay for the section behind it
};
Scratch& scratch() {
    thread_local Scratch kept;
    return kept;
}

template <class W>
void mergePlanes(const std::byte* const* planes, std::size_t count, W* __restrict words) {
    if constexpr (sizeof(W) == 1) {
        std::memcpy(words, planes[0], count);
    } else {
        // Two planes at a time: a loop over eight pointers at once does not vectorise.
        for (std::size_t j = 0; j < sizeof(W); j += 2) {
            const std::byte* __restrict const low = planes[j];
            const std::byte* __restrict const high = planes[j + 1];
            const unsigned shift = unsigned(8 * j);
            if (j == 0)
                for (std::size_t i = 0; i < count; ++i)
                    words[i] = W(unsigned(low[i]) | unsigned(high[i]) << 8);
            else
                for (std::size_t i = 0; i < count; ++i)
                    words[i] = W(words[i] | W(unsigned(low[i]) | unsigned(high[i]) << 8) << shift);
        }
    }
}

// Reads which samples a section keeps words of, into the scratch. False where that cannot be.
bool readSelection(const PayloadParts& parts, BrickShape shape) {
    if (!parts.selects || parts.selects_as_draft) return true;
    const std::size_t samples = shape.samples(), bytes = selectionBytes(samples);
    std::vector<std::byte>& kept = scratch().selection;
    kept.resize(bytes);
    const std::byte* const read = streamBytes(parts.selection, bytes, kept.data());
    if (!read) return false;
    if (read != kept.data()) std::memcpy(kept.data(), read, bytes);
    // Bits beyond the last sample would select what is not there.
    if (samples % 8 != 0 && (unsigned(kept.back()) >> (samples % 8)) != 0) return false;
    return countSelected(kept) > 0;
}

// All components' words, planar, in the calling thread's scratch; nullptr where a plane is not what it should
// be.
template <class W>
W* readWords(const PayloadParts& parts, BrickShape shape, int components) {
    if (!readSelection(parts, shape)) return nullptr;
    Scratch& kept = scratch();
    const std::size_t all = shape.samples() * std::size_t(components);
    const std::size_t count = parts.selects ? countSelected(kept.selection) * std::size_t(components) : all;
    if (kept.planes.size() < count * sizeof(W)) kept.planes.resize(count * sizeof(W));
    if (kept.words.size() < all * sizeof(W)) kept.words.resize(all * sizeof(W));
    if (parts.selects && kept.selected.size() < count * sizeof(W)) kept.selected.resize(count * sizeof(W));

    const std::byte* planes[sizeof(W)];
    for (std::size_t j = 0; j < sizeof(W); ++j) {
        planes[j] = streamBytes(parts.planes[j], count, kept.planes.data() + j * count);
        if (!planes[j]) return nullptr;
    }
    W* const words = reinterpret_cast<W*>(kept.words.data());
    if (parts.selects) {
        W* const selected = reinterpret_cast<W*>(kept.selected.data());
        mergePlanes(planes, count, selected);
        const std::size_t each = count / std::size_t(components);
        for (std::size_t c = 0; c < std::size_t(components); ++c) {
            W* const own = selected + c * each;
            if (parts.predictor == PayloadPredictor::kPrevious) {
                W sum = 0;
                for (std::size_t i = 0; i < each; ++i) own[i] = sum = W(sum + unzigzag(own[i]));
            }
            scatterSelected(own, shape.samples(), kept.selection, W(parts.filler[c]),
                            words + c * shape.samples());
        }
        return words;
    }
    mergePlanes(planes, count, words);
    if (parts.predictor == PayloadPredictor::kLorenzo)
        for (int c = 0; c < components; ++c)
            addPrediction(words + std::size_t(c) * shape.samples(), std::size_t(shape.edgeSamples()));
    return words;
}

// Halves above the finite ones, and bools above 1, are words that no writer makes.
template <class W>
bool wordsAreSound(SampleType type, const W* words, std::size_t count) {
    if constexpr (sizeof(W) == 1) {
        if (type != SampleType::kBool) return true;
        W any = 0;
        for (std::size_t i = 0; i < count; ++i) any = W(any | words[i]);
        return any <= 1;
    } else if constexpr (sizeof(W) == 2) {
        if (!isFloating(type)) return true;
        std::uint16_t largest = 0;
        for (std::size_t i = 0; i < count; ++i) {
            const auto magnitude = std::uint16_t(bitsFromOrdered(words[i]) & 0x7fff);
            largest = magnitude > largest ? magnitude : largest;
        }
        return largest < 0x7c00;
    } else {
        return true;
    }
}

// Differences to the draft become words. A draft is another predictor.
template <class T, class W>
void addDraft(const T* __restrict draft, PayloadPredictor predictor, std::size_t count, W* __restrict words) {
    // Undoing a predictor has undone the zigzag as well.
    if (predictor != PayloadPredictor::kNone)
        for (std::size_t i = 0; i < count; ++i) words[i] = W(words[i] + orderedFromDraft<W>(draft[i]));
    else
        for (std::size_t i = 0; i < count; ++i)
            words[i] = W(unzigzag(words[i]) + orderedFromDraft<W>(draft[i]));
}

// Calls `sink(c, words of component c)` for a lossless or quantised section, with words of the stored width.
// `draft`: its samples, all components; nullptr where the words need no correction.
template <class T, class Sink>
Result<void> forEachComponent(const PayloadParts& parts, const T* draft, BrickShape shape, SampleType type,
                              int components, Sink sink) {
    const auto run = [&]<class W>(W) -> Result<void> {
        const std::size_t n = shape.samples();
        W* const words = readWords<W>(parts, shape, components);
        if (!words) return corrupt("has a byte plane or a selection of another size than the brick");
        if constexpr (std::is_floating_point_v<T> && sizeof(W) > 1 && sizeof(W) <= sizeof(T))
            if (draft) addDraft(draft, parts.predictor, n * std::size_t(components), words);
        if (parts.encoding == PayloadEncoding::kLossless &&
            !wordsAreSound(type, words, n * std::size_t(components)))
            return corrupt("holds a number that its type has not");
        for (std::size_t c = 0; c < std::size_t(components); ++c) sink(c, words + c * n);
        return {};
    };
    switch (parts.width) {
        case 1: return run(std::uint8_t{});
        case 2: return run(std::uint16_t{});
        case 4: return run(std::uint32_t{});
        default: return run(std::uint64_t{});
    }
}

template <class T>
T valueFromBits(ValueBits bits) {
    if constexpr (sizeof(T) == 1) return T(bits);
    if constexpr (sizeof(T) == 4) return std::bit_cast<T>(std::uint32_t(bits));
    if constexpr (sizeof(T) == 8) return std::bit_cast<T>(bits);
}

// Words of one component as samples of type T (bools as uint8), exactly as they were given to the encoder.
template <class T, class W>
void samplesFromWords(const PayloadParts& parts, std::size_t c, const W* words, std::size_t n,
                      T* __restrict out) {
    if constexpr (std::is_floating_point_v<T>) {
        if (parts.encoding == PayloadEncoding::kQuantised) {
            const double step = parts.step, base = double(parts.base[c]);
            for (std::size_t i = 0; i < n; ++i) out[i] = T(dequantised(words[i], step, base));
        } else if constexpr (sizeof(W) == sizeof(T)) {
            // Bits to bits: a signalling NaN would not survive a register of the x87, or a conversion.
            for (std::size_t i = 0; i < n; ++i) {
                const W bits = bitsFromOrdered(words[i]);
                std::memcpy(out + i, &bits, sizeof(T));
            }
        } else if constexpr (sizeof(W) > 1 && sizeof(W) < sizeof(T)) {
            for (std::size_t i = 0; i < n; ++i) out[i] = T(numberFromOrdered(words[i]));
        }
    } else {
        using Unsigned = std::make_unsigned_t<T>;
        const auto offset = Unsigned(parts.offset[c]);
        for (std::size_t i = 0; i < n; ++i) out[i] = T(Unsigned(offset + Unsigned(words[i])));
    }
}

// The same as floats for a renderer.
template <class T, class W>
void floatsFromWords(const PayloadParts& parts, std::size_t c, const W* words, std::size_t n,
                     float* __restrict out) {
    if constexpr (std::is_floating_point_v<T>) {
        if (parts.encoding == PayloadEncoding::kQuantised) {
            // The sample's own type first, as decodeBrick rounds it: for float64 that is the double itself.
            const double step = parts.step, base = double(parts.base[c]);
            for (std::size_t i = 0; i < n; ++i) out[i] = rendererFloat(T(dequantised(words[i], step, base)));
        } else if constexpr (sizeof(W) == 2) {
            for (std::size_t i = 0; i < n; ++i)
                out[i] = numberFromOrdered(words[i]);  // finite: wordsAreSound
        } else if constexpr (sizeof(W) > 2 && sizeof(W) <= sizeof(T)) {
            for (std::size_t i = 0; i < n; ++i) out[i] = rendererFloat(numberFromOrdered(words[i]));
        }
    } else {
        using Unsigned = std::make_unsigned_t<T>;
        const auto offset = Unsigned(parts.offset[c]);
        for (std::size_t i = 0; i < n; ++i) out[i] = float(T(Unsigned(offset + Unsigned(words[i]))));
    }
}

template <class T>
Result<void> decodeValues(const PayloadParts& parts, const T* draft, BrickShape shape, SampleType type,
                          int components, T* out) {
    const std::size_t n = shape.samples();
    if (parts.encoding == PayloadEncoding::kConstant) {
        for (std::size_t c = 0; c < std::size_t(components); ++c)
            std::fill_n(out + c * n, n, valueFromBits<T>(parts.constant[c]));
        return {};
    }
    return forEachComponent(parts, draft, shape, type, components, [&](std::size_t c, const auto* words) {
        samplesFromWords(parts, c, words, n, out + c * n);
    });
}

template <class T>
Result<void> decodeFloats(const PayloadParts& parts, const T* draft, BrickShape shape, SampleType type,
                          int components, float* out) {
    const std::size_t n = shape.samples();
    if (parts.encoding == PayloadEncoding::kConstant) {
        for (std::size_t c = 0; c < std::size_t(components); ++c)
            std::fill_n(out + c * n, n, toFloat(type, parts.constant[c]));
        return {};
    }
    return forEachComponent(parts, draft, shape, type, components, [&](std::size_t c, const auto* words) {
        floatsFromWords<T>(parts, c, words, n, out + c * n);
    });
}

// Samples of the draft in the calling thread's scratch; nullptr where the payload has none.
template <class T>
Result<const T*> draftOf(const ParsedPayload& parsed, BrickShape shape, SampleType type, int components) {
    if (!parsed.draft) return nullptr;
    std::vector<std::byte>& kept = scratch().draft;
    const std::size_t bytes = shape.samples() * std::size_t(components) * sizeof(T);
    if (kept.size() < bytes) kept.resize(bytes);
    T* const samples = reinterpret_cast<T*>(kept.data());
    const auto decoded = decodeValues<T>(*parsed.draft, nullptr, shape, type, components, samples);
    if (!decoded) return tl::unexpected(decoded.error());
    return samples;
}

// `run` with a null pointer of the type that holds the channel's samples.
template <class Run>
Result<void> withSampleType(SampleType type, Run run) {
    switch (type) {
        case SampleType::kFloat32: return run(static_cast<float*>(nullptr));
        case SampleType::kFloat64: return run(static_cast<double*>(nullptr));
        case SampleType::kInt32: return run(static_cast<std::int32_t*>(nullptr));
        case SampleType::kInt64: return run(static_cast<std::int64_t*>(nullptr));
        case SampleType::kBool: return run(static_cast<std::uint8_t*>(nullptr));
    }
    return corrupt("of an unknown sample type");
}

Result<void> decodeStates(const PayloadParts& parts, BrickShape shape, SampleType type, int components,
                          std::span<const ValueBits> background, DecodedBrick& brick) {
    if (parts.activity == PayloadActivity::kNotKept) return {};
    const std::size_t cells = shape.cells();
    brick.active.assign(cells, parts.activity == PayloadActivity::kAllActive ? 1 : 0);
    if (parts.activity == PayloadActivity::kDiffersFromBackground) {
        brick.active = statesByBackground(brick.values, shape, type, components, background);
    } else if (parts.activity == PayloadActivity::kMask) {
        Scratch& kept = scratch();
        const std::size_t bytes = cells / 8;  // N is a multiple of 8
        if (kept.planes.size() < bytes) kept.planes.resize(bytes);
        const std::byte* const mask = streamBytes(parts.mask, bytes, kept.planes.data());
        if (!mask) return corrupt("has an activity mask of another size than the brick");
        for (std::size_t i = 0; i < cells; ++i)
            brick.active[i] = std::uint8_t(unsigned(mask[i / 8]) >> (i % 8) & 1u);
    }
    return {};
}

}  // namespace

Result<DecodedBrick> decodeBrick(std::span<const std::byte> payload, BrickShape shape, SampleType type,
                                 int components, std::span<const ValueBits> background) {
    assert(isBrickEdge(shape.edge_cells) && components >= 1 && components <= kMaxComponents);
    assert(background.size() >= std::size_t(components));
    const auto parsed = parsePayload(payload, type, components);
    if (!parsed) return tl::unexpected(parsed.error());

    DecodedBrick brick;
    brick.type = type;
    brick.values.resize(shape.samples() * std::size_t(components) * sampleBytes(type));
    const auto values = withSampleType(type, [&]<class T>(T*) -> Result<void> {
        const auto draft = draftOf<T>(*parsed, shape, type, components);
        if (!draft) return tl::unexpected(draft.error());
        T* const out = reinterpret_cast<T*>(brick.values.data());
        return decodeValues(parsed->exact, *draft, shape, type, components, out);
    });
    if (!values) return tl::unexpected(values.error());
    if (const auto states = decodeStates(parsed->exact, shape, type, components, background, brick); !states)
        return tl::unexpected(states.error());
    return brick;
}

Result<void> decodeBrickToFloat(std::span<const std::byte> payload, BrickShape shape, SampleType type,
                                int components, std::span<float> out) {
    assert(isBrickEdge(shape.edge_cells) && components >= 1 && components <= kMaxComponents);
    assert(out.size() == shape.samples() * std::size_t(components));
    const auto parsed = parsePayload(payload, type, components);
    if (!parsed) return tl::unexpected(parsed.error());
    return withSampleType(type, [&]<class T>(T*) -> Result<void> {
        const auto draft = draftOf<T>(*parsed, shape, type, components);
        if (!draft) return tl::unexpected(draft.error());
        return decodeFloats<T>(parsed->exact, *draft, shape, type, components, out.data());
    });
}

Result<DecodedBrick> decodeDraft(std::span<const std::byte> draft, BrickShape shape, SampleType type,
                                 int components) {
    assert(isBrickEdge(shape.edge_cells) && components >= 1 && components <= kMaxComponents);
    const auto parts = parseDraft(draft, type, components);
    if (!parts) return tl::unexpected(parts.error());
    DecodedBrick brick;
    brick.type = type;
    brick.values.resize(shape.samples() * std::size_t(components) * sampleBytes(type));
    const auto values = withSampleType(type, [&]<class T>(T*) {
        return decodeValues<T>(*parts, nullptr, shape, type, components,
                               reinterpret_cast<T*>(brick.values.data()));
    });
    if (!values) return tl::unexpected(values.error());
    return brick;
}

Result<void> decodeDraftToFloat(std::span<const std::byte> draft, BrickShape shape, SampleType type,
                                int components, std::span<float> out) {
    assert(isBrickEdge(shape.edge_cells) && components >= 1 && components <= kMaxComponents);
    assert(out.size() == shape.samples() * std::size_t(components));
    const auto parts = parseDraft(draft, type, components);
    if (!parts) return tl::unexpected(parts.error());
    return withSampleType(type, [&]<class T>(T*) {
        return decodeFloats<T>(*parts, nullptr, shape, type, components, out.data());
    });
}

}  // namespace brickyard

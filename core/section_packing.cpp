#include "core/section_packing.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "core/lorenzo.h"
#include "core/payload_stream.h"
#include "core/vector_clones.h"

namespace brickyard {
namespace {

// A way whose estimate is within this factor of the best one's is tried: an entropy does not see what
// repeats.
constexpr double kCloseCall = 1.05;

template <class W>
void appendPlanes(const std::vector<W>& words, PackedSection& section) {
    thread_local std::vector<std::byte> plane;
    plane.resize(words.size());
    for (std::size_t j = 0; j < sizeof(W); ++j) {
        for (std::size_t i = 0; i < words.size(); ++i)
            plane[i] = std::byte(std::uint8_t(words[i] >> (8 * j)));
        section.entries[j] = appendStream(plane, section.streams);
    }
}

template <class W>
std::vector<W> lessPrevious(const std::vector<W>& words, std::size_t components) {
    std::vector<W> out(words.size());
    const std::size_t each = words.size() / components;
    for (std::size_t c = 0; c < components; ++c) {
        W before = 0;
        for (std::size_t i = c * each; i < (c + 1) * each; ++i) {
            out[i] = zigzag(W(words[i] - before));
            before = words[i];
        }
    }
    return out;
}

#define BRICKYARD_FLAG_OTHERS(W)                                                   \
    BRICKYARD_VECTOR_CLONES                                                        \
    void flag(const W* words, std::size_t samples, W other, std::uint8_t* flags) { \
        for (std::size_t i = 0; i < samples; ++i)                                  \
            flags[i] = std::uint8_t(flags[i] | std::uint8_t(words[i] != other));   \
    }
BRICKYARD_FLAG_OTHERS(std::uint8_t)
BRICKYARD_FLAG_OTHERS(std::uint16_t)
BRICKYARD_FLAG_OTHERS(std::uint32_t)
BRICKYARD_FLAG_OTHERS(std::uint64_t)
#undef BRICKYARD_FLAG_OTHERS

// The word of the samples that are not selected.
template <class W>
W fillerOf(const W* words, const Selection& selection) {
    std::size_t other = 0;
    while ((unsigned(selection.mask[other / 8]) >> (other % 8) & 1) != 0) ++other;
    return words[other];
}

}  // namespace

Selection selectFlagged(const std::vector<std::uint8_t>& flags) {
    Selection selection;
    const std::size_t samples = flags.size();
    std::size_t count = 0;
    for (std::uint8_t flag : flags) count += flag;
    if (count == 0 || double(samples - count) < kLeastLeftOut * double(samples)) return selection;
    selection.count = count;
    selection.mask.resize(selectionBytes(samples));
    for (std::size_t i = 0; i < samples; i += 8) {
        unsigned bits = 0;
        for (std::size_t k = 0; k < std::min<std::size_t>(8, samples - i); ++k)
            bits |= unsigned(flags[i + k]) << k;
        selection.mask[i / 8] = std::byte(std::uint8_t(bits));
    }
    return selection;
}

template <class W>
void flagOthers(const W* words, std::size_t samples, W other, std::uint8_t* flags) {
    flag(words, samples, other, flags);
}

// What the planes of words will take, about: their order-0 entropy in bytes, from a part of them. Compressing
// with each predictor to see which is smaller would take most of a conversion's time.
template <class W>
double estimatedBytes(const std::vector<W>& words) {
    constexpr std::size_t kRun = 64, kMostRuns = 32;
    const std::size_t runs = std::min(kMostRuns, (words.size() + kRun - 1) / kRun);
    std::array<std::array<std::uint16_t, 256>, sizeof(W)> counts{};
    std::size_t seen = 0;
    for (std::size_t r = 0; r < runs; ++r) {
        const std::size_t begin = runs == kMostRuns ? r * (words.size() - kRun) / (kMostRuns - 1) : r * kRun;
        const std::size_t end = std::min(begin + kRun, words.size());
        for (std::size_t i = begin; i < end; ++i)
            for (std::size_t j = 0; j < sizeof(W); ++j) ++counts[j][std::uint8_t(words[i] >> (8 * j))];
        seen += end - begin;
    }
    double bits = 0;
    for (const auto& plane : counts) {
        std::size_t symbols = 0;
        for (std::uint16_t count : plane)
            if (count > 0) {
                bits += double(count) * std::log2(double(seen) / double(count));
                ++symbols;
            }
        // A few samples do not show all symbols there are (Miller and Madow's correction).
        bits += double(symbols - 1) / (2 * std::log(2.0));
    }
    return bits / 8 * double(words.size()) / double(std::max<std::size_t>(seen, 1));
}

template <class W>
std::vector<W> selectedWords(const std::vector<W>& words, const Selection& selection,
                             std::size_t components) {
    const std::size_t samples = words.size() / components;
    std::vector<W> kept(selection.count * components);
    W* end = kept.data();
    for (std::size_t c = 0; c < components; ++c)
        end = gatherSelected(words.data() + c * samples, samples, selection.mask, end);
    return kept;
}

template <class W>
PackedSection packWords(const Packing& packing, const std::vector<W>& words, BrickShape shape,
                        int components) {
    const auto n = std::size_t(components);
    const bool selects = packing.selection && packing.selection->any();
    struct Way {
        std::vector<W> words;
        PayloadPredictor predictor = PayloadPredictor::kNone;
        bool selects = false;
        double estimate = 0;
    };
    std::vector<Way> ways;
    const auto add = [&](std::vector<W> kept, PayloadPredictor predictor, bool selected) {
        const double estimate = estimatedBytes(kept);
        ways.push_back({std::move(kept), predictor, selected, estimate});
    };
    if (selects) {
        add(selectedWords(words, *packing.selection, n), PayloadPredictor::kNone, true);
        if (packing.predict) add(lessPrevious(ways[0].words, n), PayloadPredictor::kPrevious, true);
    } else {
        add(words, PayloadPredictor::kNone, false);
    }
    if (packing.predict) {
        std::vector<W> predicted = words;
        for (std::size_t c = 0; c < n; ++c)
            subtractPrediction(predicted.data() + c * shape.samples(), std::size_t(shape.edgeSamples()));
        add(std::move(predicted), PayloadPredictor::kLorenzo, false);
    }

    double least = std::numeric_limits<double>::infinity();
    for (const Way& way : ways) least = std::min(least, way.estimate);
    std::optional<PackedSection> best;
    for (const Way& way : ways) {
        if (way.estimate > kCloseCall * least) continue;
        PackedSection section;
        section.encoding = packing.encoding;
        section.predictor = way.predictor;
        section.width = sizeof(W);
        section.selects = way.selects;
        section.selects_as_draft = way.selects && packing.as_draft;
        appendPlanes(way.words, section);
        if (way.selects) {
            for (std::size_t c = 0; c < n; ++c)
                section.filler[c] = fillerOf(words.data() + c * shape.samples(), *packing.selection);
            if (!packing.as_draft)
                section.selection_entry = appendStream(packing.selection->mask, section.streams);
        }
        if (!best || section.bytes(n) < best->bytes(n)) best = std::move(section);
    }
    return std::move(*best);
}

#define BRICKYARD_INSTANTIATE(W)                                                                    \
    template void flagOthers<W>(const W*, std::size_t, W, std::uint8_t*);                           \
    template double estimatedBytes<W>(const std::vector<W>&);                                       \
    template std::vector<W> selectedWords<W>(const std::vector<W>&, const Selection&, std::size_t); \
    template PackedSection packWords<W>(const Packing&, const std::vector<W>&, BrickShape, int);
BRICKYARD_INSTANTIATE(std::uint8_t)
BRICKYARD_INSTANTIATE(std::uint16_t)
BRICKYARD_INSTANTIATE(std::uint32_t)
BRICKYARD_INSTANTIATE(std::uint64_t)
#undef BRICKYARD_INSTANTIATE

}  // namespace brickyard

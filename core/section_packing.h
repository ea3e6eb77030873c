// Words of a section of a payload as bytes: which samples' words are kept, what predicts them, byte planes,
// zstd. Writing alone; docs/format.md, section "Payload". Pure functions, any thread.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/brick_shape.h"
#include "core/payload_format.h"
#include "core/sample_selection.h"

namespace brickyard {

// A section of a payload but for its states.
struct PackedSection {
    PayloadEncoding encoding = PayloadEncoding::kConstant;
    PayloadPredictor predictor = PayloadPredictor::kNone;
    std::size_t width = 0;
    std::vector<std::byte> parameters;
    std::array<std::uint32_t, kMaxWordBytes> entries{};
    std::vector<std::byte> streams;  // planes, then the selection
    bool selects = false, selects_as_draft = false;
    std::array<std::uint64_t, kMaxComponents> filler{};
    std::uint32_t selection_entry = 0;
    double error_made = 0;
    std::vector<std::byte> decoded;  // where it differs from what was given

    std::size_t bytes(std::size_t components) const {
        const std::size_t selection =
            selects ? components * width + (selects_as_draft ? 0 : sizeof selection_entry) : 0;
        return parameters.size() + width * sizeof(std::uint32_t) + selection + streams.size();
    }
};

// Samples that a section may keep alone, because all others have one word. No mask: not worth it, or not so.
struct Selection {
    std::vector<std::byte> mask;
    std::size_t count = 0;
    bool any() const { return !mask.empty(); }
};
// A mask costs up to a bit per sample and a reader's time: it has to leave out this part of them.
inline constexpr double kLeastLeftOut = 1.0 / 16;

// Samples that are flagged (one byte each, 0 or 1), if that is worth it.
Selection selectFlagged(const std::vector<std::uint8_t>& flags);
// Flags the samples that differ from `other`, beside those flagged already. W: std::uint8_t to std::uint64_t.
template <class W>
void flagOthers(const W* words, std::size_t samples, W other, std::uint8_t* flags);

// How a section's words may be stored.
struct Packing {
    PayloadEncoding encoding = PayloadEncoding::kLossless;
    const Selection* selection = nullptr;  // may be none; otherwise the words of all others are equal
    bool as_draft = false;                 // the selection is that of the draft in front
    // Words are zigzagged differences already: a predictor takes them back first.
    bool predict = true;
};

// What the planes of words will take, about: their order-0 entropy in bytes, from a part of them.
template <class W>
double estimatedBytes(const std::vector<W>& words);

// The words of selected samples alone, planar. REQUIRES: selection.any().
template <class W>
std::vector<W> selectedWords(const std::vector<W>& words, const Selection& selection, std::size_t components);

// Stores `words` (planar, all components) in the way that makes them smallest: that of several whose
// estimates are close is found by trying. W: std::uint8_t to std::uint64_t.
template <class W>
PackedSection packWords(const Packing& packing, const std::vector<W>& words, BrickShape shape,
                        int components);

}  // namespace brickyard

// Writing a payload: choose the cheapest encoding that keeps the error bound, and tell the error that it
// makes; put a draft in front of an exact one where that pays.
#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <type_traits>

#include "core/brick_codec.h"
#include "core/byte_io.h"
#include "core/lorenzo.h"
#include "core/payload_activity.h"
#include "core/payload_format.h"
#include "core/payload_stream.h"
#include "core/payload_words.h"
#include "core/section_packing.h"

namespace brickyard {
namespace {

// Version, encoding, width, predictor, activity.
constexpr std::size_t kSectionHeaderBytes = 5;
// A draft pays where it is less than half of the plain payload and makes the whole no more than this much
// larger. Floats grow by 3 to 6 %, halves, whose noise is thin, by 10 to 17 %
// (docs/decisions/0003-drafts.md).
constexpr double kMostDraftShare = 0.5;
constexpr double kMostGrowth = 1.17;
// A section of so few bytes is mostly its headers.
constexpr std::size_t kLittle = 512;

// What a brick becomes: `exact` holds corrections to the draft where there is one.
struct Sections {
    std::optional<PackedSection> draft;
    PackedSection exact;
};

// Range of one component, and whether it has one.
template <class T>
struct Range {
    T min, max;
    bool finite = true;     // no NaN, no infinity; always so for integers
    bool one_value = true;  // bit for bit
};

template <class T>
Range<T> rangeOf(const T* values, std::size_t n) {
    Range<T> range{values[0], values[0]};
    // Eight independent chains, because the order of floating-point comparisons may not be changed for us.
    constexpr std::size_t kLanes = 8;
    std::array<T, kLanes> low, high;
    low.fill(values[0]);
    high.fill(values[0]);
    bool finite = true;
    for (std::size_t i = 0; i < n; i += kLanes) {
        const T* const group = values + std::min(i, n - kLanes);  // the last group overlaps the one before
        for (std::size_t k = 0; k < kLanes; ++k) {
            low[k] = group[k] < low[k] ? group[k] : low[k];
            high[k] = group[k] > high[k] ? group[k] : high[k];
        }
    }
    for (std::size_t k = 0; k < kLanes; ++k) {
        range.min = std::min(range.min, low[k]);
        range.max = std::max(range.max, high[k]);
    }
    if constexpr (std::is_floating_point_v<T>) {
        constexpr T kMax = std::numeric_limits<T>::max();
        for (std::size_t i = 0; i < n; ++i) finite &= (values[i] >= -kMax) & (values[i] <= kMax);
    }
    range.finite = finite;
    range.one_value = std::memcmp(values, values + 1, (n - 1) * sizeof(T)) == 0;
    return range;
}

template <class T>
ValueBits bitsOf(T value) {
    if constexpr (sizeof(T) == 1) return std::uint8_t(value);
    if constexpr (sizeof(T) == 4) return std::bit_cast<std::uint32_t>(value);
    if constexpr (sizeof(T) == 8) return std::bit_cast<std::uint64_t>(value);
}

template <class T>
PackedSection constantPackedSection(const std::array<T, kMaxComponents>& value, std::size_t components) {
    PackedSection candidate;
    ByteWriter parameters(candidate.parameters);
    for (std::size_t c = 0; c < components; ++c) parameters.put(value[c]);
    return candidate;
}

// One encoder for a brick whose samples are T (bools as uint8).
template <class T>
class Encoder {
public:
    Encoder(const BrickToEncode& brick, const T* values)
        : brick_(brick),
          values_(values),
          n_(brick.shape.samples()),
          components_(std::size_t(brick.components)) {
        for (std::size_t c = 0; c < components_; ++c) {
            ranges_[c] = rangeOf(values_ + c * n_, n_);
            finite_ = finite_ && ranges_[c].finite;
            one_value_ = one_value_ && ranges_[c].one_value;
        }
    }

    Sections best() const {
        Sections sections;
        if constexpr (std::is_floating_point_v<T>) {
            if (brick_.draft_error > 0 && brick_.max_error == 0 && finite_ && !one_value_ &&
                addDraft(sections))
                return sections;
        }
        sections.exact = exact();
        return sections;
    }

private:
    PackedSection exact() const {
        if (one_value_) {
            std::array<T, kMaxComponents> value{};
            for (std::size_t c = 0; c < components_; ++c) value[c] = values_[c * n_];
            return constantPackedSection(value, components_);
        }
        if constexpr (std::is_floating_point_v<T>) {
            // NaN and infinity have no distance to anything: they go through bit for bit.
            if (brick_.max_error > 0 && finite_) {
                PackedSection quantised = approximated(brick_.max_error);
                if (quantised.parameters.empty()) return lossless();
                if (quantised.width == 0) return quantised;
                // Noisy mantissas do not come below half their bytes, so lossless is tried only beside a weak
                // quantisation, where the source saved halves, or where there is so little to store that
                // headers count.
                const std::size_t bytes = quantised.bytes(components_);
                if (bytes * 2 > count() * sizeof(T) || bytes < kLittle ||
                    (quantised.width > 1 && floatWidth() == 2)) {
                    PackedSection exact = lossless();
                    if (exact.bytes(components_) <= quantised.bytes(components_)) return exact;
                }
                return quantised;
            }
        }
        return lossless();
    }

    std::size_t count() const { return n_ * components_; }

    // The least bytes that hold every value exactly as an IEEE number.
    std::size_t floatWidth() const
        requires std::is_floating_point_v<T>
    {
        bool all_float = true;
        if constexpr (sizeof(T) == 8) {
            // -FLT_MAX to FLT_MAX first: beyond it the conversion is not defined.
            constexpr T kMax = std::numeric_limits<float>::max();
            for (std::size_t i = 0; i < count() && all_float; ++i)
                all_float = values_[i] >= -kMax && values_[i] <= kMax &&
                            bitsOf(T(float(values_[i]))) == bitsOf(values_[i]);
            if (!all_float) return 8;
        }
        // Most sources do not store halves and show it in their first samples.
        constexpr std::size_t kChunk = 256;
        for (std::size_t begin = 0; begin < count(); begin += kChunk) {
            bool all_half = true;
            for (std::size_t i = begin; i < std::min(begin + kChunk, count()); ++i)
                all_half &= isHalf(float(values_[i]));
            if (!all_half) return 4;
        }
        return 2;
    }

    // A draft and what corrects it, if that pays.
    bool addDraft(Sections& sections) const
        requires std::is_floating_point_v<T>
    {
        PackedSection draft = approximated(brick_.draft_error, &exactSelection());
        if (draft.parameters.empty()) return false;
        switch (floatWidth()) {
            case 2: return addCorrected<std::uint16_t>(std::move(draft), sections);
            case 4: return addCorrected<std::uint32_t>(std::move(draft), sections);
            default: return addCorrected<std::uint64_t>(std::move(draft), sections);
        }
    }

    template <class W>
    bool addCorrected(PackedSection draft, Sections& sections) const
        requires std::is_floating_point_v<T>
    {
        if constexpr (sizeof(W) <= sizeof(T)) {
            std::vector<W> words = exactWords<W>();
            const auto draft_bytes = double(kSectionHeaderBytes + draft.bytes(components_));
            // A draft as large as half of what is stored plainly is none. The estimate is a bound of it from
            // below.
            const Selection& selection = exactSelection();
            const double plain =
                double(kSectionHeaderBytes) +
                (selection.any() ? estimatedBytes(selectedWords(words, selection, components_))
                                 : estimatedBytes(words));
            if (draft_bytes >= kMostDraftShare * plain) return false;
            PackedSection corrections = correctionsOf(std::move(words), draft);
            const auto whole = draft_bytes + double(kSectionHeaderBytes + corrections.bytes(components_));
            if (whole > kMostGrowth * plain) {
                // The estimate does not know of predictors that fit better, or worse, than none.
                sections.exact = losslessAs<W>();
                if (whole > kMostGrowth * double(kSectionHeaderBytes + sections.exact.bytes(components_)))
                    return true;
            }
            sections.draft = std::move(draft);
            sections.exact = std::move(corrections);
            return true;
        } else {
            return false;
        }
    }

    // What the words of the exact samples are beyond those that the draft predicts.
    template <class W>
    PackedSection correctionsOf(std::vector<W> words, const PackedSection& draft) const
        requires std::is_floating_point_v<T>
    {
        const T* const predicted = reinterpret_cast<const T*>(draft.decoded.data());
        for (std::size_t i = 0; i < words.size(); ++i)
            words[i] = W(words[i] - orderedFromDraft<W>(predicted[i]));
        // What a quantiser leaves over is noise, which a predictor only adds up. A draft of one value
        // leaves all.
        Packing packing;
        packing.selection = &exactSelection();
        packing.as_draft = draft.selects;
        packing.predict = draft.encoding == PayloadEncoding::kConstant;
        if (!packing.predict) {
            for (W& word : words) word = zigzag(word);
            return packWords(packing, std::move(words), brick_.shape, brick_.components);
        }
        // With a predictor the differences are zigzagged by it; without, here.
        PackedSection smoothed = packWords(packing, words, brick_.shape, brick_.components);
        if (smoothed.predictor != PayloadPredictor::kNone) return smoothed;
        for (W& word : words) word = zigzag(word);
        packing.predict = false;
        return packWords(packing, std::move(words), brick_.shape, brick_.components);
    }

    // Samples of which a component is not the background, bit for bit.
    const Selection& exactSelection() const {
        if (selection_) return *selection_;
        using Bits = std::conditional_t<sizeof(T) == 1, std::uint8_t,
                                        std::conditional_t<sizeof(T) == 4, std::uint32_t, std::uint64_t>>;
        std::vector<std::uint8_t> flags(n_, 0);
        for (std::size_t c = 0; c < components_; ++c)
            flagOthers(reinterpret_cast<const Bits*>(values_ + c * n_), n_, Bits(brick_.background[c]),
                       flags.data());
        selection_ = selectFlagged(flags);
        return *selection_;
    }

    template <class W>
    std::vector<W> exactWords() const
        requires std::is_floating_point_v<T>
    {
        std::vector<W> words(count());
        for (std::size_t i = 0; i < words.size(); ++i) {
            if constexpr (sizeof(W) == 2) {
                words[i] = orderedFromBits(halfFromFloat(float(values_[i])));
            } else if constexpr (sizeof(W) == sizeof(T)) {
                W bits;
                std::memcpy(&bits, values_ + i, sizeof(W));
                words[i] = orderedFromBits(bits);
            } else if constexpr (sizeof(W) == 4) {
                words[i] = orderedFromBits(std::bit_cast<std::uint32_t>(float(values_[i])));
            }
        }
        return words;
    }

    template <class W>
    PackedSection losslessAs() const {
        if constexpr (std::is_floating_point_v<T>) {
            return packWords({PayloadEncoding::kLossless, &exactSelection()}, exactWords<W>(), brick_.shape,
                             brick_.components);
        } else {
            using Unsigned = std::make_unsigned_t<T>;
            std::vector<W> words(count());
            for (std::size_t c = 0; c < components_; ++c)
                for (std::size_t i = c * n_; i < (c + 1) * n_; ++i)
                    words[i] = W(Unsigned(Unsigned(values_[i]) - offset(c)));
            PackedSection candidate = packWords({PayloadEncoding::kLossless, &exactSelection()},
                                                std::move(words), brick_.shape, brick_.components);
            if constexpr (sizeof(T) > 1) {
                ByteWriter parameters(candidate.parameters);
                for (std::size_t c = 0; c < components_; ++c) parameters.put(offset(c));
            }
            return candidate;
        }
    }

    // What is subtracted from integers so that they fit fewer bytes. Bools need none.
    auto offset(std::size_t c) const {
        return std::make_unsigned_t<T>(sizeof(T) == 1 ? T(0) : ranges_[c].min);
    }

    PackedSection lossless() const {
        if constexpr (std::is_floating_point_v<T>) {
            switch (floatWidth()) {
                case 2: return losslessAs<std::uint16_t>();
                case 4: return losslessAs<std::uint32_t>();
                default: return losslessAs<std::uint64_t>();
            }
        } else {
            std::uint64_t span = 0;
            for (std::size_t c = 0; c < components_; ++c)
                span = std::max(span, std::uint64_t(std::make_unsigned_t<T>(
                                          std::make_unsigned_t<T>(ranges_[c].max) - offset(c))));
            if (span <= 0xff || sizeof(T) == 1) return losslessAs<std::uint8_t>();
            if (span <= 0xffff) return losslessAs<std::uint16_t>();
            if (span <= 0xffffffffu || sizeof(T) == 4) return losslessAs<std::uint32_t>();
            return losslessAs<std::uint64_t>();
        }
    }

    // The cheapest section within the error; without parameters where there is none.
    // `selection`: samples to keep, where they are known already; nullptr: those that differ from the
    // background once they are quantised.
    PackedSection approximated(double max_error, const Selection* selection = nullptr) const
        requires std::is_floating_point_v<T>
    {
        if (auto near = nearConstant(max_error); !near.parameters.empty()) return near;
        return quantised(max_error, selection);
    }

    // One value within the error of all samples: the background where that will do, else the middle of the
    // range. Without parameters where there is none.
    PackedSection nearConstant(double max_error) const
        requires std::is_floating_point_v<T>
    {
        std::array<T, kMaxComponents> value{};
        double error = 0;
        const auto deviation = [&](std::size_t c, T candidate) {
            return std::max(std::abs(double(ranges_[c].max) - double(candidate)),
                            std::abs(double(ranges_[c].min) - double(candidate)));
        };
        for (std::size_t c = 0; c < components_; ++c) {
            value[c] = T(toDouble(brick_.type, brick_.background[c]));
            // Not finite, or too far; halves are added, because the sum of two doubles may overflow.
            if (!(deviation(c, value[c]) <= max_error))
                value[c] = T(double(ranges_[c].min) * 0.5 + double(ranges_[c].max) * 0.5);
            if (!(deviation(c, value[c]) <= max_error)) return {};
            error = std::max(error, deviation(c, value[c]));
        }
        PackedSection candidate = constantPackedSection(value, components_);
        candidate.error_made = error;
        candidate.decoded.resize(count() * sizeof(T));
        T* const decoded = reinterpret_cast<T*>(candidate.decoded.data());
        for (std::size_t c = 0; c < components_; ++c) std::fill_n(decoded + c * n_, n_, value[c]);
        return candidate;
    }

    // Largest deviation is measured, not derived: rounding to the sample's type adds to half a step. The
    // first step leaves room for it. All bricks of a channel try the same steps, so that neighbours mostly
    // share one and agree on the samples they share. Without parameters where no step will do.
    PackedSection quantised(double max_error, const Selection* selection) const
        requires std::is_floating_point_v<T>
    {
        for (const double steps_per_error : {2 - 0x1p-9, 2 - 0x1p-4, 1.5, 1.0}) {
            const double step = max_error * steps_per_error;
            // Step or its inverse may be denormal or infinite: the sizes below are then no numbers to count
            // on.
            const double inverse = 1 / step;
            if (!std::isfinite(step) || !std::isfinite(inverse)) continue;

            std::array<double, kMaxComponents> base{};
            double q_max = 0;
            bool fits = true;
            for (std::size_t c = 0; c < components_; ++c) {
                const double low = double(ranges_[c].min) * inverse, high = double(ranges_[c].max) * inverse;
                // Above this the rounding trick below fails, and so would the sum of base and q.
                fits = fits && std::abs(low) < kRoundable && std::abs(high) < kRoundable;
                base[c] = rounded(low);
                q_max = std::max(q_max, rounded(high) - base[c]);
            }
            if (!fits || q_max > double(0xffffffffu)) continue;
            PackedSection candidate =
                q_max <= 0xff     ? quantisedAs<std::uint8_t>(max_error, step, inverse, base, selection)
                : q_max <= 0xffff ? quantisedAs<std::uint16_t>(max_error, step, inverse, base, selection)
                                  : quantisedAs<std::uint32_t>(max_error, step, inverse, base, selection);
            if (!candidate.parameters.empty()) return candidate;
        }
        return {};
    }

    static constexpr double kRoundable = 0x1p50;
    // To the nearest integer, for |x| <= kRoundable: doubles near 1.5 * 2^52 are one apart.
    static double rounded(double x) { return (x + 0x1.8p52) - 0x1.8p52; }

    // Without parameters where the error is too large or the format forbids the numbers.
    template <class W>
    PackedSection quantisedAs(double max_error, double step, double inverse,
                              const std::array<double, kMaxComponents>& base,
                              const Selection* selection) const
        requires std::is_floating_point_v<T>
    {
        for (std::size_t c = 0; c < components_; ++c)
            if (!isQuantiser(brick_.type, sizeof(W), step, std::int64_t(base[c]))) return {};

        using Integer = std::conditional_t<sizeof(W) < 4, std::int32_t, std::int64_t>;
        std::vector<W> words(count());
        std::vector<std::byte> decoded(count() * sizeof(T));
        T* const samples = reinterpret_cast<T*>(decoded.data());
        double error = 0;
        for (std::size_t c = 0; c < components_; ++c) {
            const T* const values = values_ + c * n_;
            W* const q = words.data() + c * n_;
            for (std::size_t i = 0; i < n_; ++i)
                q[i] = W(Integer(rounded(double(values[i]) * inverse) - base[c]));
            for (std::size_t i = 0; i < n_; ++i) samples[c * n_ + i] = T(dequantised(q[i], step, base[c]));
            error = std::max(error, largestDeviation(values, samples + c * n_));
        }
        if (!(error <= max_error)) return {};

        Selection own;
        if (!selection) {
            // No word is the background's where that is not within the brick's range.
            std::array<double, kMaxComponents> background{};
            for (std::size_t c = 0; c < components_; ++c)
                background[c] = rounded(toDouble(brick_.type, brick_.background[c]) * inverse) - base[c];
            std::vector<std::uint8_t> flags(n_, 0);
            for (std::size_t c = 0; c < components_; ++c) {
                const bool within =
                    background[c] >= 0 && background[c] <= double(std::numeric_limits<W>::max());
                if (within)
                    flagOthers(words.data() + c * n_, n_, W(background[c]), flags.data());
                else
                    std::fill(flags.begin(), flags.end(), std::uint8_t(1));
            }
            own = selectFlagged(flags);
            selection = &own;
        }
        PackedSection candidate = packWords({PayloadEncoding::kQuantised, selection}, std::move(words),
                                            brick_.shape, brick_.components);
        ByteWriter parameters(candidate.parameters);
        parameters.put(step);
        for (std::size_t c = 0; c < components_; ++c) parameters.put(std::int64_t(base[c]));
        candidate.error_made = error;
        candidate.decoded = std::move(decoded);
        return candidate;
    }

    double largestDeviation(const T* a, const T* b) const {
        constexpr std::size_t kLanes = 8;
        std::array<double, kLanes> largest{};
        for (std::size_t i = 0; i < n_; i += kLanes) {
            const std::size_t at = std::min(i, n_ - kLanes);
            for (std::size_t k = 0; k < kLanes; ++k) {
                const double deviation = std::abs(double(a[at + k]) - double(b[at + k]));
                largest[k] = deviation > largest[k] ? deviation : largest[k];
            }
        }
        return *std::max_element(largest.begin(), largest.end());
    }

    const BrickToEncode& brick_;
    const T* values_;
    std::size_t n_;
    std::size_t components_;
    std::array<Range<T>, kMaxComponents> ranges_{};
    bool finite_ = true;
    bool one_value_ = true;
    mutable std::optional<Selection> selection_;
};

Sections bestSections(const BrickToEncode& brick) {
    const std::byte* const values = brick.values.data();
    switch (brick.type) {
        case SampleType::kFloat32:
            return Encoder<float>(brick, reinterpret_cast<const float*>(values)).best();
        case SampleType::kFloat64:
            return Encoder<double>(brick, reinterpret_cast<const double*>(values)).best();
        case SampleType::kInt32:
            return Encoder<std::int32_t>(brick, reinterpret_cast<const std::int32_t*>(values)).best();
        case SampleType::kInt64:
            return Encoder<std::int64_t>(brick, reinterpret_cast<const std::int64_t*>(values)).best();
        case SampleType::kBool: break;
    }
    return Encoder<std::uint8_t>(brick, reinterpret_cast<const std::uint8_t*>(values)).best();
}

// States as the payload keeps them; `mask` receives the bits where nothing cheaper tells them.
PayloadActivity activityOf(const BrickToEncode& brick, std::span<const std::byte> decoded,
                           std::vector<std::byte>& mask) {
    if (brick.active.empty()) return PayloadActivity::kNotKept;
    const auto isActive = [](std::uint8_t state) { return state != 0; };
    if (std::none_of(brick.active.begin(), brick.active.end(), isActive)) return PayloadActivity::kNoneActive;
    if (std::all_of(brick.active.begin(), brick.active.end(), isActive)) return PayloadActivity::kAllActive;

    // A reader compares what it decodes, so the writer does too.
    const auto by_background =
        statesByBackground(decoded, brick.shape, brick.type, brick.components, brick.background);
    if (std::equal(brick.active.begin(), brick.active.end(), by_background.begin(),
                   [](std::uint8_t a, std::uint8_t b) { return (a != 0) == (b != 0); }))
        return PayloadActivity::kDiffersFromBackground;

    mask.assign(brick.active.size() / 8, std::byte{0});
    for (std::size_t i = 0; i < brick.active.size(); ++i)
        mask[i / 8] |= std::byte(std::uint8_t((brick.active[i] != 0 ? 1u : 0u) << (i % 8)));
    return PayloadActivity::kMask;
}

template <class T>
double rmsOf(const T* before, const T* after, std::size_t n, double largest) {
    // In parts of the largest, so that squares neither vanish nor overflow. Sums that do not depend on each
    // other.
    constexpr std::size_t kLanes = 8;
    std::array<double, kLanes> squares{};
    const double inverse = 1 / largest;
    if (!std::isfinite(inverse)) return largest;
    std::size_t i = 0;
    for (; i + kLanes <= n; i += kLanes)
        for (std::size_t k = 0; k < kLanes; ++k) {
            const double d = (double(after[i + k]) - double(before[i + k])) * inverse;
            squares[k] += d * d;
        }
    double sum = 0;
    for (; i < n; ++i)
        sum += (double(after[i]) - double(before[i])) * inverse *
               ((double(after[i]) - double(before[i])) * inverse);
    for (double part : squares) sum += part;
    return largest * std::sqrt(sum / double(n));
}

// Root mean square of decoded less given. REQUIRES: a float type, and `largest` is the largest deviation,
// above 0.
double rmsDeviation(const BrickToEncode& brick, std::span<const std::byte> decoded, double largest) {
    const std::size_t n = brick.shape.samples() * std::size_t(brick.components);
    if (brick.type == SampleType::kFloat32)
        return rmsOf(reinterpret_cast<const float*>(brick.values.data()),
                     reinterpret_cast<const float*>(decoded.data()), n, largest);
    return rmsOf(reinterpret_cast<const double*>(brick.values.data()),
                 reinterpret_cast<const double*>(decoded.data()), n, largest);
}

// `mask_entry` is that of the mask at the end of the section's streams, if the states need one.
void appendSection(const PackedSection& section, int components, std::uint8_t flags, PayloadActivity activity,
                   std::uint32_t mask_entry, std::vector<std::byte>& out) {
    ByteWriter writer(out);
    writer.put(section.selects ? kSelectingVersion : kPayloadVersion);
    if (section.selects) flags |= kSelectionFlag;
    if (section.selects_as_draft) flags |= kDraftSelectionFlag;
    writer.put(std::uint8_t(std::uint8_t(section.encoding) | flags));
    writer.put(std::uint8_t(section.width));
    writer.put(section.predictor);
    writer.put(activity);
    writer.putBytes(section.parameters);
    if (section.selects)
        for (std::size_t c = 0; c < std::size_t(components); ++c)
            for (std::size_t j = 0; j < section.width; ++j)
                writer.put(std::uint8_t(section.filler[c] >> (8 * j)));
    for (std::size_t j = 0; j < section.width; ++j) writer.put(section.entries[j]);
    if (section.selects && !section.selects_as_draft) writer.put(section.selection_entry);
    if (activity == PayloadActivity::kMask) writer.put(mask_entry);
    writer.putBytes(section.streams);
}

}  // namespace

EncodedBrick encodeBrick(const BrickToEncode& given) {
    BrickToEncode brick = given;
    // The loops read samples as numbers, which the caller's bytes may not be aligned for.
    std::vector<std::byte> aligned;
    if (reinterpret_cast<std::uintptr_t>(brick.values.data()) % sampleBytes(brick.type) != 0) {
        aligned.assign(brick.values.begin(), brick.values.end());
        brick.values = aligned;
    }
    assert(isBrickEdge(brick.shape.edge_cells));
    assert(brick.components >= 1 && brick.components <= kMaxComponents);
    assert(brick.values.size() ==
           brick.shape.samples() * std::size_t(brick.components) * sampleBytes(brick.type));
    assert(brick.active.empty() || brick.active.size() == brick.shape.cells());
    assert(brick.background.size() >= std::size_t(brick.components));
    assert(brick.max_error >= 0 && brick.draft_error >= 0);

    auto [draft, exact] = bestSections(brick);
    const auto decoded = exact.decoded.empty() ? brick.values : std::span<const std::byte>(exact.decoded);
    std::vector<std::byte> mask;
    const PayloadActivity activity = activityOf(brick, decoded, mask);
    std::uint32_t mask_entry = 0;
    if (!mask.empty()) mask_entry = appendStream(mask, exact.streams);

    EncodedBrick encoded;
    encoded.error_made = exact.error_made;
    if (exact.error_made > 0) encoded.rms_made = rmsDeviation(brick, exact.decoded, exact.error_made);
    const auto components = std::size_t(brick.components);
    encoded.payload.reserve(32 + exact.bytes(components) + (draft ? draft->bytes(components) : 0));
    if (draft) {
        appendSection(*draft, brick.components, kDraftFlag, PayloadActivity::kNotKept, 0, encoded.payload);
        encoded.draft_bytes = encoded.payload.size();
        encoded.draft_error_made = draft->error_made;
        if (draft->error_made > 0)
            encoded.draft_rms_made = rmsDeviation(brick, draft->decoded, draft->error_made);
    }
    appendSection(exact, brick.components, 0, activity, mask_entry, encoded.payload);
    return encoded;
}

}  // namespace brickyard

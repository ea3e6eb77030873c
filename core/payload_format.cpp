#include "core/payload_format.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>

#include "core/byte_io.h"

namespace brickyard {
namespace {

bool isWidth(PayloadEncoding encoding, SampleType type, std::size_t width) {
    const bool power_of_two = width == 1 || width == 2 || width == 4 || width == 8;
    switch (encoding) {
        case PayloadEncoding::kConstant: return width == 0;
        case PayloadEncoding::kQuantised: return isFloating(type) && power_of_two && width <= 4;
        case PayloadEncoding::kLossless:
            return power_of_two && width <= sampleBytes(type) && !(isFloating(type) && width == 1);
    }
    return false;
}

bool isPredictor(const PayloadParts& parts) {
    switch (parts.predictor) {
        case PayloadPredictor::kNone: return true;
        case PayloadPredictor::kLorenzo: return !parts.selects;
        case PayloadPredictor::kPrevious: return parts.selects;
    }
    return false;
}

bool isInteger(SampleType type) { return type == SampleType::kInt32 || type == SampleType::kInt64; }

ValueBits readValue(ByteReader& reader, SampleType type) {
    switch (sampleBytes(type)) {
        case 1: return reader.get<std::uint8_t>();
        case 4: return reader.get<std::uint32_t>();
        default: return reader.get<std::uint64_t>();
    }
}

// The entry now, its bytes later: they follow all entries.
PayloadStream readEntry(ByteReader& reader, std::uint32_t& bytes) {
    const auto entry = reader.get<std::uint32_t>();
    bytes = entry & ((1u << kStreamModeShift) - 1);
    return {StreamMode(entry >> kStreamModeShift), {}};
}

bool isStream(const PayloadStream& stream) {
    switch (stream.mode) {
        case StreamMode::kUniform: return stream.stored.size() == 1;
        case StreamMode::kStored:
        case StreamMode::kZstd:
            return true;  // their lengths are compared with the brick's when they are read
    }
    return false;
}

tl::unexpected<Error> corrupt(std::string message) {
    return fail(ErrorCode::kCorrupt, message + "; convert this frame again");
}

tl::unexpected<Error> notTheSum(std::size_t payload_bytes) {
    return corrupt(fmt::format("payload of {} bytes, but its parts do not add up to that", payload_bytes));
}

}  // namespace

bool isQuantiser(SampleType type, std::size_t width, double step, std::int64_t base) {
    if (!std::isfinite(step) || step < 0 || base < -kMaxQuantiserBase || base > kMaxQuantiserBase)
        return false;
    const double q_max = width == 1 ? 0xff : width == 2 ? 0xffff : 0xffffffffu;
    const double largest = std::max(std::abs(double(base)), std::abs(double(base) + q_max));
    const double limit = type == SampleType::kFloat32 ? double(std::numeric_limits<float>::max())
                                                      : std::numeric_limits<double>::max();
    return step * largest <= limit;
}

namespace {

struct Section {
    PayloadParts parts;
    bool is_draft = false;
};

// One section, from its version to the last byte of its streams. `payload_bytes` is for messages.
Result<Section> readSection(ByteReader& reader, std::size_t payload_bytes, SampleType type, int components) {
    Section section;
    PayloadParts& parts = section.parts;
    const bool is_empty = reader.left() == 0;
    const auto version = reader.get<std::uint8_t>();
    if (!is_empty && version != kPayloadVersion && version != kSelectingVersion)
        return corrupt(fmt::format("payload version {} is none that this reader knows", version));

    // An enumeration read from a file may hold any number: `isWidth` and the two comparisons below refuse the
    // unknown.
    const auto encoding = reader.get<std::uint8_t>();
    section.is_draft = (encoding & kDraftFlag) != 0;
    parts.selects = (encoding & kSelectionFlag) != 0;
    parts.selects_as_draft = (encoding & kDraftSelectionFlag) != 0;
    parts.encoding = PayloadEncoding(encoding & ~(kDraftFlag | kSelectionFlag | kDraftSelectionFlag));
    parts.width = reader.get<std::uint8_t>();
    parts.predictor = PayloadPredictor(reader.get<std::uint8_t>());
    parts.activity = PayloadActivity(reader.get<std::uint8_t>());
    if (!reader.ok())
        return corrupt(fmt::format("payload of {} bytes ends within its header", payload_bytes));
    if (!isWidth(parts.encoding, type, parts.width) || !isPredictor(parts) ||
        parts.activity > PayloadActivity::kMask ||
        (parts.encoding == PayloadEncoding::kConstant &&
         (parts.predictor != PayloadPredictor::kNone || parts.selects)) ||
        parts.selects != (version == kSelectingVersion) ||
        (parts.selects_as_draft && (!parts.selects || section.is_draft)))
        return corrupt(fmt::format(
            "payload with encoding {}, width {}, predictor {}, activity {} cannot be {}", int(parts.encoding),
            parts.width, int(parts.predictor), int(parts.activity), toString(type)));
    // What a draft leaves out, the section behind it tells.
    if (section.is_draft && (!isFloating(type) || parts.encoding == PayloadEncoding::kLossless ||
                             parts.activity != PayloadActivity::kNotKept))
        return corrupt(fmt::format("payload with a draft of encoding {}, activity {} cannot be {}",
                                   int(parts.encoding), int(parts.activity), toString(type)));

    // Parameters of the encoding.
    const auto n = std::size_t(components);
    if (parts.encoding == PayloadEncoding::kConstant) {
        for (std::size_t c = 0; c < n; ++c) {
            parts.constant[c] = readValue(reader, type);
            if (type == SampleType::kBool && parts.constant[c] > 1)
                return corrupt("payload with a bool above 1");
            if (section.is_draft && !std::isfinite(toDouble(type, parts.constant[c])))
                return corrupt("payload with a draft that is no number");
        }
    } else if (parts.encoding == PayloadEncoding::kQuantised) {
        parts.step = reader.get<double>();
        for (std::size_t c = 0; c < n; ++c) {
            parts.base[c] = reader.get<std::int64_t>();
            if (!isQuantiser(type, parts.width, parts.step, parts.base[c]))
                return corrupt(
                    fmt::format("payload with quantiser step {}, base {}", parts.step, parts.base[c]));
        }
    } else if (isInteger(type)) {
        for (std::size_t c = 0; c < n; ++c) parts.offset[c] = readValue(reader, type);
    }

    if (parts.selects)
        for (std::size_t c = 0; c < n; ++c)
            for (std::size_t j = 0; j < parts.width; ++j)
                parts.filler[c] |= std::uint64_t(reader.get<std::uint8_t>()) << (8 * j);

    // Streams: all entries, then all bytes.
    std::array<std::uint32_t, kMaxWordBytes> plane_bytes{};
    std::uint32_t mask_bytes = 0, selection_bytes = 0;
    for (std::size_t j = 0; j < parts.width; ++j) parts.planes[j] = readEntry(reader, plane_bytes[j]);
    const bool has_selection = parts.selects && !parts.selects_as_draft;
    if (has_selection) parts.selection = readEntry(reader, selection_bytes);
    const bool has_mask = parts.activity == PayloadActivity::kMask;
    if (has_mask) parts.mask = readEntry(reader, mask_bytes);
    bool sound = true;
    for (std::size_t j = 0; j < parts.width; ++j) {
        parts.planes[j].stored = reader.take(plane_bytes[j]);
        sound = sound && isStream(parts.planes[j]);
    }
    if (has_selection) {
        parts.selection.stored = reader.take(selection_bytes);
        sound = sound && isStream(parts.selection);
    }
    if (has_mask) {
        parts.mask.stored = reader.take(mask_bytes);
        sound = sound && isStream(parts.mask);
    }
    if (!reader.ok() || !sound) return notTheSum(payload_bytes);
    return section;
}

}  // namespace

Result<ParsedPayload> parsePayload(std::span<const std::byte> payload, SampleType type, int components) {
    ByteReader reader(payload);
    ParsedPayload parsed;
    auto section = readSection(reader, payload.size(), type, components);
    if (section && section->is_draft) {
        parsed.draft = section->parts;
        section = readSection(reader, payload.size(), type, components);
        if (section && (section->is_draft || section->parts.encoding != PayloadEncoding::kLossless))
            return corrupt("payload with a draft that nothing corrects");
        if (section && section->parts.selects_as_draft && !parsed.draft->selects)
            return corrupt("payload that selects as its draft, which selects nothing");
    }
    if (!section) return tl::unexpected(section.error());
    if (reader.left() != 0) return notTheSum(payload.size());
    if (section->parts.selects_as_draft && !parsed.draft)
        return corrupt("payload that selects as a draft that is not there");
    parsed.exact = section->parts;
    return parsed;
}

Result<PayloadParts> parseDraft(std::span<const std::byte> draft, SampleType type, int components) {
    ByteReader reader(draft);
    const auto section = readSection(reader, draft.size(), type, components);
    if (!section) return tl::unexpected(section.error());
    if (!section->is_draft) return corrupt("payload without a draft");
    if (reader.left() != 0) return notTheSum(draft.size());
    return section->parts;
}

}  // namespace brickyard

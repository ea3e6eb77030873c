#include "tools/importers/vdb_values.h"

#include <blosc.h>
#include <fmt/format.h>
#include <zlib.h>

#include <bit>
#include <cmath>
#include <cstring>

#include "core/byte_io.h"
#include "core/half.h"

namespace brickyard {
namespace {

// The code that begins a node's values: what became of those that are not active.
enum InactiveValues : std::uint8_t {
    kBackground = 0,
    kMinusBackground = 1,
    kOneValue = 2,
    kMinusBackgroundOrBackground = 3,  // from here to 5 a mask selects
    kOneValueOrBackground = 4,
    kTwoValues = 5,
    kStored = 6,  // with the active ones
};

struct Parts {
    VdbValue inactive[2];
    std::span<const std::byte> selection;  // empty: always inactive[0]
    std::size_t count = 0;                 // values that are stored
    bool active_only = false;
    bool packed = false;  // else the values as they are
    std::uint64_t stored_bytes = 0;
    std::size_t head_bytes = 0;
};

tl::unexpected<Error> corrupt(std::string what) { return fail(ErrorCode::kCorrupt, std::move(what)); }

// No compressor makes more of a node than this: a greater length is damage, and would be memory.
std::uint64_t mostPacked(std::uint64_t raw, std::uint32_t compression) {
    return compression & VdbCoding::kBlosc ? raw + BLOSC_MAX_OVERHEAD : ::compressBound(uLong(raw));
}

Result<Parts> parse(std::span<const std::byte> bytes, const VdbCoding& coding, std::size_t slots,
                    std::size_t active) {
    ByteReader reader(bytes);
    Parts parts;
    const auto code = reader.get<std::uint8_t>();
    if (reader.ok() && code > kStored) return corrupt(fmt::format("a node has the unknown code {}", code));
    parts.inactive[0] = code == kBackground ? coding.background : coding.minus_background;
    parts.inactive[1] = coding.background;
    const auto getValue = [&](VdbValue& value) {
        const auto stored = reader.take(coding.type.bytes());
        if (!stored.empty()) std::memcpy(value.data(), stored.data(), stored.size());
    };
    if (code == kOneValue || code == kOneValueOrBackground || code == kTwoValues) getValue(parts.inactive[0]);
    if (code == kTwoValues) getValue(parts.inactive[1]);
    if (code >= kMinusBackgroundOrBackground && code <= kTwoValues) parts.selection = reader.take(slots / 8);

    parts.active_only = (coding.compression & VdbCoding::kActiveMask) && code != kStored;
    parts.count = parts.active_only ? active : slots;
    const std::uint64_t raw = parts.count * coding.storedBytes();
    parts.stored_bytes = raw;
    const bool halves = coding.storedBytes() != coding.type.bytes();
    // Of no halves nothing is stored, not even that there are none.
    if ((coding.compression & (VdbCoding::kBlosc | VdbCoding::kZip)) && !(halves && raw == 0)) {
        const auto length = reader.get<std::int64_t>();
        parts.packed = length > 0;
        parts.stored_bytes = parts.packed ? std::uint64_t(length) : raw;
        if (reader.ok() && (parts.packed ? std::uint64_t(length) > mostPacked(raw, coding.compression)
                                         : std::uint64_t(0) - std::uint64_t(length) != raw))
            return corrupt(fmt::format("a node's {} bytes of values claim to be {} stored", raw, length));
    }
    if (!reader.ok()) return corrupt("a node is cut off");
    parts.head_bytes = bytes.size() - reader.left();
    return parts;
}

Result<void> unpack(std::span<const std::byte> packed, std::uint32_t compression, std::span<std::byte> out) {
    if (out.empty()) return {};
    if (compression & VdbCoding::kBlosc) {
        // The compressed bytes state their sizes once more; blosc reads beyond ours unless they agree.
        std::size_t raw = 0;
        if (packed.size() < BLOSC_MIN_HEADER_LENGTH ||
            ::blosc_cbuffer_validate(packed.data(), packed.size(), &raw) != 0 || raw != out.size() ||
            ::blosc_decompress_ctx(packed.data(), out.data(), out.size(), /*numinternalthreads=*/1) !=
                int(out.size()))
            return corrupt(
                fmt::format("{} bytes do not decompress (blosc) to {}", packed.size(), out.size()));
    } else {
        uLongf raw = uLongf(out.size());
        if (::uncompress(reinterpret_cast<Bytef*>(out.data()), &raw,
                         reinterpret_cast<const Bytef*>(packed.data()), uLong(packed.size())) != Z_OK ||
            raw != out.size())
            return corrupt(fmt::format("{} bytes do not decompress (zip) to {}", packed.size(), out.size()));
    }
    return {};
}

float floatFromAnyHalf(std::uint16_t half) {
    if ((half & 0x7c00u) != 0x7c00u) return floatFromHalf(half);
    return std::bit_cast<float>(std::uint32_t(half & 0x8000u) << 16 | 0x7f800000u |
                                std::uint32_t(half & 0x3ffu) << 13);
}

// `count` halves at `halves` as T, to `out`.
template <class T>
void widen(const std::byte* halves, std::size_t count, std::byte* out) {
    for (std::size_t i = 0; i < count; ++i) {
        std::uint16_t half;
        std::memcpy(&half, halves + 2 * i, sizeof half);
        const T value = T(floatFromAnyHalf(half));
        std::memcpy(out + i * sizeof value, &value, sizeof value);
    }
}

// Puts the stored (active) values and the inactive ones each at its slot.
template <std::size_t kBytes>
void scatter(const std::byte* stored, const Parts& parts, std::span<const std::uint64_t> mask,
             std::byte* out) {
    for (std::size_t word = 0; word < mask.size(); ++word) {
        std::uint64_t selected = 0;
        if (!parts.selection.empty())
            std::memcpy(&selected, parts.selection.data() + 8 * word, sizeof selected);
        const std::uint64_t on = mask[word];
        for (int bit = 0; bit < 64; ++bit, out += kBytes) {
            if (on >> bit & 1) {
                std::memcpy(out, stored, kBytes);
                stored += kBytes;
            } else {
                std::memcpy(out, parts.inactive[selected >> bit & 1].data(), kBytes);
            }
        }
    }
}

template <class T>
void negate(std::byte* value) {
    T number;
    std::memcpy(&number, value, sizeof number);
    if constexpr (std::is_integral_v<T>)
        number = T(std::make_unsigned_t<T>(0) - std::make_unsigned_t<T>(number));  // the lowest one stays
    else
        number = -number;
    std::memcpy(value, &number, sizeof number);
}

}  // namespace

std::optional<VdbValueType> findVdbValueType(std::string_view word) {
    static constexpr struct {
        std::string_view word;
        VdbValueType type;
    } kTypes[] = {{"float", {SampleType::kFloat32, 1, false}}, {"double", {SampleType::kFloat64, 1, false}},
                  {"int32", {SampleType::kInt32, 1, false}},   {"int64", {SampleType::kInt64, 1, false}},
                  {"bool", {SampleType::kBool, 1, false}},     {"mask", {SampleType::kBool, 1, true}},
                  {"vec3s", {SampleType::kFloat32, 3, false}}, {"vec3d", {SampleType::kFloat64, 3, false}},
                  {"vec3i", {SampleType::kInt32, 3, false}}};
    for (const auto& known : kTypes)
        if (known.word == word) return known.type;
    return std::nullopt;
}

void VdbCoding::setBackground(std::span<const std::byte> value) {
    std::memcpy(background.data(), value.data(), value.size());
    // A bool is a byte in the file, and in a hostile one any byte.
    if (type.component == SampleType::kBool) background[0] = std::byte(background[0] != std::byte(0));
    minus_background = background;
    for (int c = 0; c < type.components; ++c) {
        std::byte* part = minus_background.data() + std::size_t(c) * sampleBytes(type.component);
        switch (type.component) {
            case SampleType::kFloat32: negate<float>(part); break;
            case SampleType::kFloat64: negate<double>(part); break;
            case SampleType::kInt32: negate<std::int32_t>(part); break;
            case SampleType::kInt64: negate<std::int64_t>(part); break;
            case SampleType::kBool: *part ^= std::byte(1); break;
        }
    }
}

Result<std::uint64_t> measureVdbValues(std::span<const std::byte> bytes, const VdbCoding& coding,
                                       std::size_t slots, std::size_t active) {
    const auto parts = parse(bytes, coding, slots, active);
    if (!parts) return tl::unexpected(parts.error());
    return parts->head_bytes + parts->stored_bytes;
}

Result<void> decodeVdbValues(std::span<const std::byte> bytes, const VdbCoding& coding,
                             std::span<const std::uint64_t> mask, std::byte* out,
                             std::vector<std::byte>& scratch) {
    const std::size_t slots = 64 * mask.size();
    std::size_t active = 0;
    for (const std::uint64_t word : mask) active += std::size_t(std::popcount(word));
    const auto parts = parse(bytes, coding, slots, active);
    if (!parts) return tl::unexpected(parts.error());
    if (bytes.size() != parts->head_bytes + parts->stored_bytes)
        return corrupt("a node has changed its length");

    // Stored bytes -> values as stored -> values as they are -> each at its slot; a step that changes nothing
    // is left out, and the last one writes to `out`.
    const bool halves = coding.storedBytes() != coding.type.bytes();
    const bool scattered = parts->active_only && active != slots;
    const std::size_t raw_bytes = parts->count * coding.storedBytes(),
                      value_bytes = parts->count * coding.type.bytes();
    if (scratch.size() < raw_bytes + value_bytes) scratch.resize(raw_bytes + value_bytes);
    std::byte* const raw = scratch.data();
    std::byte* const values = scattered ? scratch.data() + raw_bytes : out;
    const auto stored = bytes.subspan(parts->head_bytes);
    const std::byte* source = stored.data();
    if (parts->packed) {
        std::byte* const unpacked = halves ? raw : values;
        if (auto done = unpack(stored, coding.compression, {unpacked, raw_bytes}); !done) return done;
        source = unpacked;
    }
    if (halves) {
        const std::size_t numbers = parts->count * std::size_t(coding.type.components);
        if (coding.type.component == SampleType::kFloat32)
            widen<float>(source, numbers, values);
        else
            widen<double>(source, numbers, values);
        source = values;
    }
    if (scattered) {
        switch (coding.type.bytes()) {
            case 1: scatter<1>(source, *parts, mask, out); break;
            case 4: scatter<4>(source, *parts, mask, out); break;
            case 8: scatter<8>(source, *parts, mask, out); break;
            case 12: scatter<12>(source, *parts, mask, out); break;
            default: scatter<24>(source, *parts, mask, out); break;
        }
    } else if (source != out && value_bytes > 0) {
        std::memcpy(out, source, value_bytes);
    }
    if (coding.type.component == SampleType::kBool)
        for (std::size_t i = 0; i < slots; ++i) out[i] = std::byte(out[i] != std::byte(0));
    return {};
}

}  // namespace brickyard

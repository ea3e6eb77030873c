#include "tools/importers/dense_layout.h"

#include <fmt/format.h>

#include <bit>
#include <cstring>
#include <limits>
#include <type_traits>

#include "core/half.h"

namespace brickyard {
namespace {

struct ElementEntry {
    ElementType type;
    const char* name;
    std::size_t bytes;
    SampleType sample;
};
constexpr ElementEntry kElements[] = {{ElementType::kUint8, "uint8", 1, SampleType::kInt32},
                                      {ElementType::kInt8, "int8", 1, SampleType::kInt32},
                                      {ElementType::kUint16, "uint16", 2, SampleType::kInt32},
                                      {ElementType::kInt16, "int16", 2, SampleType::kInt32},
                                      {ElementType::kUint32, "uint32", 4, SampleType::kInt64},
                                      {ElementType::kInt32, "int32", 4, SampleType::kInt32},
                                      {ElementType::kUint64, "uint64", 8, SampleType::kInt64},
                                      {ElementType::kInt64, "int64", 8, SampleType::kInt64},
                                      {ElementType::kFloat16, "float16", 2, SampleType::kFloat32},
                                      {ElementType::kFloat32, "float32", 4, SampleType::kFloat32},
                                      {ElementType::kFloat64, "float64", 8, SampleType::kFloat64}};

const ElementEntry& entryOf(ElementType type) { return kElements[std::size_t(type)]; }

template <std::size_t kBytes>
using Unsigned =
    std::conditional_t<kBytes == 1, std::uint8_t,
                       std::conditional_t<kBytes == 2, std::uint16_t,
                                          std::conditional_t<kBytes == 4, std::uint32_t, std::uint64_t>>>;

template <class Bits>
Bits swapped(Bits bits) {
    if constexpr (sizeof(Bits) == 2) return __builtin_bswap16(bits);
    if constexpr (sizeof(Bits) == 4) return __builtin_bswap32(bits);
    if constexpr (sizeof(Bits) == 8) return __builtin_bswap64(bits);
    return bits;
}

// A half that stays what it is, also where it is infinite or NaN.
struct Half {
    std::uint16_t bits;
    operator float() const {
        if ((bits & 0x7c00) != 0x7c00) return floatFromHalf(bits);
        const std::uint32_t sign = std::uint32_t(bits & 0x8000) << 16, mantissa = std::uint32_t(bits & 0x3ff)
                                                                                  << 13;
        return std::bit_cast<float>(sign | 0x7f800000 | mantissa);
    }
};

template <class From, class To, bool kSwap>
bool convertRow(const std::byte* from, std::size_t stride, std::size_t count, std::byte* to) {
    using Bits = Unsigned<sizeof(From)>;
    // Nothing to do but to copy, which is as fast as memory.
    if constexpr (std::is_same_v<From, To> && !kSwap)
        if (stride == sizeof(From)) {
            std::memcpy(to, from, count * sizeof(From));
            return true;
        }
    bool exact = true;
    const auto one = [&](const std::byte* in, std::byte* out) {
        Bits bits;
        std::memcpy(&bits, in, sizeof bits);
        if constexpr (kSwap) bits = swapped(bits);
        const From element = std::bit_cast<From>(bits);
        if constexpr (std::is_same_v<From, std::uint64_t>)
            exact = exact && element <= std::uint64_t(std::numeric_limits<std::int64_t>::max());
        const To sample = static_cast<To>(element);
        std::memcpy(out, &sample, sizeof sample);
    };
    // Its own loop, which the compiler can turn into vector code.
    if (stride == sizeof(From)) {
        for (std::size_t i = 0; i < count; ++i) one(from + i * sizeof(From), to + i * sizeof(To));
    } else {
        for (std::size_t i = 0; i < count; ++i) one(from + i * stride, to + i * sizeof(To));
    }
    return exact;
}

template <class From, class To>
ConvertRow pick(bool big_endian) {
    if (big_endian && sizeof(From) > 1) return convertRow<From, To, true>;
    return convertRow<From, To, false>;
}

}  // namespace

std::size_t elementBytes(ElementType type) { return entryOf(type).bytes; }
const char* toString(ElementType type) { return entryOf(type).name; }
SampleType sampleTypeOf(ElementType type) { return entryOf(type).sample; }

std::optional<ElementType> elementTypeFromName(std::string_view name) {
    for (const ElementEntry& entry : kElements)
        if (name == entry.name) return entry.type;
    return std::nullopt;
}

Result<std::uint64_t> DenseLayout::bytes() const {
    // Each extent is below 2^31, so a product of two is exact in 64 bits, and one of all in 128.
    unsigned __int128 product = elementBytes(element) * std::size_t(components);
    for (const std::int64_t extent : extents) {
        if (extent < 1 || extent > std::numeric_limits<std::int32_t>::max())
            return fail(ErrorCode::kInvalid,
                        fmt::format("an extent of {} samples is not between 1 and 2147483647", extent));
        product *= std::uint64_t(extent);
    }
    if (product + offset > (unsigned __int128)(1) << 62)
        return fail(ErrorCode::kInvalid, fmt::format("{} is more than any file can hold", describe()));
    return std::uint64_t(product);
}

std::string DenseLayout::describe() const {
    return fmt::format("{}x{}x{} {}{}", extents[0], extents[1], extents[2], toString(element),
                       components > 1 ? fmt::format(" of {} components", components) : "");
}

ConvertRow rowConverter(ElementType type, bool big_endian) {
    switch (type) {
        case ElementType::kUint8: return pick<std::uint8_t, std::int32_t>(big_endian);
        case ElementType::kInt8: return pick<std::int8_t, std::int32_t>(big_endian);
        case ElementType::kUint16: return pick<std::uint16_t, std::int32_t>(big_endian);
        case ElementType::kInt16: return pick<std::int16_t, std::int32_t>(big_endian);
        case ElementType::kUint32: return pick<std::uint32_t, std::int64_t>(big_endian);
        case ElementType::kInt32: return pick<std::int32_t, std::int32_t>(big_endian);
        case ElementType::kUint64: return pick<std::uint64_t, std::int64_t>(big_endian);
        case ElementType::kInt64: return pick<std::int64_t, std::int64_t>(big_endian);
        case ElementType::kFloat16: return pick<Half, float>(big_endian);
        case ElementType::kFloat32: return pick<float, float>(big_endian);
        case ElementType::kFloat64: return pick<double, double>(big_endian);
    }
    return nullptr;
}

}  // namespace brickyard

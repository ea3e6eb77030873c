// What one sample of a channel is. The numbers are those of the file format (proto SampleType) and may not
// change.
#pragma once

#include <cstddef>
#include <cstdint>

namespace brickyard {

enum class SampleType : std::uint8_t { kFloat32 = 1, kFloat64 = 2, kInt32 = 3, kInt64 = 4, kBool = 5 };

constexpr std::size_t sampleBytes(SampleType type) {
    switch (type) {
        case SampleType::kFloat32:
        case SampleType::kInt32: return 4;
        case SampleType::kFloat64:
        case SampleType::kInt64: return 8;
        case SampleType::kBool: return 1;
    }
    return 0;
}

constexpr bool isFloating(SampleType type) {
    return type == SampleType::kFloat32 || type == SampleType::kFloat64;
}

// What a payload of `level` stores. Level 0 is the source's own type. Coarser levels are averages: halves of
// integers and fractions of bools are floating, and double where the level-0 type has more digits than a
// float.
constexpr SampleType levelType(SampleType type, int level) {
    if (level == 0) return type;
    return type == SampleType::kFloat32 || type == SampleType::kBool ? SampleType::kFloat32
                                                                     : SampleType::kFloat64;
}

const char* toString(SampleType type);

// One value as its bits, zero-extended to 64: float32 as IEEE bits in the low half, int32 in the low half
// (two's complement), bool 0 or 1.
using ValueBits = std::uint64_t;

double toDouble(SampleType type, ValueBits bits);
// The nearest float, saturated to the finite range.
float toFloat(SampleType type, ValueBits bits);
ValueBits fromDouble(SampleType type, double value);

}  // namespace brickyard

#include "core/sample_type.h"

#include <bit>
#include <cmath>
#include <limits>

namespace brickyard {
namespace {

// Rounds to nearest and stays within Int. NaN, which no integer resembles, becomes 0.
template <class Int>
Int saturatedInteger(double value) {
    if (!(value == value)) return 0;
    const double rounded = std::nearbyint(value);
    // Int's maximum may round up to 2^63 as a double, which no longer fits: hence >=.
    if (rounded >= double(std::numeric_limits<Int>::max())) return std::numeric_limits<Int>::max();
    if (rounded <= double(std::numeric_limits<Int>::min())) return std::numeric_limits<Int>::min();
    return Int(rounded);
}

float saturatedFloat(double value) {
    constexpr double kMax = std::numeric_limits<float>::max();
    if (!(value == value)) return 0;
    return value > kMax ? float(kMax) : value < -kMax ? -float(kMax) : float(value);
}

}  // namespace

const char* toString(SampleType type) {
    switch (type) {
        case SampleType::kFloat32: return "float32";
        case SampleType::kFloat64: return "float64";
        case SampleType::kInt32: return "int32";
        case SampleType::kInt64: return "int64";
        case SampleType::kBool: return "bool";
    }
    return "unknown";
}

double toDouble(SampleType type, ValueBits bits) {
    switch (type) {
        case SampleType::kFloat32: return std::bit_cast<float>(std::uint32_t(bits));
        case SampleType::kFloat64: return std::bit_cast<double>(bits);
        case SampleType::kInt32: return double(std::int32_t(std::uint32_t(bits)));
        case SampleType::kInt64: return double(std::int64_t(bits));
        case SampleType::kBool: return bits != 0 ? 1.0 : 0.0;
    }
    return 0;
}

float toFloat(SampleType type, ValueBits bits) {
    // An int64 goes straight to float: by way of double it would be rounded twice.
    if (type == SampleType::kInt64) return float(std::int64_t(bits));
    return saturatedFloat(toDouble(type, bits));
}

ValueBits fromDouble(SampleType type, double value) {
    switch (type) {
        case SampleType::kFloat32:
            // A finite value stays finite; infinity and NaN are what they were.
            return std::bit_cast<std::uint32_t>(std::isfinite(value) ? saturatedFloat(value) : float(value));
        case SampleType::kFloat64: return std::bit_cast<ValueBits>(value);
        case SampleType::kInt32: return std::uint32_t(saturatedInteger<std::int32_t>(value));
        case SampleType::kInt64: return std::uint64_t(saturatedInteger<std::int64_t>(value));
        case SampleType::kBool: return value != 0 ? 1 : 0;
    }
    return 0;
}

}  // namespace brickyard

// Stored samples as doubles, and back where a level is floating. Pure, any thread.
#pragma once

#include <cstring>
#include <span>
#include <vector>

#include "core/sample_type.h"

namespace brickyard {

template <class T>
void appendDoubles(std::span<const std::byte> bytes, std::vector<double>& out) {
    const std::size_t n = bytes.size() / sizeof(T);
    out.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
        T value;
        std::memcpy(&value, bytes.data() + i * sizeof(T), sizeof(T));
        out[i] = double(value);
    }
}

// `out` is replaced. int64 beyond 2^53 is rounded.
inline void samplesToDouble(SampleType type, std::span<const std::byte> bytes, std::vector<double>& out) {
    switch (type) {
        case SampleType::kFloat32: return appendDoubles<float>(bytes, out);
        case SampleType::kFloat64: return appendDoubles<double>(bytes, out);
        case SampleType::kInt32: return appendDoubles<std::int32_t>(bytes, out);
        case SampleType::kInt64: return appendDoubles<std::int64_t>(bytes, out);
        case SampleType::kBool: return appendDoubles<std::uint8_t>(bytes, out);
    }
}

// REQUIRES: type is kFloat32 or kFloat64.
inline std::vector<std::byte> doublesToSamples(SampleType type, std::span<const double> values) {
    std::vector<std::byte> bytes(values.size() * sampleBytes(type));
    if (type == SampleType::kFloat64) {
        std::memcpy(bytes.data(), values.data(), bytes.size());
    } else {
        for (std::size_t i = 0; i < values.size(); ++i) {
            const float value = float(values[i]);
            std::memcpy(bytes.data() + i * sizeof value, &value, sizeof value);
        }
    }
    return bytes;
}

}  // namespace brickyard

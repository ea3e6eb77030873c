// How the samples of a dense volume lie in a file, and how they become ours. Pure functions, any thread.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "core/result.h"
#include "core/sample_type.h"

namespace brickyard {

enum class ElementType : std::uint8_t {
    kUint8,
    kInt8,
    kUint16,
    kInt16,
    kUint32,
    kInt32,
    kUint64,
    kInt64,
    kFloat16,
    kFloat32,
    kFloat64
};

std::size_t elementBytes(ElementType type);
// "uint16".
const char* toString(ElementType type);
std::optional<ElementType> elementTypeFromName(std::string_view name);
// What an element becomes, without loss: integers int32, those that do not fit int64; halves float32.
SampleType sampleTypeOf(ElementType type);

struct DenseLayout {
    std::array<std::int64_t, 3> extents{1, 1, 1};  // samples along x, y, z; each in [1, 2^31)
    ElementType element = ElementType::kFloat32;
    bool big_endian = false;
    int components = 1;        // 1 or 3
    bool interleaved = true;   // a sample's components stand together; else whole volumes follow each other
    bool z_fastest = false;    // which axis varies fastest in the file. REQUIRES where true: one component
    std::uint64_t offset = 0;  // of the first sample

    // Bytes of all samples. Errors: kInvalid where an extent is not in its range or the product leaves 2^62.
    Result<std::uint64_t> bytes() const;
    std::string describe() const;  // "128x128x128 uint16"
};

// Converts `count` elements that begin at `from` and stand `stride` bytes apart to samples that stand
// together at `to`. False where one has no exact counterpart (an uint64 from 2^63 on).
using ConvertRow = bool (*)(const std::byte* from, std::size_t stride, std::size_t count, std::byte* to);
ConvertRow rowConverter(ElementType type, bool big_endian);

}  // namespace brickyard

// The values of one node of a .vdb tree (leaf or internal) as they are stored: a code that says what became
// of the inactive values, then the values themselves, perhaps only the active ones, perhaps as halves,
// perhaps compressed. The format is that of openvdb/io/Compression.h, file versions 222 to 224. Pure
// functions, any thread.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "core/sample_type.h"

namespace brickyard {

struct VdbValueType {
    SampleType component = SampleType::kFloat32;
    int components = 1;
    bool mask = false;  // a voxel's value is its state: leaves store no values
    std::size_t bytes() const { return sampleBytes(component) * std::size_t(components); }
    bool operator==(const VdbValueType&) const = default;
};

// By OpenVDB's word for it ("float", "vec3s"); nothing for those that are no channel.
std::optional<VdbValueType> findVdbValueType(std::string_view word);

inline constexpr std::size_t kMaxVdbValueBytes = 24;  // vec3d
using VdbValue = std::array<std::byte, kMaxVdbValueBytes>;

// What must be known to read the values of a grid's nodes.
struct VdbCoding {
    static constexpr std::uint32_t kZip = 1, kActiveMask = 2, kBlosc = 4;

    VdbValueType type;
    std::uint32_t compression = 0;
    bool half = false;  // floating values are stored as halves
    VdbValue background{}, minus_background{};

    // As stored and as restored: for bool the other one, else -background.
    void setBackground(std::span<const std::byte> value);
    std::size_t storedBytes() const {
        return half && isFloating(type.component) ? 2 * std::size_t(type.components) : type.bytes();
    }
};

// The most bytes that precede the stored values of a node of `slots` values.
constexpr std::size_t maxVdbValuesHead(std::size_t slots) {
    return 1 + 2 * kMaxVdbValueBytes + slots / 8 + 8;
}

// How many bytes the values of a node take that begins with `bytes`: at least maxVdbValuesHead(slots) of
// them, or all that there are. Errors: kCorrupt, without file and place.
Result<std::uint64_t> measureVdbValues(std::span<const std::byte> bytes, const VdbCoding& coding,
                                       std::size_t slots, std::size_t active);

// All values of a node, active and inactive, to `out` (one after the other, type.bytes() each). `mask` tells
// the active ones: its bits count the slots. REQUIRES: `bytes` are as measured. Errors: kCorrupt, without
// file and place.
Result<void> decodeVdbValues(std::span<const std::byte> bytes, const VdbCoding& coding,
                             std::span<const std::uint64_t> mask, std::byte* out,
                             std::vector<std::byte>& scratch);

}  // namespace brickyard

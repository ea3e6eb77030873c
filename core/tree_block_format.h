// What the raw bytes of a tree block are: docs/format.md, section "Tree block". Reading them: tree_block.cpp;
// writing: tree_block_encoder.cpp. Columns of numbers, each as byte planes (byte 0 of every number, then byte
// 1, ...), which is what zstd compresses best. None of the numbers below may change; a new layout takes a new
// version.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "core/byte_io.h"

namespace brickyard {

inline constexpr std::uint32_t kTreeBlockMagic = 0x42545942u;  // "BYTB"
inline constexpr std::uint8_t kTreeBlockVersion = 1;

// Fixed part at the start of the raw bytes.
struct TreeBlockHeader {
    std::uint32_t magic = kTreeBlockMagic;
    std::uint8_t version = kTreeBlockVersion;
    std::uint8_t components = 1;
    std::uint16_t zero = 0;
    std::uint32_t nodes = 0;
    std::uint32_t head_nodes = 0;
    std::uint32_t far_entries = 0;
    std::uint32_t constants = 0;  // values of `components` numbers each
    std::uint32_t grids = 0;
};
static_assert(sizeof(TreeBlockHeader) == 28);

// Bytes of a node over all columns: descriptor, flags, box, payload bytes, offset and checksum, four floats,
// constant, draft bytes and checksum, its two floats.
inline constexpr std::size_t kTreeBlockNodeBytes = 4 + 1 + 6 + 4 + 8 + 8 + 4 * 4 + 4 + 4 + 8 + 2 * 4;

inline constexpr std::uint8_t kNodeActive = 1;
inline constexpr std::uint8_t kNodeHasGrid = 2;

// Child descriptors, high to low: pointer:15 | far:1 | valid:8 | leaf:8.
inline constexpr unsigned kChildPointerShift = 17;
inline constexpr std::uint32_t kMaxChildPointer = (1u << 15) - 1;
inline constexpr std::uint32_t kFarFlag = 1u << 16;
inline constexpr std::uint32_t kFarIsBlock = 1u << 31;

template <class T>
void putColumn(const std::vector<T>& column, std::vector<std::byte>& out) {
    const std::size_t at = out.size();
    out.resize(at + column.size() * sizeof(T));
    for (std::size_t i = 0; i < column.size(); ++i) {
        std::byte number[sizeof(T)];
        std::memcpy(number, &column[i], sizeof(T));
        for (std::size_t j = 0; j < sizeof(T); ++j) out[at + j * column.size() + i] = number[j];
    }
}

// REQUIRES: the reader still has count * sizeof(T) bytes, which the caller has compared with the header's
// counts.
template <class T>
std::vector<T> getColumn(ByteReader& reader, std::size_t count) {
    std::vector<T> column(count);
    const auto planes = reader.take(count * sizeof(T));
    for (std::size_t i = 0; i < column.size(); ++i) {
        std::byte number[sizeof(T)];
        for (std::size_t j = 0; j < sizeof(T); ++j) number[j] = planes[j * count + i];
        std::memcpy(&column[i], number, sizeof(T));
    }
    return column;
}

}  // namespace brickyard

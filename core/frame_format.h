// The fixed parts of a frame file: 16 bytes of header at its start, 32 of trailer at its end. docs/format.md,
// section "Frame file". Everything here is part of the file format and may not change within a major version.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>

#include "core/dataset.h"

namespace brickyard::frame_format {

inline constexpr std::size_t kHeaderBytes = 16;
inline constexpr std::size_t kTrailerBytes = 32;
inline constexpr char kHeaderMagic[] = "BRKFRAME";
inline constexpr char kTrailerMagic[] = "BRKFOOT1";
// protobuf may take 30 times a message's bytes in memory, so a claim is bounded before it is believed.
inline constexpr std::size_t kMaxFooterBytes = 256u << 20;

// All numbers of the format are little-endian; so is every machine we build for.
static_assert(std::endian::native == std::endian::little);

template <class T>
void put(std::byte* at, T value) {
    std::memcpy(at, &value, sizeof value);
}
template <class T>
T get(const std::byte* at) {
    T value;
    std::memcpy(&value, at, sizeof value);
    return value;
}

// 0: magic "BRKFRAME"; 8: u16 major; 10: u16 minor; 12: u32 zero.
inline std::array<std::byte, kHeaderBytes> header() {
    std::array<std::byte, kHeaderBytes> bytes{};
    std::memcpy(bytes.data(), kHeaderMagic, 8);
    put(bytes.data() + 8, std::uint16_t(kFormatMajor));
    put(bytes.data() + 10, std::uint16_t(kFormatMinor));
    return bytes;
}

// 0: u64 footer offset; 8: u32 footer bytes; 12: u16 major; 14: u16 minor; 16: u64 XXH64 of the footer; 24:
// "BRKFOOT1".
struct Trailer {
    std::uint64_t footer_offset = 0;
    std::uint32_t footer_bytes = 0;
    std::uint32_t major = 0;
    std::uint32_t minor = 0;
    std::uint64_t footer_checksum = 0;
};

inline std::array<std::byte, kTrailerBytes> encodeTrailer(const Trailer& trailer) {
    std::array<std::byte, kTrailerBytes> bytes{};
    put(bytes.data(), trailer.footer_offset);
    put(bytes.data() + 8, trailer.footer_bytes);
    put(bytes.data() + 12, std::uint16_t(trailer.major));
    put(bytes.data() + 14, std::uint16_t(trailer.minor));
    put(bytes.data() + 16, trailer.footer_checksum);
    std::memcpy(bytes.data() + 24, kTrailerMagic, 8);
    return bytes;
}

// Nothing where the magic is missing. Offsets and lengths are as claimed, not yet checked.
inline std::optional<Trailer> decodeTrailer(std::span<const std::byte, kTrailerBytes> bytes) {
    if (std::memcmp(bytes.data() + 24, kTrailerMagic, 8) != 0) return std::nullopt;
    return Trailer{get<std::uint64_t>(bytes.data()), get<std::uint32_t>(bytes.data() + 8),
                   get<std::uint16_t>(bytes.data() + 12), get<std::uint16_t>(bytes.data() + 14),
                   get<std::uint64_t>(bytes.data() + 16)};
}

}  // namespace brickyard::frame_format

// A run of bytes as a payload keeps it: one repeated byte, the bytes themselves, or a zstd frame.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/payload_format.h"

namespace brickyard {

// Appends the cheapest form of `bytes` to `out` and gives its header entry. REQUIRES: bytes is not empty.
std::uint32_t appendStream(std::span<const std::byte> bytes, std::vector<std::byte>& out);

// The bytes of `stream`, `count` of them: in place where they are stored so, in `scratch` (at least `count`
// long) otherwise. nullptr where the stream does not hold exactly that many.
const std::byte* streamBytes(const PayloadStream& stream, std::size_t count, std::byte* scratch);

}  // namespace brickyard

// One zstd frame (RFC 8878) whose decompressed size the reader knows beforehand. Any thread; contexts are
// kept per thread.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace brickyard {

// Appends the frame that `bytes` compress to, at zstd level 1; its header tells their number. Gives the
// frame's size.
std::size_t appendZstdFrame(std::span<const std::byte> bytes, std::vector<std::byte>& out);

// Fills `out` exactly. False where `frame` is no frame of exactly that many bytes. Writes nothing beyond
// `out` and allocates nothing that depends on what `frame` says.
bool readZstdFrame(std::span<const std::byte> frame, std::span<std::byte> out);

}  // namespace brickyard

#include "core/payload_stream.h"

#include <cassert>
#include <cstring>

#include "core/zstd_frame.h"

namespace brickyard {

std::uint32_t appendStream(std::span<const std::byte> bytes, std::vector<std::byte>& out) {
    assert(!bytes.empty());
    const auto entry = [](StreamMode mode, std::size_t stored) {
        return std::uint32_t(mode) << kStreamModeShift | std::uint32_t(stored);
    };

    // All bytes equal: each equals its neighbour.
    if (std::memcmp(bytes.data(), bytes.data() + 1, bytes.size() - 1) == 0) {
        out.push_back(bytes[0]);
        return entry(StreamMode::kUniform, 1);
    }
    const std::size_t at = out.size();
    const std::size_t compressed = appendZstdFrame(bytes, out);
    if (compressed < bytes.size()) return entry(StreamMode::kZstd, compressed);
    // Mantissa noise does not compress; stored as it is, it also costs nothing to read.
    out.resize(at);
    out.insert(out.end(), bytes.begin(), bytes.end());
    return entry(StreamMode::kStored, bytes.size());
}

const std::byte* streamBytes(const PayloadStream& stream, std::size_t count, std::byte* scratch) {
    switch (stream.mode) {
        case StreamMode::kUniform: std::memset(scratch, int(stream.stored[0]), count); return scratch;
        case StreamMode::kStored: return stream.stored.size() == count ? stream.stored.data() : nullptr;
        case StreamMode::kZstd: return readZstdFrame(stream.stored, {scratch, count}) ? scratch : nullptr;
    }
    return nullptr;
}

}  // namespace brickyard

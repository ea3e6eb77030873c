#include "tools/importers/blosc_chunk.h"

#include <blosc.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <vector>

namespace brickyard {
namespace {

constexpr std::size_t kHeaderBytes = 16;
constexpr std::uint32_t kMaxBlock = 8u << 20;
constexpr std::size_t kCopyBytes = 1u << 20;
constexpr unsigned kMemcpyed = 2;  // flag: the bytes follow as they are

}  // namespace

Result<void> unpackBlosc(const ByteFile& file, std::uint64_t begin, std::uint64_t length, std::uint64_t bytes,
                         ByteFile& out, std::uint64_t at) {
    const auto corrupt = [&](const std::string& what) {
        return fail(ErrorCode::kCorrupt, fmt::format("{}: the Blosc data at byte {} {}; write the file again",
                                                     file.path().string(), begin, what));
    };
    std::array<std::byte, kHeaderBytes> header{};
    if (length < kHeaderBytes || begin > file.size() || length > file.size() - begin)
        return corrupt("are cut off");
    if (auto read = file.readAt(begin, header); !read) return read;
    // Version, version of the codec, flags, bytes of an element, then three sizes.
    const auto number = [&](std::size_t where) {
        std::uint32_t value = 0;
        std::memcpy(&value, header.data() + where, sizeof value);
        return value;
    };
    const std::uint32_t unpacked = number(4), block = number(8), packed = number(12);
    if (packed != length || unpacked != bytes)
        return corrupt(fmt::format("say {} bytes that unpack to {}, but {} and {} are meant", packed,
                                   unpacked, length, bytes));
    if (unpacked == 0) return {};

    if (std::to_integer<unsigned>(header[2]) & kMemcpyed) {
        if (length - kHeaderBytes != bytes) return corrupt("are not as long as they say");
        std::vector<std::byte> piece;
        for (std::uint64_t done = 0; done < bytes; done += piece.size()) {
            piece.resize(std::size_t(std::min<std::uint64_t>(kCopyBytes, bytes - done)));
            if (auto read = file.readAt(begin + kHeaderBytes + done, piece); !read) return read;
            if (auto written = out.writeAt(at + done, piece); !written) return written;
        }
        return {};
    }

    if (block == 0) return corrupt("say a block of 0 bytes");
    if (block > kMaxBlock)
        return fail(ErrorCode::kUnsupported,
                    fmt::format("{}: the Blosc data at byte {} have blocks of {} bytes, more than {}; "
                                "write the file with NanoVDB's own tools",
                                file.path().string(), begin, block, kMaxBlock));
    const std::uint32_t blocks = (unpacked - 1) / block + 1;
    const std::uint64_t data_at = kHeaderBytes + 4 * std::uint64_t(blocks);
    if (data_at > length) return corrupt("are cut off in their table");
    std::vector<std::uint32_t> starts(blocks);
    if (auto read = file.readAt(begin + kHeaderBytes, std::as_writable_bytes(std::span(starts))); !read)
        return read;
    // Blocks lie in any order; each ends where the next one in the file begins.
    std::vector<std::uint32_t> sorted = starts;
    std::ranges::sort(sorted);
    if (sorted.front() < data_at || sorted.back() >= packed) return corrupt("have a block outside of them");

    // Each block alone is a chunk of one block.
    std::vector<std::byte> chunk, result(block);
    for (std::uint32_t i = 0; i < blocks; ++i) {
        const auto next = std::ranges::upper_bound(sorted, starts[i]);
        const std::uint32_t end = next == sorted.end() ? packed : *next, size = end - starts[i];
        if (size > block + BLOSC_MAX_OVERHEAD + 1024)
            return corrupt(fmt::format("have a block {} that is larger than unpacked", i));
        const std::uint32_t meant = i + 1 < blocks ? block : unpacked - i * block;
        chunk.resize(kHeaderBytes + 4 + size);
        std::memcpy(chunk.data(), header.data(), 4);
        for (const auto& [where, value] : {std::pair(4u, meant),
                                           {8u, block},
                                           {12u, std::uint32_t(chunk.size())},
                                           {16u, std::uint32_t(kHeaderBytes + 4)}})
            std::memcpy(chunk.data() + where, &value, sizeof value);
        if (auto read = file.readAt(begin + starts[i], std::span(chunk).subspan(kHeaderBytes + 4)); !read)
            return read;
        const int got =
            ::blosc_decompress_ctx(chunk.data(), result.data(), result.size(), /*numinternalthreads=*/1);
        if (got < 0 || std::uint32_t(got) != meant)
            return corrupt(fmt::format("are damaged in block {} of {}", i + 1, blocks));
        if (auto written = out.writeAt(at + std::uint64_t(i) * block, std::span(result).first(meant));
            !written)
            return written;
    }
    return {};
}

}  // namespace brickyard

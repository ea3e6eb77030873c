// Blosc chunks unpacked block by block: Blosc itself wants a chunk and what becomes of it in memory, which
// for NanoVDB files is up to a gigabyte each. Format: c-blosc 1.21, README_CHUNK_FORMAT.rst.
#pragma once

#include <cstdint>

#include "core/result.h"
#include "tools/importers/byte_file.h"

namespace brickyard {

// The chunk of `length` bytes at `begin` of `file`, which unpacks to exactly `bytes`, appended to `out` at
// `at`. Holds a few times the size of a block, at most 32 MiB. Errors: kIo; kCorrupt, kUnsupported (larger
// blocks).
Result<void> unpackBlosc(const ByteFile& file, std::uint64_t begin, std::uint64_t length, std::uint64_t bytes,
                         ByteFile& out, std::uint64_t at);

}  // namespace brickyard

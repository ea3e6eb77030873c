// gzip and zlib streams, unpacked once so that they can be read at any position.
#pragma once

#include <cstdint>
#include <string>

#include "core/result.h"
#include "tools/importers/byte_file.h"

namespace brickyard {

// Whether two bytes of a file are how gzip begins.
bool isGzip(const ByteFile& file);

// The stream that begins at `begin` of `file`, as an unlinked temporary file of exactly `bytes` bytes; its
// path is the source's, for messages. Several gzip members that follow each other are one stream, as for
// gunzip. Holds less than 1 MiB. Errors: kIo; kCorrupt (also where the stream has more or fewer bytes: it is
// not unpacked further than `bytes`, and not at all where the compressed bytes cannot be that many).
Result<ByteFile> inflateGzip(const ByteFile& file, std::uint64_t begin, std::uint64_t bytes);

// The same for a zlib stream of `length` bytes, appended to `out` at `at`.
Result<void> inflateZlib(const ByteFile& file, std::uint64_t begin, std::uint64_t length, std::uint64_t bytes,
                         ByteFile& out, std::uint64_t at);

}  // namespace brickyard

// Bytes that do not fit in memory for a while: appended, read back by position, gone with the object. The
// first of them stay in memory, the rest lie in a file that has no name, so that not even a kill leaves it
// behind. Any thread may append and read.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <mutex>
#include <span>
#include <vector>

#include "core/result.h"

namespace brickyard {

class ScratchFile {
public:
    // Made in `folder` when memory no longer suffices; with an empty folder everything stays in memory.
    ScratchFile(std::filesystem::path folder, std::size_t memory_bytes);
    ~ScratchFile();
    ScratchFile(const ScratchFile&) = delete;
    ScratchFile& operator=(const ScratchFile&) = delete;

    // Gives the position. Errors: kIo (a full disk says so).
    Result<std::uint64_t> append(std::span<const std::byte> bytes);
    // REQUIRES: the bytes were appended. Errors: kIo.
    Result<void> read(std::uint64_t at, std::span<std::byte> out) const;

private:
    Result<void> flush();

    std::filesystem::path folder_;
    std::uint64_t memory_bytes_;
    mutable std::mutex mutex_;
    std::vector<std::unique_ptr<std::byte[]>> blocks_;  // the first memory_bytes_
    std::vector<std::byte> tail_;                       // the last of the file, not yet written
    std::uint64_t written_ = 0;                         // bytes in the file
    std::uint64_t size_ = 0;
    int descriptor_ = -1;
};

}  // namespace brickyard

// A file read at any position from any thread, and the unlinked temporary files that importers unpack into:
// gone with the last handle, whatever ends the process.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>

#include "core/result.h"

namespace brickyard {

class ByteFile {
public:
    // Errors: kNotFound, kIo, kInvalid (a folder, a pipe).
    static Result<ByteFile> open(const std::filesystem::path& file);
    // An empty file in $TMPDIR, else /var/tmp, for at most `bytes`; messages call it `source`, of which it is
    // a copy. Errors: kIo (also where the disk has no room for `bytes`, which is asked before anything is
    // written).
    static Result<ByteFile> temporary(const std::filesystem::path& source, std::uint64_t bytes);

    ByteFile(ByteFile&& other) noexcept;
    ByteFile& operator=(ByteFile&& other) noexcept;
    ~ByteFile();

    const std::filesystem::path& path() const { return path_; }
    // As it was when it was opened; of a temporary file, what was written so far.
    std::uint64_t size() const { return size_; }
    int descriptor() const { return descriptor_; }

    // Fills `out`. Errors: kIo; kCorrupt where the file ends before (it may have shrunk since it was opened).
    Result<void> readAt(std::uint64_t offset, std::span<std::byte> out) const;
    // REQUIRES: a temporary file; one thread.
    Result<void> writeAt(std::uint64_t offset, std::span<const std::byte> bytes);
    // Asks the operating system to have these bytes in its cache soon; returns at once.
    void willNeed(std::uint64_t offset, std::uint64_t bytes) const;

private:
    ByteFile(std::filesystem::path path, int descriptor, std::uint64_t size)
        : path_(std::move(path)), descriptor_(descriptor), size_(size) {}

    std::filesystem::path path_;
    int descriptor_ = -1;
    std::uint64_t size_ = 0;
};

}  // namespace brickyard

#include "core/scratch_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <cstring>
#include <limits>

#include "core/io_error.h"

namespace brickyard {
namespace {

constexpr std::size_t kBlockBytes = 1u << 20;

Result<int> openNameless(const std::filesystem::path& folder) {
    const int nameless = ::open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
    if (nameless >= 0) return nameless;
    // Not every file system knows such files. Between the two calls a kill leaves an empty file, which the
    // next writer of the dataset removes with other litter.
    std::string name = (folder / ".tmp-scratch-XXXXXX").string();
    const int named = ::mkostemp(name.data(), O_CLOEXEC);
    if (named < 0) return ioError("create a temporary file in", folder, errno);
    ::unlink(name.c_str());
    return named;
}

}  // namespace

ScratchFile::ScratchFile(std::filesystem::path folder, std::size_t memory_bytes)
    : folder_(std::move(folder)),
      memory_bytes_(folder_.empty() ? std::numeric_limits<std::uint64_t>::max()
                                    : memory_bytes / kBlockBytes * kBlockBytes) {}

ScratchFile::~ScratchFile() {
    if (descriptor_ >= 0) ::close(descriptor_);
}

Result<std::uint64_t> ScratchFile::append(std::span<const std::byte> bytes) {
    const std::lock_guard lock(mutex_);
    const std::uint64_t at = size_;
    while (!bytes.empty() && size_ < memory_bytes_) {
        const std::size_t offset = size_ % kBlockBytes;
        if (offset == 0) blocks_.push_back(std::make_unique_for_overwrite<std::byte[]>(kBlockBytes));
        const std::size_t count = std::min(bytes.size(), kBlockBytes - offset);
        std::memcpy(blocks_.back().get() + offset, bytes.data(), count);
        bytes = bytes.subspan(count);
        size_ += count;
    }
    if (bytes.empty()) return at;
    tail_.insert(tail_.end(), bytes.begin(), bytes.end());
    size_ += bytes.size();
    if (tail_.size() >= kBlockBytes)
        if (auto flushed = flush(); !flushed) return tl::unexpected(flushed.error());
    return at;
}

Result<void> ScratchFile::flush() {
    if (descriptor_ < 0) {
        const auto opened = openNameless(folder_);
        if (!opened) return tl::unexpected(opened.error());
        descriptor_ = *opened;
    }
    for (std::size_t done = 0; done < tail_.size();) {
        const ssize_t count =
            ::pwrite(descriptor_, tail_.data() + done, tail_.size() - done, off_t(written_));
        if (count < 0 && errno == EINTR) continue;
        if (count < 0) return ioError("write a temporary file in", folder_, errno);
        done += std::size_t(count);
        written_ += std::uint64_t(count);
    }
    tail_.clear();
    return {};
}

Result<void> ScratchFile::read(std::uint64_t at, std::span<std::byte> out) const {
    std::uint64_t file_at = 0;
    {
        const std::lock_guard lock(mutex_);
        assert(at + out.size() <= size_);
        while (!out.empty() && at < memory_bytes_) {
            const std::size_t offset = at % kBlockBytes;
            const std::size_t count = std::min(out.size(), kBlockBytes - offset);
            std::memcpy(out.data(), blocks_[at / kBlockBytes].get() + offset, count);
            out = out.subspan(count);
            at += count;
        }
        if (out.empty()) return {};
        file_at = at - memory_bytes_;
        // What is not written yet is at the end.
        if (file_at + out.size() > written_) {
            const std::uint64_t from = std::max(file_at, written_);
            const std::size_t count = std::size_t(file_at + out.size() - from);
            std::memcpy(out.data() + (out.size() - count), tail_.data() + (from - written_), count);
            out = out.first(out.size() - count);
        }
    }
    while (!out.empty()) {
        const ssize_t count = ::pread(descriptor_, out.data(), out.size(), off_t(file_at));
        if (count < 0 && errno == EINTR) continue;
        if (count <= 0) return ioError("read a temporary file in", folder_, count < 0 ? errno : EIO);
        out = out.subspan(std::size_t(count));
        file_at += std::uint64_t(count);
    }
    return {};
}

}  // namespace brickyard

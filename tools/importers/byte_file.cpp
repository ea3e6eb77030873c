#include "tools/importers/byte_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <utility>

#include "core/io_error.h"

namespace brickyard {

Result<ByteFile> ByteFile::open(const std::filesystem::path& file) {
    // Not to wait for the other end of a pipe.
    const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (descriptor < 0) return ioError("open", file, errno);
    ByteFile result(file, descriptor, 0);
    struct stat status{};
    if (::fstat(descriptor, &status) != 0) return ioError("open", file, errno);
    if (!S_ISREG(status.st_mode))
        return fail(ErrorCode::kInvalid, fmt::format("{}: not a file; give files to convert", file.string()));
    result.size_ = std::uint64_t(status.st_size);
    return result;
}

Result<ByteFile> ByteFile::temporary(const std::filesystem::path& source, std::uint64_t bytes) {
    const char* const folder = std::getenv("TMPDIR");
    std::string name = folder && *folder ? folder : "/var/tmp";
    const std::string where = name;
    struct statvfs disk{};
    // Half a gigabyte of unpacking is a long time to learn that the disk is full.
    if (::statvfs(where.c_str(), &disk) == 0 && disk.f_frsize > 0 &&
        bytes / disk.f_frsize >= std::uint64_t(disk.f_bavail))
        return fail(ErrorCode::kIo,
                    fmt::format("{}: unpacking it takes {} bytes, and {} has {} free; set TMPDIR to a folder "
                                "with more",
                                source.string(), bytes, where, disk.f_bavail * disk.f_frsize));
    name += "/brickyard-XXXXXX";
    const int descriptor = ::mkostemp(name.data(), O_CLOEXEC);
    if (descriptor < 0) return ioError("make a temporary file in", where, errno);
    ::unlink(name.c_str());
    return ByteFile(source, descriptor, 0);
}

ByteFile::ByteFile(ByteFile&& other) noexcept
    : path_(std::move(other.path_)),
      descriptor_(std::exchange(other.descriptor_, -1)),
      size_(std::exchange(other.size_, 0)) {}

ByteFile& ByteFile::operator=(ByteFile&& other) noexcept {
    std::swap(path_, other.path_);
    std::swap(descriptor_, other.descriptor_);
    std::swap(size_, other.size_);
    return *this;
}

ByteFile::~ByteFile() {
    if (descriptor_ >= 0) ::close(descriptor_);
}

Result<void> ByteFile::readAt(std::uint64_t offset, std::span<std::byte> out) const {
    for (std::size_t done = 0; done < out.size();) {
        const ssize_t got = ::pread(descriptor_, out.data() + done, out.size() - done, off_t(offset + done));
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return ioError("read", path_, errno);
        if (got == 0)
            return fail(
                ErrorCode::kCorrupt,
                fmt::format("{}: ends at byte {}, where bytes up to {} were expected; was it cut while "
                            "it was read? write it again",
                            path_.string(), offset + done, offset + out.size()));
        done += std::size_t(got);
    }
    return {};
}

Result<void> ByteFile::writeAt(std::uint64_t offset, std::span<const std::byte> bytes) {
    for (std::size_t done = 0; done < bytes.size();) {
        const ssize_t put =
            ::pwrite(descriptor_, bytes.data() + done, bytes.size() - done, off_t(offset + done));
        if (put < 0 && errno == EINTR) continue;
        if (put < 0) return ioError("unpack it into TMPDIR", path_, errno);
        done += std::size_t(put);
    }
    size_ = std::max(size_, offset + bytes.size());
    return {};
}

void ByteFile::willNeed(std::uint64_t offset, std::uint64_t bytes) const {
    ::posix_fadvise(descriptor_, off_t(offset), off_t(bytes), POSIX_FADV_WILLNEED);
}

}  // namespace brickyard

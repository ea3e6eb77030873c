#include "tools/importers/vdb_bytes.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <utility>

#include "core/io_error.h"

namespace brickyard {
Result<VdbBytes> VdbBytes::open(const std::filesystem::path& file) {
    struct stat status{};
    if (::stat(file.c_str(), &status) != 0) return ioError("open", file, errno);
    // Before it is opened: a pipe would block us there.
    if (!S_ISREG(status.st_mode))
        return fail(ErrorCode::kInvalid, fmt::format("{}: not a file; give .vdb files", file.string()));
    const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (descriptor < 0) return ioError("open", file, errno);
    VdbBytes bytes(descriptor, status, file.string());
    if (::fstat(descriptor, &bytes.status_) != 0) return ioError("open", file, errno);
    return bytes;
}

VdbBytes::VdbBytes(VdbBytes&& other) noexcept
    : file_(std::exchange(other.file_, -1)), status_(other.status_), path_(std::move(other.path_)) {}

VdbBytes::~VdbBytes() {
    if (file_ >= 0) ::close(file_);
}

tl::unexpected<Error> VdbBytes::changed() const {
    return fail(ErrorCode::kIo,
                fmt::format("{}: changed while it was being read; convert it when it is complete", path_));
}

Result<void> VdbBytes::readAt(std::uint64_t begin, std::span<std::byte> out) const {
    while (!out.empty()) {
        const ssize_t got = ::pread(file_, out.data(), out.size(), off_t(begin));
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return ioError("read", path_, errno);
        if (got == 0) return changed();  // it had these bytes when it was opened
        out = out.subspan(std::size_t(got));
        begin += std::uint64_t(got);
    }
    return {};
}

Result<void> VdbBytes::checkUnchanged() const {
    struct stat now{};
    if (::fstat(file_, &now) != 0) return ioError("read", path_, errno);
    if (now.st_size != status_.st_size || now.st_mtim.tv_sec != status_.st_mtim.tv_sec ||
        now.st_mtim.tv_nsec != status_.st_mtim.tv_nsec)
        return changed();
    return {};
}

bool VdbCursor::fill(std::size_t count) {
    const std::uint64_t buffer_end = buffer_at_ + buffered_;
    if (position_ + count <= buffer_end) return true;
    // What is buffered and still wanted moves to the front; the rest is read behind it.
    const std::size_t kept = position_ < buffer_end ? std::size_t(buffer_end - position_) : 0;
    const std::size_t wanted = std::size_t(std::min<std::uint64_t>(left(), std::max(count, piece_bytes_)));
    if (buffer_.size() < wanted) buffer_.resize(wanted);
    if (kept > 0) std::memmove(buffer_.data(), buffer_.data() + (position_ - buffer_at_), kept);
    buffer_at_ = position_;
    buffered_ = kept;
    if (auto read = file_->readAt(position_ + kept, std::span(buffer_).subspan(kept, wanted - kept)); !read) {
        error_ = read.error();
        ok_ = false;
        buffered_ = 0;
        return false;
    }
    buffered_ = wanted;
    return true;
}

std::span<const std::byte> VdbCursor::peek(std::size_t count) {
    count = std::size_t(std::min<std::uint64_t>(count, left()));
    if (!ok_ || !fill(count)) return {};
    return {buffer_.data() + (position_ - buffer_at_), count};
}

std::span<const std::byte> VdbCursor::take(std::size_t count) {
    if (count > left()) ok_ = false;
    if (!ok_ || !fill(count)) return {};
    const std::span<const std::byte> taken(buffer_.data() + (position_ - buffer_at_), count);
    position_ += count;
    return taken;
}

void VdbCursor::skip(std::uint64_t count) {
    if (count > left()) ok_ = false;
    if (!ok_) return;
    position_ += count;
    if (position_ > buffer_at_ + buffered_) {
        buffer_at_ = position_;
        buffered_ = 0;
    }
}

std::string VdbCursor::string(std::uint32_t most) {
    const auto length = number<std::uint32_t>();
    if (length > most) ok_ = false;
    const auto bytes = take(ok_ ? length : 0);
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

}  // namespace brickyard

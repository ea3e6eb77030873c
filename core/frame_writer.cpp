#include "core/frame_writer.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cassert>
#include <cerrno>

#include "core/brick_store.h"
#include "core/frame_format.h"
#include "core/io_error.h"

namespace brickyard {
namespace {

// Bricks are a few kilobytes: one system call for many of them.
constexpr std::size_t kBufferBytes = 1u << 20;

}  // namespace

Result<std::unique_ptr<FrameWriter>> FrameWriter::create(const std::filesystem::path& file) {
    std::unique_ptr<FrameWriter> writer(new FrameWriter);
    writer->path_ = file;
    writer->descriptor_ = ::open(file.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    if (writer->descriptor_ < 0) return ioError("create", file, errno);
    writer->buffer_.reserve(kBufferBytes);
    if (auto header = writer->append(frame_format::header()); !header) return tl::unexpected(header.error());
    return writer;
}

FrameWriter::~FrameWriter() {
    if (descriptor_ >= 0) ::close(descriptor_);
}

Result<StoredBytes> FrameWriter::append(std::span<const std::byte> bytes) {
    assert(descriptor_ >= 0 && bytes.size() <= UINT32_MAX);
    const StoredBytes stored{position_, std::uint32_t(bytes.size()), checksum(bytes)};
    buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
    position_ += bytes.size();
    if (buffer_.size() >= kBufferBytes)
        if (auto flushed = flush(); !flushed) return tl::unexpected(flushed.error());
    return stored;
}

Result<void> FrameWriter::flush() {
    const std::byte* next = buffer_.data();
    std::size_t left = buffer_.size();
    while (left > 0) {
        const ssize_t written = ::write(descriptor_, next, left);
        if (written < 0 && errno == EINTR) continue;
        if (written < 0) return ioError("write", path_, errno);
        next += written;
        left -= std::size_t(written);
    }
    buffer_.clear();
    return {};
}

Result<FrameWriter::Finished> FrameWriter::finish(const FrameFooter& footer) {
    std::string serialized;
    if (!footer.SerializeToString(&serialized) || serialized.size() > frame_format::kMaxFooterBytes)
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: the frame's index has {} bytes, more than the {} allowed; "
                                "use a larger --brick",
                                path_.string(), serialized.size(), frame_format::kMaxFooterBytes));

    const std::uint64_t footer_offset = position_;
    auto stored = append(std::as_bytes(std::span(serialized)));
    if (!stored) return tl::unexpected(stored.error());
    const auto trailer = frame_format::encodeTrailer(
        {footer_offset, stored->bytes, kFormatMajor, kFormatMinor, stored->checksum});
    if (auto end = append(trailer); !end) return tl::unexpected(end.error());
    if (auto flushed = flush(); !flushed) return tl::unexpected(flushed.error());

    // A rename may only follow when the bytes are on the disk: some file systems reorder the two.
    if (::fsync(descriptor_) != 0) return ioError("sync", path_, errno);
    const int closed = ::close(descriptor_);
    descriptor_ = -1;
    if (closed != 0) return ioError("close", path_, errno);
    return Finished{position_, stored->checksum};
}

}  // namespace brickyard

#include "tools/importers/inflate.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <memory>

namespace brickyard {
namespace {

constexpr std::size_t kInputBytes = 128u << 10, kOutputBytes = 512u << 10;
// Deflate cannot pack a byte tighter than this.
constexpr std::uint64_t kMaxRatio = 1032;

class Inflater {
public:
    Inflater(const ByteFile& file, std::uint64_t begin, std::uint64_t end, int window_bits)
        : file_(file), begin_(begin), position_(begin), end_(end) {
        ready_ = ::inflateInit2(&stream_, window_bits) == Z_OK;
    }
    ~Inflater() { ::inflateEnd(&stream_); }
    Inflater(const Inflater&) = delete;
    Inflater& operator=(const Inflater&) = delete;

    Result<void> into(ByteFile& out, std::uint64_t at, std::uint64_t bytes, bool many_members) {
        if (!ready_) return corrupt("cannot be unpacked");
        if (bytes / kMaxRatio > end_ - begin_)
            return corrupt(fmt::format("{} compressed bytes cannot hold the {} that its layout says",
                                       end_ - begin_, bytes));
        std::uint64_t done = 0;
        for (bool ended = false;;) {
            if (stream_.avail_in == 0) {
                const std::size_t next = std::size_t(std::min<std::uint64_t>(kInputBytes, end_ - position_));
                if (next == 0) {
                    if (ended) break;
                    return corrupt(
                        fmt::format("its compressed data end early, after {} of {} bytes", done, bytes));
                }
                if (auto read = file_.readAt(position_, std::span(input_.get(), next)); !read) return read;
                position_ += next;
                stream_.next_in = reinterpret_cast<Bytef*>(input_.get());
                stream_.avail_in = uInt(next);
            }
            if (ended) {
                // What follows the last member (padding of a tape, a signature) is not ours, as for gunzip.
                if (!many_members || *stream_.next_in != 0x1f) break;
                if (::inflateReset(&stream_) != Z_OK) return corrupt("cannot be unpacked");
                ended = false;
            }
            stream_.next_out = reinterpret_cast<Bytef*>(output_.get());
            stream_.avail_out = uInt(kOutputBytes);
            const int status = ::inflate(&stream_, Z_NO_FLUSH);
            if (status != Z_OK && status != Z_STREAM_END && status != Z_BUF_ERROR)
                return corrupt(fmt::format("its compressed data are damaged after {} bytes", done));
            const std::size_t got = kOutputBytes - stream_.avail_out;
            if (got > bytes - done)
                return corrupt(fmt::format("unpacks to more than the {} bytes that its layout says", bytes));
            if (auto written = out.writeAt(at + done, std::span(output_.get(), got)); !written)
                return written;
            done += got;
            ended = status == Z_STREAM_END;
        }
        if (done != bytes)
            return corrupt(fmt::format("unpacks to {} bytes, but its layout says {}", done, bytes));
        return {};
    }

private:
    tl::unexpected<Error> corrupt(const std::string& what) const {
        return fail(ErrorCode::kCorrupt, fmt::format("{}: {}; check the layout, or write the file again",
                                                     file_.path().string(), what));
    }

    const ByteFile& file_;
    std::uint64_t begin_, position_, end_;
    bool ready_ = false;
    z_stream stream_{};
    std::unique_ptr<std::byte[]> input_ = std::make_unique<std::byte[]>(kInputBytes);
    std::unique_ptr<std::byte[]> output_ = std::make_unique<std::byte[]>(kOutputBytes);
};

}  // namespace

bool isGzip(const ByteFile& file) {
    std::array<std::byte, 3> magic{};
    return file.size() >= 18 && file.readAt(0, magic) && magic[0] == std::byte(0x1f) &&
           magic[1] == std::byte(0x8b) && magic[2] == std::byte(8);
}

Result<ByteFile> inflateGzip(const ByteFile& file, std::uint64_t begin, std::uint64_t bytes) {
    if (begin > file.size() || bytes / kMaxRatio > file.size() - begin)
        return fail(
            ErrorCode::kCorrupt,
            fmt::format("{}: {} compressed bytes cannot hold the {} that its layout says; check the layout",
                        file.path().string(), file.size() - std::min(begin, file.size()), bytes));
    auto out = ByteFile::temporary(file.path(), bytes);
    if (!out) return tl::unexpected(out.error());
    Inflater inflater(file, begin, file.size(), 15 + 16);
    if (auto done = inflater.into(*out, 0, bytes, /*many_members=*/true); !done)
        return tl::unexpected(done.error());
    return out;
}

Result<void> inflateZlib(const ByteFile& file, std::uint64_t begin, std::uint64_t length, std::uint64_t bytes,
                         ByteFile& out, std::uint64_t at) {
    Inflater inflater(file, begin, begin + length, 15);
    return inflater.into(out, at, bytes, /*many_members=*/false);
}

}  // namespace brickyard

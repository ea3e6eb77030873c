#include "core/brick_store.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>
#include <xxhash.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <cmath>

#include "core/affine.h"
#include "core/brick_codec.h"
#include "core/brick_shape.h"
#include "core/frame_format.h"
#include "core/io_error.h"
#include "core/printable_name.h"

namespace brickyard {
namespace {

// One read of this much shows the footer of most frames.
constexpr std::uint64_t kTailBytes = 64u << 10;
constexpr int kMaxChannels = 65535;
constexpr int kMaxRoots = 8;

std::string inFile(const std::filesystem::path& path, const std::string& what) {
    return fmt::format("{}: {}; convert this frame again", path.string(), what);
}

// What is wrong with a channel's entry, or an empty string. Everything that readers index or allocate by is
// checked here, once: they may trust the footer of an open store.
std::string channelFault(const ChannelFooter& channel, std::uint64_t blocks_end, std::uint32_t brick_edge) {
    if (channel.sample_type() < SAMPLE_TYPE_FLOAT32 || channel.sample_type() > SAMPLE_TYPE_BOOL)
        return fmt::format("unknown sample type {}", int(channel.sample_type()));
    if (channel.components() != 1 && channel.components() != 3)
        return fmt::format("{} components, not 1 or 3", channel.components());
    if (channel.background_size() != int(channel.components()))
        return fmt::format("{} background values for {} components", channel.background_size(),
                           channel.components());
    if (auto map = Affine::fromColumns(
            {channel.index_to_world().data(), std::size_t(channel.index_to_world_size())});
        !map)
        return fmt::format("its transform is unusable ({})", map.error().message);

    const int corners = channel.active_min_size();
    if ((corners != 0 && corners != 3) || channel.active_max_size() != corners)
        return "its active box is malformed";
    for (int axis = 0; axis < corners; ++axis)
        if (channel.active_min(axis) > channel.active_max(axis)) return "its active box is inside out";
    if (!(channel.error_bound() >= 0) || !(channel.error_made() >= 0))
        return "its errors are not numbers from 0 up";

    if (channel.levels() > std::uint32_t(kMaxLevel) + 1) return fmt::format("{} levels", channel.levels());
    if (channel.roots_size() > kMaxRoots)
        return fmt::format("{} roots, more than {}", channel.roots_size(), kMaxRoots);
    if ((channel.roots_size() == 0) != (channel.levels() == 0) ||
        (channel.roots_size() == 0) != channel.blocks().empty())
        return "its levels, roots and blocks contradict each other";
    for (const RootNode& root : channel.roots()) {
        if (root.level() + 1 != channel.levels()) return "a root is not on the top level";
        // Doubles hold these products exactly; twice int32's range leaves room for a border of cells.
        const double edge = std::ldexp(double(brick_edge), int(root.level()));
        for (const double at : {double(root.x()), double(root.y()), double(root.z())})
            if (at * edge < -0x1p32 || at * edge > 0x1p32) return "a root lies outside the lattice";
    }
    for (int i = 0; i < channel.blocks_size(); ++i) {
        const BlockRef& block = channel.blocks(i);
        // `offset > end` comes first, so that `end - offset` cannot wrap.
        if (block.offset() < frame_format::kHeaderBytes || block.offset() > blocks_end ||
            block.bytes() > blocks_end - block.offset() || block.bytes() == 0)
            return fmt::format("tree block {} claims bytes [{}, {} + {}) of {}", i, block.offset(),
                               block.offset(), block.bytes(), blocks_end);
        if (block.raw_bytes() > kMaxBlockRawBytes)
            return fmt::format("tree block {} claims {} bytes, more than {}", i, block.raw_bytes(),
                               kMaxBlockRawBytes);
    }
    return {};
}

std::string footerFault(const FrameFooter& footer, std::uint64_t footer_offset) {
    if (!isBrickEdge(footer.brick_edge())) return fmt::format("a brick edge of {}", footer.brick_edge());
    if (footer.coarse_begin() < frame_format::kHeaderBytes || footer.coarse_begin() > footer_offset)
        return fmt::format("coarse levels at byte {} of {}", footer.coarse_begin(), footer_offset);
    if (footer.channels_size() > kMaxChannels) return fmt::format("{} channels", footer.channels_size());
    std::vector<std::string> names;
    for (const ChannelFooter& channel : footer.channels()) {
        if (auto fault = channelFault(channel, footer_offset, footer.brick_edge()); !fault.empty())
            return fmt::format("channel '{}': {}", printableName(channel.name()), fault);
        names.push_back(channel.name());
    }
    std::sort(names.begin(), names.end());
    if (const auto twin = std::adjacent_find(names.begin(), names.end()); twin != names.end())
        return fmt::format("two channels are named '{}'", printableName(*twin));
    return {};
}

}  // namespace

std::uint64_t checksum(std::span<const std::byte> bytes) {
    return XXH64(bytes.data(), bytes.size(), /*seed=*/0);
}

Result<std::shared_ptr<const BrickStore>> BrickStore::open(const std::filesystem::path& file) {
    const std::shared_ptr<BrickStore> store(new BrickStore);
    store->path_ = file;
    store->descriptor_ = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
    if (store->descriptor_ < 0) return ioError("open", file, errno);
    struct stat status = {};
    if (::fstat(store->descriptor_, &status) != 0) return ioError("stat", file, errno);
    if (!S_ISREG(status.st_mode)) return fail(ErrorCode::kCorrupt, inFile(file, "not a regular file"));
    store->file_bytes_ = std::uint64_t(status.st_size);
    if (store->file_bytes_ < frame_format::kHeaderBytes + frame_format::kTrailerBytes)
        return fail(ErrorCode::kCorrupt,
                    inFile(file, fmt::format("{} bytes are no frame file", store->file_bytes_)));

    // The tail ends with the trailer, which says where the footer lies.
    std::vector<std::byte> tail(std::min(store->file_bytes_, kTailBytes));
    const std::uint64_t tail_offset = store->file_bytes_ - tail.size();
    if (auto read = store->readAt(tail_offset, tail.data(), tail.size()); !read)
        return tl::unexpected(read.error());
    const auto trailer = frame_format::decodeTrailer(std::span(tail).last<frame_format::kTrailerBytes>());
    if (!trailer)
        return fail(ErrorCode::kCorrupt, inFile(file, "the last 8 bytes (trailer) are not BRKFOOT1"));
    if (trailer->major > kFormatMajor)
        return fail(
            ErrorCode::kTooNew,
            fmt::format("{}: format version {}.{} is newer than this program's {}.{}; update the program",
                        file.string(), trailer->major, trailer->minor, kFormatMajor, kFormatMinor));
    if (trailer->major == 0)
        return fail(ErrorCode::kCorrupt, inFile(file, "the trailer says format version 0"));

    // The footer fills the space up to the trailer exactly, so neither number can be wrong alone.
    const std::uint64_t footer_end = store->file_bytes_ - frame_format::kTrailerBytes;
    if (trailer->footer_offset < frame_format::kHeaderBytes || trailer->footer_offset > footer_end ||
        footer_end - trailer->footer_offset != trailer->footer_bytes)
        return fail(
            ErrorCode::kCorrupt,
            inFile(file, fmt::format("the trailer puts a footer of {} bytes at byte {} of {}",
                                     trailer->footer_bytes, trailer->footer_offset, store->file_bytes_)));
    if (trailer->footer_bytes > frame_format::kMaxFooterBytes)
        return fail(ErrorCode::kCorrupt,
                    inFile(file, fmt::format("a footer of {} bytes", trailer->footer_bytes)));

    std::vector<std::byte> footer(trailer->footer_bytes);
    if (trailer->footer_offset >= tail_offset) {
        std::copy_n(tail.begin() + std::ptrdiff_t(trailer->footer_offset - tail_offset), footer.size(),
                    footer.begin());
    } else if (auto read = store->readAt(trailer->footer_offset, footer.data(), footer.size()); !read) {
        return tl::unexpected(read.error());
    }
    store->footer_checksum_ = checksum(footer);
    if (store->footer_checksum_ != trailer->footer_checksum)
        return fail(ErrorCode::kCorrupt,
                    inFile(file, fmt::format("the footer, bytes [{}, {}), fails its checksum",
                                             trailer->footer_offset, footer_end)));
    if (!store->footer_.ParseFromArray(footer.data(), int(footer.size())))
        return fail(ErrorCode::kCorrupt, inFile(file, "the footer is not a FrameFooter"));
    if (auto fault = footerFault(store->footer_, trailer->footer_offset); !fault.empty())
        return fail(ErrorCode::kCorrupt, inFile(file, "the footer has " + fault));
    return store;
}

BrickStore::~BrickStore() {
    if (descriptor_ >= 0) ::close(descriptor_);
}

Result<void> BrickStore::readAt(std::uint64_t offset, std::byte* out, std::size_t bytes,
                                ReadMode mode) const {
    assert(offset <= file_bytes_ && bytes <= file_bytes_ - offset);
    while (bytes > 0) {
        ssize_t got = 0;
        if (mode == ReadMode::kCachedOnly) {
            const iovec piece{out, bytes};
            got = ::preadv2(descriptor_, &piece, 1, off_t(offset), RWF_NOWAIT);
            // A file system that cannot tell may always wait.
            if (got < 0 && (errno == EAGAIN || errno == EOPNOTSUPP || errno == ENOSYS))
                return fail(ErrorCode::kWouldBlock, {});
        } else {
            got = ::pread(descriptor_, out, bytes, off_t(offset));
        }
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return ioError("read", path_, errno);
        // The file shrank since it was opened.
        if (got == 0) return fail(ErrorCode::kCorrupt, inFile(path_, fmt::format("ends at byte {}", offset)));
        out += got;
        offset += std::uint64_t(got);
        bytes -= std::size_t(got);
    }
    return {};
}

Result<std::vector<std::byte>> BrickStore::readBlock(std::uint32_t channel, std::uint32_t block) const {
    if (channel >= std::uint32_t(footer_.channels_size()) ||
        block >= std::uint32_t(footer_.channels(int(channel)).blocks_size()))
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: has no tree block {} of channel {}", path_.string(), block, channel));
    const BlockRef& ref = footer_.channels(int(channel)).blocks(int(block));
    std::vector<std::byte> stored(ref.bytes());
    if (auto read = readAt(ref.offset(), stored.data(), stored.size()); !read)
        return tl::unexpected(read.error());
    if (checksum(stored) != ref.xxh64())
        return fail(
            ErrorCode::kCorrupt,
            inFile(path_, fmt::format("channel '{}', tree block {}, bytes [{}, {}), fails its checksum",
                                      printableName(footer_.channels(int(channel)).name()), block,
                                      ref.offset(), ref.offset() + ref.bytes())));
    return stored;
}

Result<TreeBlock> BrickStore::loadBlock(std::uint32_t channel, std::uint32_t block) const {
    auto stored = readBlock(channel, block);
    if (!stored) return tl::unexpected(stored.error());
    const ChannelFooter& footer = footer_.channels(int(channel));
    const BlockRef& ref = footer.blocks(int(block));
    auto decoded = decodeStoredBlock(*stored, ref.raw_bytes(), block, std::uint32_t(footer.blocks_size()),
                                     file_bytes_, int(footer.components()));
    if (!decoded)
        return fail(decoded.error().code,
                    inFile(path_, fmt::format("channel '{}', tree block {}, bytes [{}, {}): {}",
                                              printableName(footer.name()), block, ref.offset(),
                                              ref.offset() + ref.bytes(), decoded.error().message)));
    return decoded;
}

Result<void> BrickStore::readBlockInto(std::uint32_t channel, std::uint32_t block, std::span<std::byte> out,
                                       ReadMode mode) const {
    const BlockRef& ref = footer_.channels(int(channel)).blocks(int(block));
    assert(out.size() == ref.bytes());
    return readAt(ref.offset(), out.data(), out.size(), mode);
}

Result<void> BrickStore::checkPayloadRange(const NodeRecord& record) const {
    // The record came from disk: believe no length before it is compared with the file's.
    if (record.payload_offset > file_bytes_ || record.payload_bytes > file_bytes_ - record.payload_offset ||
        record.payload_bytes > kMaxPayloadBytes)
        return fail(ErrorCode::kCorrupt,
                    inFile(path_, fmt::format("a brick claims {} bytes at byte {} of {}",
                                              record.payload_bytes, record.payload_offset, file_bytes_)));
    return {};
}

Result<void> BrickStore::readPayloadInto(const NodeRecord& record, std::span<std::byte> out,
                                         ReadMode mode) const {
    assert(out.size() <= record.payload_bytes);
    if (auto sound = checkPayloadRange(record); !sound) return sound;
    return readAt(record.payload_offset, out.data(), out.size(), mode);
}

Result<std::vector<std::byte>> BrickStore::readPayloadUnchecked(const NodeRecord& record) const {
    if (auto sound = checkPayloadRange(record); !sound) return tl::unexpected(sound.error());
    std::vector<std::byte> payload(record.payload_bytes);
    if (auto read = readAt(record.payload_offset, payload.data(), payload.size()); !read)
        return tl::unexpected(read.error());
    return payload;
}

Result<std::vector<std::byte>> BrickStore::readPayload(const NodeRecord& record,
                                                       const std::string& where) const {
    assert(record.hasBrick());
    auto payload = readPayloadUnchecked(record);
    if (!payload) return payload;
    if (checksum(*payload) != record.payload_checksum)
        return fail(
            ErrorCode::kCorrupt,
            inFile(path_, fmt::format("{}, bytes [{}, {}), fails its checksum", where, record.payload_offset,
                                      record.payload_offset + record.payload_bytes)));
    return payload;
}

}  // namespace brickyard

#include "tools/raw_export.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <limits>

#include "core/io_error.h"
#include "core/printable_name.h"
#include "tools/field_walk.h"
#include "tools/output_file.h"

namespace brickyard {
namespace {

// Values of a piece: a few bricks deep, so that each brick is decoded about once.
constexpr std::int64_t kPieceVoxels = 1 << 22;

// How a value of the walked type becomes one of the dump's.
struct RawType {
    std::string name;
    std::size_t bytes = 0;
    std::int64_t lowest = 0, highest = 0;  // where it is narrower than the walked type; else both 0
};

template <class T>
RawType narrow(const std::string& name) {
    return {name, sizeof(T), std::int64_t(std::numeric_limits<T>::lowest()),
            std::int64_t(std::numeric_limits<T>::max())};
}

RawType rawType(const ChannelFooter& channel, int level) {
    const SampleType walked = walkedType(SampleType(int(channel.sample_type())), level);
    if (walked == SampleType::kBool) return {"uint8", 1};
    if (level == 0 && !isFloating(walked)) {
        const std::string& source = channel.source_type();
        if (source == "uint8") return narrow<std::uint8_t>(source);
        if (source == "int8") return narrow<std::int8_t>(source);
        if (source == "uint16") return narrow<std::uint16_t>(source);
        if (source == "int16") return narrow<std::int16_t>(source);
        if (source == "uint32" && walked == SampleType::kInt64) return narrow<std::uint32_t>(source);
    }
    return {toString(walked), sampleBytes(walked)};
}

Result<void> writeAt(int descriptor, const std::filesystem::path& file, std::span<const std::byte> bytes,
                     std::uint64_t offset) {
    while (!bytes.empty()) {
        const ssize_t written = ::pwrite(descriptor, bytes.data(), bytes.size(), off_t(offset));
        if (written < 0 && errno == EINTR) continue;
        if (written < 0) return ioError("write", file, errno);
        bytes = bytes.subspan(std::size_t(written));
        offset += std::uint64_t(written);
    }
    return {};
}

class RawWriter {
public:
    RawWriter(const std::filesystem::path& file, int descriptor, const FieldReader& reader, int level,
              const IndexBox& box)
        : file_(file),
          descriptor_(descriptor),
          reader_(reader),
          level_(level),
          box_(box),
          type_(rawType(reader.channel(), level)),
          walked_(walkedType(reader.type(), level)),
          components_(std::size_t(reader.components())) {}

    Result<void> write() {
        const std::int64_t edge = reader_.shape().edge_cells;
        const std::int64_t nx = std::clamp(kPieceVoxels / (edge * edge) / edge * edge, edge, wide(0, edge));
        const std::int64_t ny = std::clamp(kPieceVoxels / (nx * edge) / edge * edge, edge, wide(1, edge));
        const std::int64_t nz = std::clamp(kPieceVoxels / (nx * ny) / edge * edge, edge, wide(2, edge));
        // Pieces begin where bricks do.
        const auto down = [](std::int64_t at, std::int64_t step) {
            return at / step * step - (at % step < 0 ? step : 0);
        };
        for (std::int64_t z = down(box_.begin[2], edge); z < box_.end[2]; z += nz)
            for (std::int64_t y = down(box_.begin[1], edge); y < box_.end[1]; y += ny)
                for (std::int64_t x = down(box_.begin[0], edge); x < box_.end[0]; x += nx)
                    if (auto written = writePiece(intersect(box_, {{x, y, z}, {x + nx, y + ny, z + nz}}));
                        !written)
                        return written;
        return {};
    }

private:
    std::int64_t wide(int axis, std::int64_t edge) const { return (box_.extent(axis) / edge + 2) * edge; }

    Result<void> writePiece(const IndexBox& piece) {
        if (auto read = readLevel(reader_, level_, piece, block_); !read) return read;
        const std::size_t count = block_.active.size();
        raw_.resize(count * components_ * type_.bytes);
        for (std::size_t c = 0; c < components_; ++c)
            for (std::size_t i = 0; i < count; ++i) {
                const ValueBits bits = sampleBits(walked_, block_.values, c * count + i);
                if (type_.lowest != type_.highest)
                    if (const auto value = std::int64_t(toDouble(walked_, bits));
                        value < type_.lowest || value > type_.highest)
                        return fail(ErrorCode::kInvalid,
                                    fmt::format("{}: channel '{}' has a value {} that the source's {} cannot "
                                                "hold; export it as .vdb",
                                                file_.string(), printableName(reader_.channel().name()),
                                                value, type_.name));
                // The low bytes of an integer of two's complement are the narrower integer.
                std::memcpy(raw_.data() + (i * components_ + c) * type_.bytes, &bits, type_.bytes);
            }
        const std::size_t voxel = components_ * type_.bytes, row = std::size_t(piece.extent(0)) * voxel;
        std::size_t from = 0;
        for (std::int64_t z = piece.begin[2]; z < piece.end[2]; ++z)
            for (std::int64_t y = piece.begin[1]; y < piece.end[1]; ++y, from += row) {
                const std::uint64_t to = (std::uint64_t(z - box_.begin[2]) * std::uint64_t(box_.extent(1)) +
                                          std::uint64_t(y - box_.begin[1])) *
                                             std::uint64_t(box_.extent(0)) +
                                         std::uint64_t(piece.begin[0] - box_.begin[0]);
                if (auto written =
                        writeAt(descriptor_, file_, std::span(raw_).subspan(from, row), to * voxel);
                    !written)
                    return written;
            }
        return {};
    }

    const std::filesystem::path& file_;
    int descriptor_;
    const FieldReader& reader_;
    int level_;
    IndexBox box_;
    RawType type_;
    SampleType walked_;
    std::size_t components_;
    SampleBlock block_;
    std::vector<std::byte> raw_;
};

}  // namespace

std::string rawTypeName(const ChannelFooter& channel, int level) { return rawType(channel, level).name; }

Result<void> writeRaw(const std::filesystem::path& file, const FieldReader& reader, int level,
                      const IndexBox& box) {
    const double bytes = double(rawType(reader.channel(), level).bytes) * reader.components() *
                         double(box.extent(0)) * double(box.extent(1)) * double(box.extent(2));
    const std::filesystem::path folder = file.has_parent_path() ? file.parent_path() : ".";
    struct statvfs space{};
    if (::statvfs(folder.c_str(), &space) == 0 && bytes > double(space.f_bavail) * double(space.f_frsize))
        return fail(ErrorCode::kIo,
                    fmt::format("{}: {}x{}x{} voxels take {:.3g} bytes, more than the disk has "
                                "left; export a --box, or a .vdb",
                                file.string(), box.extent(0), box.extent(1), box.extent(2), bytes));
    OutputFile output(file);
    const int descriptor = ::open(output.temporary().c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    if (descriptor < 0) return ioError("create", file, errno);
    Result<void> written = RawWriter(file, descriptor, reader, level, box).write();
    if (::close(descriptor) != 0 && written) written = ioError("write", file, errno);
    return written ? output.commit() : written;
}

}  // namespace brickyard

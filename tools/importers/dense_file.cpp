#include "tools/importers/dense_file.h"

#include <algorithm>
#include <cstring>
#include <vector>

namespace brickyard {
namespace {

// x is fastest: whole planes of rows stand together wherever a slab has all of x.
class RowsFile final : public DenseFile {
public:
    RowsFile(ByteFile file, const DenseLayout& layout)
        : file_(std::move(file)),
          layout_(layout),
          sample_bytes_(elementBytes(layout.element) *
                        std::size_t(layout.interleaved ? layout.components : 1)),
          volumes_(layout.interleaved ? 1 : layout.components) {}

    // A piece is one plane of one volume.
    std::size_t pieceCount(const IndexBox& slab) const override {
        return std::size_t(slab.extent(2)) * std::size_t(volumes_);
    }

    Result<void> loadPiece(const IndexBox& slab, std::size_t piece, std::byte* out) const override {
        const std::size_t row = std::size_t(slab.extent(0)) * sample_bytes_;
        const std::size_t plane = row * std::size_t(slab.extent(1));
        std::byte* const to = out + piece * plane;
        const std::int64_t volume = std::int64_t(piece) / slab.extent(2);
        const std::int64_t z = slab.begin[2] + std::int64_t(piece) % slab.extent(2);
        if (slab.extent(0) == layout_.extents[0])
            return file_.readAt(at(volume, slab.begin[1], z, 0), {to, plane});
        for (std::int64_t y = slab.begin[1]; y < slab.end[1]; ++y)
            if (auto read = file_.readAt(at(volume, y, z, slab.begin[0]),
                                         {to + std::size_t(y - slab.begin[1]) * row, row});
                !read)
                return read;
        return {};
    }

    void willNeed(const IndexBox& slab) const override {
        for (std::int64_t volume = 0; volume < volumes_; ++volume)
            for (std::int64_t z = slab.begin[2]; z < slab.end[2]; ++z) {
                // Rows that are cut along x lie so close together that whole ones are asked for.
                const std::uint64_t begin = at(volume, slab.begin[1], z, 0),
                                    end = at(volume, slab.end[1], z, 0);
                file_.willNeed(begin, end - begin);
            }
    }

private:
    std::uint64_t at(std::int64_t volume, std::int64_t y, std::int64_t z, std::int64_t x) const {
        const auto& n = layout_.extents;
        return layout_.offset +
               (((std::uint64_t(volume) * std::uint64_t(n[2]) + std::uint64_t(z)) * std::uint64_t(n[1]) +
                 std::uint64_t(y)) *
                    std::uint64_t(n[0]) +
                std::uint64_t(x)) *
                   sample_bytes_;
    }

    ByteFile file_;
    DenseLayout layout_;
    std::size_t sample_bytes_;
    std::int64_t volumes_;
};

// A volume whose file had z fastest, put in another order: columns of kTileX x kTileZ samples that run along
// y, each column's rows [y][z][x] together, column after column with x before z. A slab then reads one long
// run per column.
class ColumnsFile final : public DenseFile {
public:
    static Result<std::unique_ptr<DenseFile>> create(const ByteFile& source, const DenseLayout& layout,
                                                     std::uint64_t memory_bytes) {
        auto columns = std::unique_ptr<ColumnsFile>(new ColumnsFile(layout));
        auto file = ByteFile::temporary(source.path(), columns->bytes());
        if (!file) return tl::unexpected(file.error());
        if (auto sorted = columns->sortInto(*file, source, memory_bytes); !sorted)
            return tl::unexpected(sorted.error());
        columns->file_.emplace_back(std::move(*file));
        return columns;
    }

    // A piece is what one column has of the slab.
    std::size_t pieceCount(const IndexBox& slab) const override {
        const Tiles tiles = tilesOf(slab);
        return std::size_t((tiles.end_x - tiles.begin_x) * (tiles.end_z - tiles.begin_z));
    }

    Result<void> loadPiece(const IndexBox& slab, std::size_t piece, std::byte* out) const override {
        const Tiles tiles = tilesOf(slab);
        const std::int64_t tile_x = tiles.begin_x + std::int64_t(piece) % (tiles.end_x - tiles.begin_x);
        const std::int64_t tile_z = tiles.begin_z + std::int64_t(piece) / (tiles.end_x - tiles.begin_x);
        const std::int64_t x0 = std::max(slab.begin[0], tile_x * tile_x_),
                           x1 = std::min(slab.end[0], (tile_x + 1) * tile_x_);
        const std::int64_t z0 = std::max(slab.begin[2], tile_z * tile_z_),
                           z1 = std::min(slab.end[2], (tile_z + 1) * tile_z_);
        const std::size_t layer = std::size_t(tile_x_ * tile_z_) * sample_bytes_;
        const std::int64_t batch = std::max<std::int64_t>(1, std::int64_t(kReadBytes / layer));
        std::vector<std::byte> rows;
        for (std::int64_t y = slab.begin[1]; y < slab.end[1]; y += batch) {
            const std::int64_t end_y = std::min(slab.end[1], y + batch);
            rows.resize(std::size_t(end_y - y) * layer);
            if (auto read = file_[0].readAt(at(tile_x, tile_z, y), rows); !read) return read;
            for (std::int64_t z = z0; z < z1; ++z)
                for (std::int64_t row = y; row < end_y; ++row)
                    std::memcpy(
                        out + std::size_t(((z - slab.begin[2]) * slab.extent(1) + row - slab.begin[1]) *
                                              slab.extent(0) +
                                          x0 - slab.begin[0]) *
                                  sample_bytes_,
                        rows.data() + std::size_t(row - y) * layer +
                            std::size_t((z % tile_z_) * tile_x_ + x0 % tile_x_) * sample_bytes_,
                        std::size_t(x1 - x0) * sample_bytes_);
        }
        return {};
    }

    void willNeed(const IndexBox& slab) const override {
        const Tiles tiles = tilesOf(slab);
        for (std::int64_t z = tiles.begin_z; z < tiles.end_z; ++z)
            for (std::int64_t x = tiles.begin_x; x < tiles.end_x; ++x)
                file_[0].willNeed(at(x, z, slab.begin[1]), at(x, z, slab.end[1]) - at(x, z, slab.begin[1]));
    }

private:
    static constexpr std::int64_t kTileX = 16, kTileZ = 32;
    static constexpr std::size_t kReadBytes = 512u << 10;
    struct Tiles {
        std::int64_t begin_x, end_x, begin_z, end_z;
    };

    explicit ColumnsFile(const DenseLayout& layout)
        : extents_(layout.extents),
          offset_(layout.offset),
          sample_bytes_(elementBytes(layout.element)),
          tile_x_(std::min(kTileX, extents_[0])),
          tile_z_(std::min(kTileZ, extents_[2])),
          columns_x_((extents_[0] + tile_x_ - 1) / tile_x_),
          columns_z_((extents_[2] + tile_z_ - 1) / tile_z_) {}

    std::uint64_t bytes() const { return at(0, columns_z_, 0); }
    std::uint64_t at(std::int64_t tile_x, std::int64_t tile_z, std::int64_t y) const {
        return ((std::uint64_t(tile_z) * std::uint64_t(columns_x_) + std::uint64_t(tile_x)) *
                    std::uint64_t(extents_[1]) +
                std::uint64_t(y)) *
               std::uint64_t(tile_x_ * tile_z_) * sample_bytes_;
    }
    Tiles tilesOf(const IndexBox& slab) const {
        return {slab.begin[0] / tile_x_, (slab.end[0] - 1) / tile_x_ + 1, slab.begin[2] / tile_z_,
                (slab.end[2] - 1) / tile_z_ + 1};
    }

    // Slab after slab of tile_x_ planes, in batches of as many rows as memory holds.
    Result<void> sortInto(ByteFile& out, const ByteFile& source, std::uint64_t memory_bytes) const {
        const std::uint64_t budget = std::max<std::uint64_t>(memory_bytes, 1u << 20) / 2;
        // A row longer than memory is cut along z as well, at tiles.
        const std::int64_t run_z = std::clamp<std::int64_t>(
            std::int64_t(budget / (std::uint64_t(tile_x_) * sample_bytes_)) / tile_z_ * tile_z_, tile_z_,
            columns_z_ * tile_z_);
        const std::int64_t run_y = std::clamp<std::int64_t>(
            std::int64_t(budget / (std::uint64_t(tile_x_ * run_z) * sample_bytes_)), 1, extents_[1]);
        std::vector<std::byte> planes(std::size_t(tile_x_ * run_y * run_z) * sample_bytes_);
        std::vector<std::byte> column(std::size_t(tile_x_ * run_y * tile_z_) * sample_bytes_);
        for (std::int64_t tile_x = 0; tile_x < columns_x_; ++tile_x)
            for (std::int64_t y = 0; y < extents_[1]; y += run_y)
                for (std::int64_t z = 0; z < extents_[2]; z += run_z) {
                    const std::int64_t end_y = std::min(extents_[1], y + run_y),
                                       end_z = std::min(extents_[2], z + run_z);
                    if (auto read = readPlanes(source, tile_x, y, end_y, z, end_z, planes); !read)
                        return read;
                    for (std::int64_t tile_z = z / tile_z_; tile_z * tile_z_ < end_z; ++tile_z) {
                        fillColumn(tile_x, tile_z, end_y - y, z, end_z, planes, column);
                        const std::size_t used = std::size_t(tile_x_ * (end_y - y) * tile_z_) * sample_bytes_;
                        if (auto put = out.writeAt(at(tile_x, tile_z, y), std::span(column).first(used));
                            !put)
                            return put;
                    }
                }
        return {};
    }

    // Planes of x, each [y][z] as in the file.
    Result<void> readPlanes(const ByteFile& source, std::int64_t tile_x, std::int64_t y, std::int64_t end_y,
                            std::int64_t z, std::int64_t end_z, std::vector<std::byte>& planes) const {
        const std::int64_t end_x = std::min(extents_[0], (tile_x + 1) * tile_x_);
        const std::size_t run = std::size_t(end_z - z) * sample_bytes_;
        const auto sourceAt = [&](std::int64_t x, std::int64_t row) {
            return offset_ + ((std::uint64_t(x) * std::uint64_t(extents_[1]) + std::uint64_t(row)) *
                                  std::uint64_t(extents_[2]) +
                              std::uint64_t(z)) *
                                 sample_bytes_;
        };
        std::byte* to = planes.data();
        for (std::int64_t x = tile_x * tile_x_; x < end_x; ++x) {
            if (end_z - z == extents_[2]) {
                const std::size_t all = run * std::size_t(end_y - y);
                if (auto read = source.readAt(sourceAt(x, y), {to, all}); !read) return read;
                to += all;
                continue;
            }
            for (std::int64_t row = y; row < end_y; ++row, to += run)
                if (auto read = source.readAt(sourceAt(x, row), {to, run}); !read) return read;
        }
        return {};
    }

    void fillColumn(std::int64_t tile_x, std::int64_t tile_z, std::int64_t rows, std::int64_t z,
                    std::int64_t end_z, const std::vector<std::byte>& planes,
                    std::vector<std::byte>& column) const {
        switch (sample_bytes_) {
            case 1: return fillColumnOf<std::uint8_t>(tile_x, tile_z, rows, z, end_z, planes, column);
            case 2: return fillColumnOf<std::uint16_t>(tile_x, tile_z, rows, z, end_z, planes, column);
            case 4: return fillColumnOf<std::uint32_t>(tile_x, tile_z, rows, z, end_z, planes, column);
            default: return fillColumnOf<std::uint64_t>(tile_x, tile_z, rows, z, end_z, planes, column);
        }
    }
    template <class Bits>
    void fillColumnOf(std::int64_t tile_x, std::int64_t tile_z, std::int64_t rows, std::int64_t z,
                      std::int64_t end_z, const std::vector<std::byte>& planes,
                      std::vector<std::byte>& column) const {
        const std::int64_t nx = std::min(tile_x_, extents_[0] - tile_x * tile_x_);
        const std::int64_t z0 = tile_z * tile_z_, nz = std::min(tile_z_, end_z - z0), run = end_z - z;
        const Bits* const from = reinterpret_cast<const Bits*>(planes.data());
        Bits* to = reinterpret_cast<Bits*>(column.data());
        for (std::int64_t y = 0; y < rows; ++y, to += tile_x_ * tile_z_)
            for (std::int64_t k = 0; k < nz; ++k)
                for (std::int64_t x = 0; x < nx; ++x)
                    to[k * tile_x_ + x] = from[(x * rows + y) * run + z0 - z + k];
    }

    std::array<std::int64_t, 3> extents_;
    std::uint64_t offset_;
    std::size_t sample_bytes_;
    std::int64_t tile_x_, tile_z_;
    std::int64_t columns_x_, columns_z_;
    std::vector<ByteFile> file_;  // one
};

}  // namespace

Result<std::unique_ptr<DenseFile>> openDense(ByteFile file, const DenseLayout& layout,
                                             std::uint64_t memory_bytes) {
    // Without a second axis there is nothing to put in order.
    const auto long_axes = std::ranges::count_if(layout.extents, [](std::int64_t n) { return n > 1; });
    if (layout.z_fastest && long_axes > 1) return ColumnsFile::create(file, layout, memory_bytes);
    return std::unique_ptr<DenseFile>(std::make_unique<RowsFile>(std::move(file), layout));
}

}  // namespace brickyard

#include "tools/importers/dense_field.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cstring>

#include "core/printable_name.h"
#include "tools/importers/dense_file.h"
#include "tools/importers/slab_cache.h"

namespace brickyard {
namespace {

// Two rows of boxes of 144^3 samples through 2048 of uint16.
constexpr std::uint64_t kDefaultMemory = std::uint64_t(192) << 20;
constexpr std::uint64_t kLeastMemory = std::uint64_t(16) << 20;
// Boxes from here on, across rows, are the builder's and come in rows; smaller ones come in any order.
constexpr std::int64_t kBandExtent = 64;
// Edge of the pieces that smaller boxes share. One of three doubles a sample is 6 MiB: half of kLeastMemory.
constexpr std::int64_t kChunkEdge = 64;
constexpr std::size_t kChunkBytes = 4u << 20;
// So few samples pay for no chunk.
constexpr std::int64_t kTinyBox = 512;

class DenseField final : public FieldSource {
public:
    DenseField(std::unique_ptr<DenseFile> file, std::filesystem::path path, const DenseLayout& layout,
               ChannelInfo info, std::uint64_t memory_bytes)
        : file_(std::move(file)),
          path_(std::move(path)),
          layout_(layout),
          info_(std::move(info)),
          extents_{{0, 0, 0}, {layout.extents[0], layout.extents[1], layout.extents[2]}},
          element_bytes_(elementBytes(layout.element)),
          convert_(rowConverter(layout.element, layout.big_endian)),
          cache_(*file_, element_bytes_ * std::size_t(layout.components), memory_bytes) {
        info_.type = sampleTypeOf(layout.element);
        info_.components = layout.components;
        info_.background.assign(std::size_t(layout.components), 0);
        info_.active_box = extents_;
        info_.active_voxels = std::uint64_t(layout.extents[0]) * std::uint64_t(layout.extents[1]) *
                              std::uint64_t(layout.extents[2]);
        info_.saved_as_half = layout.element == ElementType::kFloat16;
        // Also uint64, which is no narrower than int64 but another type.
        if (!isFloating(info_.type) && std::string(toString(layout.element)) != toString(info_.type))
            info_.source_type = toString(layout.element);
    }

    const ChannelInfo& info() const override { return info_; }
    bool prefersRows() const override { return true; }
    void release() const override { cache_.clear(); }

    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override {
        if (!intersect(box, extents_).empty()) return std::nullopt;
        return UniformRegion{info_.background, false};
    }

    Result<void> read(const IndexBox& box, SampleBlock& out) const override {
        const std::size_t samples =
            std::size_t(box.extent(0)) * std::size_t(box.extent(1)) * std::size_t(box.extent(2));
        out.values.resize(samples * sampleBytes(info_.type) * std::size_t(layout_.components));
        out.active.resize(samples);
        const IndexBox inside = intersect(box, extents_);
        if (inside != box) {
            std::ranges::fill(out.values, std::byte(0));
            std::ranges::fill(out.active, std::uint8_t(0));
        }
        if (inside.empty()) return {};

        if (inside.extent(0) * inside.extent(1) * inside.extent(2) <= kTinyBox && !wholeFits()) {
            std::vector<std::byte> elements(cache_.bytesOf(inside));
            for (std::size_t piece = 0; piece < file_->pieceCount(inside); ++piece)
                if (auto loaded = file_->loadPiece(inside, piece, elements.data()); !loaded) return loaded;
            return copy(inside, elements.data(), inside, box, out);
        }
        Result<void> result;
        const auto through = [&](const IndexBox& slab, const IndexBox& next) {
            if (!result) return;
            const auto used = cache_.with(slab, next, [&](const std::byte* elements) {
                result = copy(slab, elements, intersect(slab, inside), box, out);
            });
            if (!used) result = used;
        };
        if (wholeFits())
            through(extents_, {});
        else if (const std::int64_t length = bandLength(box, inside); length > 0)
            for (std::int64_t x = inside.begin[0] / length * length; x < inside.end[0]; x += length) {
                IndexBox band = inside;
                band.begin[0] = x;
                band.end[0] = std::min(x + length, extents_.end[0]);
                through(band, nextBand(band, length));
            }
        else
            throughChunks(inside, through);
        return result;
    }

private:
    bool wholeFits() const { return cache_.bytesOf(extents_) <= cache_.budgetBytes() / 2; }

    // How long along x a band of the box's rows may be; 0 where it is not to be read as a band. Whole rows
    // where two bands fit, so that the next row of boxes does not wait for the last threads of this one.
    std::int64_t bandLength(const IndexBox& box, const IndexBox& inside) const {
        // Judged by what was asked for: of the last boxes of a row little lies within the extents.
        if (box.extent(1) < kBandExtent || box.extent(2) < kBandExtent) return 0;
        IndexBox across = inside;
        across.begin[0] = 0;
        across.end[0] = 1;
        const std::int64_t fits = std::int64_t(cache_.budgetBytes() / 2 / cache_.bytesOf(across));
        if (fits >= extents_.end[0]) return extents_.end[0];
        return fits / kBandExtent * kBandExtent;
    }

    // What the builder will ask for after this band: further along x, then along y, then along z. Only what
    // this band does not hold, since the rows that both share are in the system's cache already.
    IndexBox nextBand(const IndexBox& band, std::int64_t length) const {
        IndexBox next = band;
        if (band.end[0] < extents_.end[0]) {
            next.begin[0] = band.end[0];
            next.end[0] = std::min(band.end[0] + length, extents_.end[0]);
            return next;
        }
        next.begin[0] = 0;
        next.end[0] = std::min(length, extents_.end[0]);
        const auto advance = [&](std::size_t axis) {
            next.begin[axis] = band.end[axis];
            next.end[axis] = std::min(band.end[axis] + band.extent(int(axis)), extents_.end[axis]);
            return next.begin[axis] < next.end[axis];
        };
        if (advance(1)) return next;
        next.begin[1] = 0;
        next.end[1] = std::min(band.extent(1), extents_.end[1]);
        return advance(2) ? next : IndexBox{};
    }

    template <class Through>
    void throughChunks(const IndexBox& inside, const Through& through) const {
        const std::array<std::int64_t, 3> edge{chunkLength(), kChunkEdge, kChunkEdge};
        const auto first = [&](std::size_t axis) { return inside.begin[axis] / edge[axis] * edge[axis]; };
        for (std::int64_t z = first(2); z < inside.end[2]; z += edge[2])
            for (std::int64_t y = first(1); y < inside.end[1]; y += edge[1])
                for (std::int64_t x = first(0); x < inside.end[0]; x += edge[0])
                    through(intersect(extents_, {{x, y, z}, {x + edge[0], y + edge[1], z + edge[2]}}),
                            IndexBox{});
    }
    // Along x as far as kChunkBytes go, for fewer and longer reads.
    std::int64_t chunkLength() const {
        const std::size_t across =
            std::size_t(kChunkEdge * kChunkEdge) * element_bytes_ * std::size_t(layout_.components);
        return std::max<std::int64_t>(1, std::int64_t(kChunkBytes / across) / kChunkEdge) * kChunkEdge;
    }

    // `part` of a slab into the block of `box`. Errors: kUnsupported (a value that does not fit).
    Result<void> copy(const IndexBox& slab, const std::byte* elements, const IndexBox& part,
                      const IndexBox& box, SampleBlock& out) const {
        const std::size_t components = std::size_t(layout_.components), bytes = sampleBytes(info_.type);
        const std::size_t stride = element_bytes_ * (layout_.interleaved ? components : 1);
        const auto indexIn = [](const IndexBox& outer, const Index3& at) {
            return std::size_t(((at[2] - outer.begin[2]) * outer.extent(1) + at[1] - outer.begin[1]) *
                                   outer.extent(0) +
                               at[0] - outer.begin[0]);
        };
        const std::size_t row = std::size_t(part.extent(0)), samples = out.active.size();
        const std::size_t volume =
            std::size_t(slab.extent(0) * slab.extent(1) * slab.extent(2)) * element_bytes_;
        for (std::int64_t z = part.begin[2]; z < part.end[2]; ++z)
            for (std::int64_t y = part.begin[1]; y < part.end[1]; ++y) {
                const Index3 at{part.begin[0], y, z};
                const std::size_t to = indexIn(box, at);
                for (std::size_t c = 0; c < components; ++c) {
                    const std::byte* const from = elements + indexIn(slab, at) * stride +
                                                  (layout_.interleaved ? c * element_bytes_ : c * volume);
                    if (!convert_(from, stride, row, out.values.data() + (c * samples + to) * bytes))
                        return tooLarge(from, stride, at);
                }
                std::fill_n(out.active.begin() + std::ptrdiff_t(to), row, std::uint8_t(1));
            }
        return {};
    }

    tl::unexpected<Error> tooLarge(const std::byte* from, std::size_t stride, Index3 at) const {
        std::int64_t sample = 0;
        while (convert_(from, stride, 1, reinterpret_cast<std::byte*>(&sample))) {
            from += stride;
            ++at[0];
        }
        return fail(
            ErrorCode::kUnsupported,
            fmt::format("{}: channel '{}': voxel ({}, {}, {}) is an uint64 above 9223372036854775807, the "
                        "largest that converts; write it as float64",
                        path_.string(), printableName(info_.name), at[0], at[1], at[2]));
    }

    std::unique_ptr<DenseFile> file_;
    std::filesystem::path path_;
    DenseLayout layout_;
    ChannelInfo info_;
    IndexBox extents_;
    std::size_t element_bytes_;
    ConvertRow convert_;
    mutable SlabCache cache_;
};

}  // namespace

Result<std::unique_ptr<FieldSource>> makeDenseField(ByteFile file, const DenseLayout& layout,
                                                    ChannelInfo info, std::uint64_t memory_bytes) {
    const std::uint64_t memory =
        std::clamp(memory_bytes == 0 ? kDefaultMemory : memory_bytes, kLeastMemory, kDefaultMemory);
    std::filesystem::path path = file.path();
    auto dense = openDense(std::move(file), layout, memory);
    if (!dense) return tl::unexpected(dense.error());
    return std::make_unique<DenseField>(std::move(*dense), std::move(path), layout, std::move(info), memory);
}

}  // namespace brickyard

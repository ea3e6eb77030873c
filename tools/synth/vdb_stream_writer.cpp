#include "tools/synth/vdb_stream_writer.h"

#include <blosc.h>
#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cassert>
#include <cerrno>
#include <cstring>
#include <functional>

#include "core/io_error.h"

namespace brickyard {
namespace {

constexpr std::uint64_t kMagic = 0x56444220;
constexpr std::uint32_t kFileVersion = 224, kLibraryMajor = 10, kLibraryMinor = 0;
constexpr std::uint32_t kCompressMask = 2, kCompressBlosc = 4;
// "Inactive values are the background": only active ones are stored.
constexpr char kNoInactiveValues = 0;
constexpr std::int32_t kBlockEdge = 128, kBranchEdge = 4096;
// Below this OpenVDB does not try Blosc.
constexpr std::size_t kLeastBloscBytes = 48;
// Blocks that are in memory at once, values included: at most 8 MiB each.
constexpr std::size_t kBatch = 8;

template <class T>
std::string bytesOf(const T& value) {
    return {reinterpret_cast<const char*>(&value), sizeof value};
}

// Values as OpenVDB writes them under Blosc: length (negative: stored as they are), then bytes.
void appendBlosc(const float* values, std::size_t count, std::string& out) {
    const std::size_t bytes = count * sizeof(float);
    std::array<char, 512 * sizeof(float) + BLOSC_MAX_OVERHEAD> packed;
    int length = 0;
    if (bytes >= kLeastBloscBytes)
        length = ::blosc_compress_ctx(/*clevel=*/9, /*doshuffle=*/1, sizeof(float), bytes, values,
                                      packed.data(), packed.size(), BLOSC_LZ4_COMPNAME, /*blocksize=*/bytes,
                                      /*numinternalthreads=*/1);
    if (length > 0 && std::size_t(length) < bytes) {
        out += bytesOf(std::int64_t(length));
        out.append(packed.data(), std::size_t(length));
        return;
    }
    out += bytesOf(-std::int64_t(bytes));
    out.append(reinterpret_cast<const char*>(values), bytes);
}

// The part of a file that holds one block's leaves.
std::string encodeLeaves(const LeafBlock& block, bool blosc) {
    std::string out;
    const float* values = block.values.data();
    for (const auto& mask : block.value_masks) {
        out += bytesOf(mask);
        out += kNoInactiveValues;
        std::size_t count = 0;
        for (const std::uint64_t word : mask) count += std::size_t(std::popcount(word));
        if (blosc)
            appendBlosc(values, count, out);
        else
            out.append(reinterpret_cast<const char*>(values), count * sizeof(float));
        values += count;
    }
    return out;
}

// Extends `summary` by the active voxels of a block.
void measure(const LeafBlock& block, const std::array<std::int32_t, 3>& origin, VdbGridSummary& summary) {
    std::size_t next = 0;
    for (std::size_t leaf = 0; leaf < 4096; ++leaf) {
        if (!(block.child_mask[leaf >> 6] >> (leaf & 63) & 1)) continue;
        const auto& mask = block.value_masks[next++];
        std::uint64_t planes = 0;
        for (std::size_t x = 0; x < 8; ++x) {
            summary.voxels += std::uint64_t(std::popcount(mask[x]));
            planes |= mask[x];
        }
        ++summary.leaves;
        // Along x the words that are not 0, along y their bytes, along z the bits of all bytes.
        std::uint32_t along[3] = {};
        for (std::size_t i = 0; i < 8; ++i) {
            along[0] |= std::uint32_t(mask[i] != 0) << i;
            along[1] |= std::uint32_t((planes >> 8 * i & 255) != 0) << i;
            along[2] |= std::uint32_t(planes >> 8 * i & 255);
        }
        const std::int32_t corner[3] = {origin[0] + std::int32_t(leaf >> 8) * 8,
                                        origin[1] + std::int32_t(leaf >> 4 & 15) * 8,
                                        origin[2] + std::int32_t(leaf & 15) * 8};
        for (std::size_t a = 0; a < 3; ++a) {
            const std::int32_t low = corner[a] + std::countr_zero(along[a]),
                               high = corner[a] + 31 - std::countl_zero(along[a]);
            summary.first[a] = summary.leaves == 1 ? low : std::min(summary.first[a], low);
            summary.last[a] = summary.leaves == 1 ? high : std::max(summary.last[a], high);
        }
    }
}

}  // namespace

template <class T>
void VdbStreamWriter::put(const T& value) {
    putBytes(&value, sizeof value);
}

void VdbStreamWriter::putBytes(const void* bytes, std::size_t count) {
    if (error_ == 0 && count > 0 && std::fwrite(bytes, 1, count, file_) != count)
        error_ = errno ? errno : EIO;
}

void VdbStreamWriter::putString(const std::string& text) {
    put(std::uint32_t(text.size()));
    putBytes(text.data(), text.size());
}

void VdbStreamWriter::putMetadata(const std::string& name, const std::string& type,
                                  const std::string& value) {
    putString(name);
    putString(type);
    putString(value);
}

std::int64_t VdbStreamWriter::position() { return std::int64_t(::ftello(file_)); }

Result<void> VdbStreamWriter::status() {
    if (error_ != 0) return ioError("write", path_, error_);
    return {};
}

Result<std::unique_ptr<VdbStreamWriter>> VdbStreamWriter::create(const std::filesystem::path& file,
                                                                 Options options) {
    std::FILE* const stream = std::fopen(file.c_str(), "wb");
    if (!stream) return ioError("write", file, errno);
    std::setvbuf(stream, nullptr, _IOFBF, 4u << 20);
    auto writer = std::unique_ptr<VdbStreamWriter>(new VdbStreamWriter(file, stream, std::move(options)));
    writer->put(kMagic);
    writer->put(kFileVersion);
    writer->put(kLibraryMajor);
    writer->put(kLibraryMinor);
    writer->put(char(1));  // there are offsets
    // An identifier of the file: of its contents, so that the same command makes the same bytes.
    writer->putBytes("b81c4a4d-0000-4000-8000-000000000000", 36);
    writer->put(std::uint32_t(1));
    writer->putMetadata("creator", "string", "brickyard synth");
    writer->put(std::int32_t(writer->options_.grids));
    if (auto written = writer->status(); !written) return tl::unexpected(written.error());
    return writer;
}

VdbStreamWriter::~VdbStreamWriter() {
    if (file_) std::fclose(file_);
}

// The topology of the node of 4096^3 at `origin`: blocks [begin, end), all in it. False where they turn out
// to be empty: then there is no node.
bool VdbStreamWriter::putBranch(const std::vector<Coord>& blocks, std::size_t begin, std::size_t end,
                                const Coord& origin, const LeafSource& source, VdbGridSummary& summary) {
    // Masks only: 64 bytes a leaf.
    std::vector<LeafBlock> made(end - begin);
    options_.parallel_for(made.size(),
                          [&](std::size_t i) { source.fill(blocks[begin + i], false, made[i]); });
    std::vector<std::uint64_t> child_mask(512), no_mask(512);
    for (std::size_t i = 0; i < made.size(); ++i) {
        if (made[i].value_masks.empty()) continue;
        measure(made[i], blocks[begin + i], summary);
        std::size_t slot = 0;
        for (std::size_t a = 0; a < 3; ++a)
            slot = slot * 32 + std::size_t(blocks[begin + i][a] & (kBranchEdge - 1)) / kBlockEdge;
        child_mask[slot >> 6] |= std::uint64_t(1) << (slot & 63);
    }
    if (std::ranges::all_of(made, [](const LeafBlock& block) { return block.value_masks.empty(); }))
        return false;
    put(origin);
    // No tile is active, and inactive ones are background: masks, how inactive values are stored, no values.
    const auto putNode = [&](const std::uint64_t* children, std::size_t words) {
        putBytes(children, words * 8);
        putBytes(no_mask.data(), words * 8);
        put(kNoInactiveValues);
        if (options_.blosc) put(std::int64_t(0));
    };
    putNode(child_mask.data(), child_mask.size());
    // Blocks rise by x, y, z, which is the order of the slots.
    for (const LeafBlock& block : made) {
        if (block.value_masks.empty()) continue;
        putNode(block.child_mask.data(), block.child_mask.size());
        for (const auto& mask : block.value_masks) put(mask);
    }
    return true;
}

Result<VdbGridSummary> VdbStreamWriter::addGrid(const std::string& name, double voxel_size,
                                                const LeafSource& source) {
    // By node of 4096^3, which is how a tree is written.
    std::vector<Coord> blocks = source.blocks();
    const auto branchOf = [](const Coord& block) {
        return Coord{block[0] & ~(kBranchEdge - 1), block[1] & ~(kBranchEdge - 1),
                     block[2] & ~(kBranchEdge - 1)};
    };
    std::ranges::sort(blocks, {}, [&](const Coord& block) { return std::pair(branchOf(block), block); });
    const auto branchEnd = [&](std::size_t begin) {
        std::size_t end = begin;
        while (end < blocks.size() && branchOf(blocks[end]) == branchOf(blocks[begin])) ++end;
        return end;
    };

    putString(name);
    putString("Tree_float_5_4_3");
    putString("");  // shares no other grid's tree
    const std::int64_t offsets_at = position();
    for (int i = 0; i < 3; ++i) put(std::int64_t(0));
    std::array<std::int64_t, 3> offsets{position(), 0, 0};
    put(std::uint32_t(kCompressMask | (options_.blosc ? kCompressBlosc : 0)));

    put(std::uint32_t(6));
    putMetadata("class", "string", "fog volume");
    putMetadata("file_compression", "string", options_.blosc ? "blosc + active values" : "active values");
    putMetadata("name", "string", name);
    // Known when the topology is written; of fixed size, so that they can be filled in.
    const std::int64_t statistics_at = position();
    const auto putStatistics = [&](const VdbGridSummary& summary) {
        putMetadata("file_bbox_min", "vec3i", bytesOf(summary.first));
        putMetadata("file_bbox_max", "vec3i", bytesOf(summary.last));
        putMetadata("file_voxel_count", "int64", bytesOf(std::int64_t(summary.voxels)));
    };
    VdbGridSummary summary;
    putStatistics(summary);

    putString("UniformScaleMap");
    const double inverse = 1 / voxel_size;
    for (const double value : {voxel_size, voxel_size, inverse, inverse * inverse, 0.5 * inverse})
        for (int axis = 0; axis < 3; ++axis) put(value);

    put(std::int32_t(1));  // buffers per leaf
    put(0.0f);             // background
    std::vector<std::size_t> begins;
    for (std::size_t begin = 0; begin < blocks.size(); begin = branchEnd(begin)) begins.push_back(begin);
    put(std::uint32_t(0));  // tiles of the root
    const std::int64_t children_at = position();
    put(std::uint32_t(0));
    std::uint32_t children = 0;
    const auto progress = [&](std::size_t done, double from) {
        if (options_.progress) options_.progress(from + 0.5 * double(done) / double(blocks.size()));
    };
    for (const std::size_t begin : begins) {
        children += putBranch(blocks, begin, branchEnd(begin), branchOf(blocks[begin]), source, summary);
        if (auto written = status(); !written) return tl::unexpected(written.error());
        progress(branchEnd(begin), 0);
    }

    offsets[1] = position();
    std::vector<std::string> encoded(kBatch);
    for (std::size_t begin = 0; begin < blocks.size(); begin += kBatch) {
        const std::size_t count = std::min(kBatch, blocks.size() - begin);
        options_.parallel_for(count, [&](std::size_t i) {
            LeafBlock block;
            source.fill(blocks[begin + i], true, block);
            encoded[i] = encodeLeaves(block, options_.blosc);
        });
        for (std::size_t i = 0; i < count; ++i) putBytes(encoded[i].data(), encoded[i].size());
        if (auto written = status(); !written) return tl::unexpected(written.error());
        progress(begin + count, 0.5);
    }
    offsets[2] = position();

    ::fseeko(file_, offsets_at, SEEK_SET);
    put(offsets);
    ::fseeko(file_, statistics_at, SEEK_SET);
    putStatistics(summary);
    ::fseeko(file_, children_at, SEEK_SET);
    put(children);
    ::fseeko(file_, 0, SEEK_END);
    if (auto written = status(); !written) return tl::unexpected(written.error());
    return summary;
}

Result<std::uint64_t> VdbStreamWriter::finish() {
    const std::uint64_t bytes = std::uint64_t(position());
    if (error_ == 0 && std::fflush(file_) != 0) error_ = errno;
    if (std::fclose(std::exchange(file_, nullptr)) != 0 && error_ == 0) error_ = errno;
    if (auto written = status(); !written) return tl::unexpected(written.error());
    return bytes;
}

}  // namespace brickyard

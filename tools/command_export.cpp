// `brickyard export`: a frame of a dataset as .vdb, or one channel as a dense .raw.
#include <fcntl.h>
#include <fmt/format.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <cerrno>
#include <cmath>
#include <cstring>
#include <optional>

#include "core/dataset.h"
#include "core/io_error.h"
#include "core/printable_name.h"
#include "tools/command.h"
#include "tools/exporters/openvdb_export.h"
#include "tools/field_reader.h"
#include "tools/progress_line.h"

namespace brickyard {
namespace {

struct ExportArguments {
    std::string dataset, output, channel;
    std::optional<std::uint32_t> frame;
    int level = 0;
};

// Level-0 voxels of a subtree: regions of one value as they are, bricks of 8^3 multiples.
Result<void> putFinest(const FieldReader& reader, const FieldNode& node, GridSink& sink) {
    if (!node.isLeaf()) {
        for (int octant = 0; octant < 8; ++octant) {
            if (!(node.validMask() >> octant & 1)) continue;
            const auto child = reader.child(node, octant);
            if (!child) return tl::unexpected(child.error());
            if (auto put = putFinest(reader, *child, sink); !put) return put;
        }
        return {};
    }
    const IndexBox region = reader.ownedRegion(node.key);
    if (!node.record().hasBrick()) {
        sink.fill(region, node.tree->constant(node.node), node.record().active);
        return {};
    }
    // A coarse leaf stands for all the bricks below it.
    const std::int64_t edge = reader.shape().edge_cells;
    SampleBlock block;
    for (std::int64_t z = region.begin[2]; z < region.end[2]; z += edge)
        for (std::int64_t y = region.begin[1]; y < region.end[1]; y += edge)
            for (std::int64_t x = region.begin[0]; x < region.end[0]; x += edge) {
                const IndexBox box{{x, y, z}, {x + edge, y + edge, z + edge}};
                if (auto read = reader.read(box, block); !read) return read;
                sink.copy(box, block.values, block.active);
            }
    return {};
}

// Samples of a coarser level, as floats on a lattice 2^level times as wide. Levels have no states: what
// differs from the background is active.
Result<void> putLevel(const FieldReader& reader, const FieldNode& node, int level, GridSink& sink) {
    if (!node.isLeaf() && node.key.level > level) {
        for (int octant = 0; octant < 8; ++octant) {
            if (!(node.validMask() >> octant & 1)) continue;
            const auto child = reader.child(node, octant);
            if (!child) return tl::unexpected(child.error());
            if (auto put = putLevel(reader, *child, level, sink); !put) return put;
        }
        return {};
    }
    const IndexBox region = reader.ownedRegion(node.key);
    const std::size_t components = std::size_t(reader.components());
    IndexBox coarse;
    for (std::size_t a = 0; a < 3; ++a) {
        coarse.begin[a] = region.begin[a] >> level;
        coarse.end[a] = region.end[a] >> level;
    }
    std::vector<float> background(components);
    for (std::size_t c = 0; c < components; ++c)
        background[c] = toFloat(reader.type(), reader.background()[c]);
    if (!node.record().hasBrick()) {
        std::vector<ValueBits> value(components);
        bool differs = false;
        for (std::size_t c = 0; c < components; ++c) {
            const float constant = toFloat(reader.type(), node.tree->constant(node.node)[c]);
            value[c] = fromDouble(SampleType::kFloat32, double(constant));
            differs = differs || constant != background[c];
        }
        sink.fill(coarse, value, differs);
        return {};
    }

    const auto brick = reader.brick(node);
    if (!brick) return tl::unexpected(brick.error());
    const std::int64_t edge = reader.shape().edge_cells;
    const std::size_t count = reader.shape().cells();
    for (std::int64_t z = coarse.begin[2]; z < coarse.end[2]; z += edge)
        for (std::int64_t y = coarse.begin[1]; y < coarse.end[1]; y += edge)
            for (std::int64_t x = coarse.begin[0]; x < coarse.end[0]; x += edge) {
                std::vector<float> values(components * count);
                std::vector<std::uint8_t> active(count, 0);
                const double spacing = std::ldexp(1.0, level);
                for (std::size_t i = 0; i < count; ++i) {
                    const glm::dvec3 at(double(x + std::int64_t(i) % edge),
                                        double(y + std::int64_t(i) / edge % edge),
                                        double(z + std::int64_t(i) / edge / edge));
                    const auto value = reader.interpolate(node, **brick, at * spacing);
                    for (std::size_t c = 0; c < components; ++c) {
                        values[c * count + i] =
                            toFloat(SampleType::kFloat64, fromDouble(SampleType::kFloat64, value[c]));
                        if (values[c * count + i] != background[c]) active[i] = 1;
                    }
                }
                sink.copy({{x, y, z}, {x + edge, y + edge, z + edge}}, std::as_bytes(std::span(values)),
                          active);
            }
    return {};
}

Result<Affine> scaledTransform(const Affine& transform, int level) {
    std::array<double, 16> columns{};
    for (int c = 0; c < 4; ++c)
        for (int r = 0; r < 4; ++r)
            columns[std::size_t(4 * c + r)] =
                transform.matrix()[c][r] * (c < 3 ? std::ldexp(1.0, level) : 1.0);
    return Affine::fromColumns(columns);
}

Result<void> exportVdb(const ExportArguments& arguments, std::shared_ptr<const BrickStore> store,
                       const std::vector<std::uint32_t>& channels) {
    std::vector<ExportedGrid> grids;
    std::vector<GridFiller> fillers;
    for (const std::uint32_t index : channels) {
        const auto reader = std::make_shared<FieldReader>(store, index);
        const ChannelFooter& channel = reader->channel();
        auto transform = scaledTransform(reader->indexToWorld(), arguments.level);
        if (!transform) return tl::unexpected(transform.error());
        ExportedGrid grid{channel.name(),       reader->type(),        reader->components(),   {}, *transform,
                          channel.grid_class(), channel.vector_type(), channel.saved_as_half()};
        grid.background.assign(reader->background().begin(), reader->background().end());
        if (arguments.level > 0) {
            for (ValueBits& bits : grid.background)
                bits = fromDouble(SampleType::kFloat32, double(toFloat(grid.type, bits)));
            grid.type = SampleType::kFloat32;
            grid.saved_as_half = false;
        }
        grids.push_back(std::move(grid));
        fillers.push_back([reader, level = arguments.level](GridSink& sink) -> Result<void> {
            const auto roots = reader->roots();
            if (!roots) return tl::unexpected(roots.error());
            for (const FieldNode& root : *roots)
                if (auto put =
                        level > 0 ? putLevel(*reader, root, level, sink) : putFinest(*reader, root, sink);
                    !put)
                    return put;
            return {};
        });
    }
    if (auto written = writeVdb(arguments.output, grids, fillers); !written) return written;
    fmt::print("{}: {} grid{}\n", arguments.output, grids.size(), grids.size() == 1 ? "" : "s");
    return {};
}

Result<void> writeAll(int descriptor, const std::filesystem::path& path,
                      const std::vector<std::byte>& bytes) {
    for (std::size_t at = 0; at < bytes.size();) {
        const ssize_t written = ::write(descriptor, bytes.data() + at, bytes.size() - at);
        if (written < 0 && errno == EINTR) continue;
        if (written < 0) return ioError("write", path, errno);
        at += std::size_t(written);
    }
    return {};
}

// The dense box of active voxels, x fastest, components interleaved, little-endian.
Result<void> exportRaw(const ExportArguments& arguments, const FieldReader& reader) {
    const ChannelFooter& channel = reader.channel();
    if (arguments.level > 0)
        return fail(ErrorCode::kUnsupported, "a .raw has level 0 only; export a coarser --level as .vdb");
    if (channel.active_min().empty())
        return fail(ErrorCode::kInvalid,
                    fmt::format("channel '{}' has no active voxels, so there is no box to write",
                                printableName(channel.name())));
    IndexBox box;
    double bytes = double(sampleBytes(reader.type())) * reader.components();
    for (int a = 0; a < 3; ++a) {
        box.begin[std::size_t(a)] = channel.active_min(a);
        box.end[std::size_t(a)] = std::int64_t(channel.active_max(a)) + 1;
        bytes *= double(box.extent(a));
    }
    const std::filesystem::path output(arguments.output);
    const std::filesystem::path folder = output.has_parent_path() ? output.parent_path() : ".";
    struct statvfs space{};
    if (::statvfs(folder.c_str(), &space) == 0 && bytes > double(space.f_bavail) * double(space.f_frsize))
        return fail(ErrorCode::kIo,
                    fmt::format("{}: {}x{}x{} voxels take {:.3g} bytes, more than the disk has left; "
                                "export it as .vdb",
                                output.string(), box.extent(0), box.extent(1), box.extent(2), bytes));

    const std::filesystem::path temporary = fmt::format("{}.tmp-{}", output.string(), ::getpid());
    const int descriptor = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    if (descriptor < 0) return ioError("create", temporary, errno);
    const auto write = [&]() -> Result<void> {
        // Rows of voxels in pieces of bounded size, however large the box is.
        constexpr std::int64_t kPieceVoxels = 1 << 22;
        const std::int64_t nx = std::min(box.extent(0), kPieceVoxels);
        const std::int64_t ny = std::clamp<std::int64_t>(kPieceVoxels / nx, 1, box.extent(1));
        // Slabs of several planes only where a plane is one piece, or the pieces would be out of order.
        const std::int64_t nz = nx == box.extent(0) && ny == box.extent(1)
                                    ? std::clamp<std::int64_t>(kPieceVoxels / (nx * ny), 1, box.extent(2))
                                    : 1;
        const std::int64_t rows = nx == box.extent(0) ? ny : 1;
        const std::size_t size = sampleBytes(reader.type()), components = std::size_t(reader.components());
        SampleBlock block;
        std::vector<std::byte> interleaved;
        for (std::int64_t z = box.begin[2]; z < box.end[2]; z += nz)
            for (std::int64_t y = box.begin[1]; y < box.end[1]; y += rows)
                for (std::int64_t x = box.begin[0]; x < box.end[0]; x += nx) {
                    const IndexBox piece = intersect(box, {{x, y, z}, {x + nx, y + rows, z + nz}});
                    if (auto read = reader.read(piece, block); !read) return read;
                    const std::size_t count = block.active.size();
                    interleaved.resize(block.values.size());
                    for (std::size_t i = 0; i < count; ++i)
                        for (std::size_t c = 0; c < components; ++c)
                            std::memcpy(interleaved.data() + (i * components + c) * size,
                                        block.values.data() + (c * count + i) * size, size);
                    if (auto written = writeAll(descriptor, output, interleaved); !written) return written;
                }
        return {};
    };
    Result<void> written = write();
    if (::close(descriptor) != 0 && written) written = ioError("write", output, errno);
    if (written && ::rename(temporary.c_str(), output.c_str()) != 0)
        written = ioError("rename", temporary, errno);
    if (!written) {
        ::unlink(temporary.c_str());
        return written;
    }
    fmt::print("{}: {}x{}x{} {}{}, x fastest, first voxel ({}, {}, {}), {}\n", output.string(), box.extent(0),
               box.extent(1), box.extent(2), toString(reader.type()),
               reader.components() > 1 ? fmt::format(" x {}", reader.components()) : "", box.begin[0],
               box.begin[1], box.begin[2], describeBytes(std::uint64_t(bytes)));
    return {};
}

Result<void> runExport(const ExportArguments& arguments) {
    const auto dataset = Dataset::open(arguments.dataset);
    if (!dataset) return tl::unexpected(dataset.error());
    const Manifest& manifest = dataset->manifest();
    if (manifest.frames().empty())
        return fail(ErrorCode::kNotFound, fmt::format("{}: has no frames; convert some", arguments.dataset));
    if (!arguments.frame && manifest.frames_size() > 1)
        return fail(ErrorCode::kInvalid, fmt::format("{}: has frames {}; choose one with --frame",
                                                     arguments.dataset, describeFrames(manifest)));
    const auto store = dataset->openFrame(arguments.frame.value_or(manifest.frames(0).frame()));
    if (!store) return tl::unexpected(store.error());
    std::vector<std::uint32_t> channels;
    if (!arguments.channel.empty()) {
        const auto found = findChannel(**store, arguments.channel);
        if (!found) return tl::unexpected(found.error());
        channels.push_back(*found);
    } else {
        for (int c = 0; c < (*store)->footer().channels_size(); ++c) channels.push_back(std::uint32_t(c));
    }

    const std::string extension = std::filesystem::path(arguments.output).extension();
    if (extension == ".vdb") return exportVdb(arguments, *store, channels);
    if (extension == ".raw") {
        if (channels.size() != 1)
            return fail(ErrorCode::kInvalid,
                        fmt::format("{}: a .raw holds one channel; choose one of {} with --channel",
                                    arguments.output, channels.size()));
        return exportRaw(arguments, FieldReader(*store, channels[0]));
    }
    if (extension == ".nvdb")
        return fail(ErrorCode::kUnsupported,
                    fmt::format("{}: NanoVDB is not written by this version; export .vdb and use "
                                "nanovdb_convert",
                                arguments.output));
    return fail(ErrorCode::kInvalid,
                fmt::format("{}: unknown kind of file; write .vdb or .raw", arguments.output));
}

}  // namespace

void addExportCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<ExportArguments>();
    CLI::App* command = app.add_subcommand("export", "Write a frame as .vdb, or one channel as a dense .raw");
    command->add_option("dataset", arguments->dataset, "The dataset folder")
        ->required()
        ->type_name("DATASET");
    command->add_option("output", arguments->output, "File to write: OUT.vdb or OUT.raw")
        ->required()
        ->type_name("OUT");
    command->add_option("--frame", arguments->frame, "Which frame; may be left out where there is one")
        ->type_name("F");
    command
        ->add_option("--level", arguments->level,
                     "Which level: 0 is the full resolution, L is 2^L times coarser")
        ->check(CLI::Range(0, int(kMaxLevel)))
        ->type_name("L")
        ->capture_default_str();
    command->add_option("--channel", arguments->channel, "One channel; default all")->type_name("NAME");
    command->callback([arguments, &status] {
        const auto exported = runExport(*arguments);
        status = exported ? int(kExitDone) : reportError("export", exported.error());
    });
}

}  // namespace brickyard

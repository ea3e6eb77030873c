// `brickyard export`: any frame, level and box of a dataset as .vdb, .nvdb or a dense .raw.
#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <optional>

#include "core/dataset.h"
#include "core/printable_name.h"
#include "tools/command.h"
#include "tools/exporters/nanovdb_export.h"
#include "tools/exporters/openvdb_export.h"
#include "tools/field_walk.h"
#include "tools/progress_line.h"
#include "tools/raw_export.h"

namespace brickyard {
namespace {

struct ExportArguments {
    std::string dataset, output, channels, box, codec = "blosc";
    std::optional<std::uint32_t> frame;
    int level = 0;
};

// "x0,y0,z0,x1,y1,z1", both corners inside.
Result<IndexBox> parseBox(const std::string& text) {
    std::array<std::int32_t, 6> corners{};
    const char* at = text.data();
    const char* const end = at + text.size();
    for (std::size_t i = 0; i < 6; ++i) {
        const auto [next, error] = std::from_chars(at, end, corners[i]);
        if (error != std::errc() || (i < 5 ? next == end || *next != ',' : next != end))
            return fail(ErrorCode::kInvalid,
                        fmt::format("'{}' is no box; write x0,y0,z0,x1,y1,z1 in voxels of level 0", text));
        at = next + 1;
    }
    IndexBox box;
    for (std::size_t a = 0; a < 3; ++a) {
        box.begin[a] = corners[a];
        box.end[a] = std::int64_t(corners[a + 3]) + 1;
    }
    if (box.empty())
        return fail(
            ErrorCode::kInvalid,
            fmt::format("'{}' is an empty box; the first corner must not lie above the second", text));
    return box;
}

// Where the voxels of a level lie: their lattice is 2^level times as wide, from the same origin.
Result<Affine> scaledTransform(const Affine& transform, int level) {
    std::array<double, 16> columns{};
    for (int c = 0; c < 4; ++c)
        for (int r = 0; r < 4; ++r)
            columns[std::size_t(4 * c + r)] =
                transform.matrix()[c][r] * (c < 3 ? std::ldexp(1.0, level) : 1.0);
    return Affine::fromColumns(columns);
}

template <class Stored>
std::vector<MetadataEntry> metadataOf(const Stored& stored) {
    std::vector<MetadataEntry> entries;
    for (const SourceMetadata& entry : stored.metadata())
        entries.push_back({entry.name(), entry.type(), entry.value()});
    return entries;
}

// What of a level is written: the box asked for, or everything.
IndexBox wantedBox(const ExportArguments& arguments) {
    constexpr std::int64_t kFar = std::int64_t(1) << 40;
    if (arguments.box.empty()) return {{-kFar, -kFar, -kFar}, {kFar, kFar, kFar}};
    // Checked when the command line was parsed.
    return levelBox(*parseBox(arguments.box), arguments.level);
}

Result<std::vector<ExportedGrid>> exportedGrids(const ExportArguments& arguments,
                                                const std::shared_ptr<const BrickStore>& store,
                                                const std::vector<std::uint32_t>& channels) {
    std::vector<ExportedGrid> grids;
    for (const std::uint32_t index : channels) {
        const auto reader = std::make_shared<FieldReader>(store, index);
        const ChannelFooter& channel = reader->channel();
        auto transform = scaledTransform(reader->indexToWorld(), arguments.level);
        if (!transform) return tl::unexpected(transform.error());
        const bool finest = arguments.level == 0;
        grids.push_back({channel.name(), walkedType(reader->type(), arguments.level), reader->components(),
                         walkedBackground(*reader, arguments.level), *transform, channel.grid_class(),
                         channel.vector_type(), finest && channel.saved_as_half(),
                         finest && channel.source_type() == "mask", metadataOf(channel),
                         [reader, level = arguments.level, box = wantedBox(arguments)](VoxelSink& sink) {
                             return walkField(*reader, level, box, sink);
                         }});
    }
    return grids;
}

Result<void> exportGrids(const ExportArguments& arguments, const std::shared_ptr<const BrickStore>& store,
                         const std::vector<std::uint32_t>& channels, bool nano) {
    auto grids = exportedGrids(arguments, store, channels);
    if (!grids) return tl::unexpected(grids.error());
    const NanoCodec codec = arguments.codec == "none"  ? NanoCodec::kNone
                            : arguments.codec == "zip" ? NanoCodec::kZip
                                                       : NanoCodec::kBlosc;
    if (auto written = nano ? writeNanoVdb(arguments.output, *grids, codec)
                            : writeVdb(arguments.output, *grids, metadataOf(store->footer()));
        !written)
        return written;
    std::error_code error;
    fmt::print("{}: {} grid{}, {}\n", arguments.output, grids->size(), grids->size() == 1 ? "" : "s",
               describeBytes(std::filesystem::file_size(arguments.output, error)));
    return {};
}

Result<void> exportRaw(const ExportArguments& arguments, const std::shared_ptr<const BrickStore>& store,
                       std::uint32_t index) {
    const FieldReader reader(store, index);
    const ChannelFooter& channel = reader.channel();
    IndexBox box = wantedBox(arguments);
    if (arguments.box.empty()) {
        if (channel.active_min().empty())
            return fail(
                ErrorCode::kInvalid,
                fmt::format("channel '{}' has no active voxels, so there is no box to write; give one "
                            "with --box",
                            printableName(channel.name())));
        IndexBox active;
        for (int a = 0; a < 3; ++a) {
            active.begin[std::size_t(a)] = channel.active_min(a);
            active.end[std::size_t(a)] = std::int64_t(channel.active_max(a)) + 1;
        }
        box = levelBox(active, arguments.level);
    }
    if (box.empty())
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: no voxel of level {} lies in the box; choose a larger --box or a finer "
                                "--level",
                                arguments.output, arguments.level));
    if (auto written = writeRaw(arguments.output, reader, arguments.level, box); !written) return written;
    std::error_code error;
    fmt::print("{}: --raw {}x{}x{}:{}{}, first voxel ({}, {}, {}), {}\n", arguments.output, box.extent(0),
               box.extent(1), box.extent(2), rawTypeName(channel, arguments.level),
               reader.components() > 1 ? fmt::format(" x {} interleaved", reader.components()) : "",
               box.begin[0], box.begin[1], box.begin[2],
               describeBytes(std::filesystem::file_size(arguments.output, error)));
    return {};
}

// The channels asked for, all of them where none is.
Result<std::vector<std::uint32_t>> chooseChannels(const ExportArguments& arguments, const BrickStore& store) {
    std::vector<std::uint32_t> channels;
    for (const std::string& name : splitNames(arguments.channels)) {
        const auto found = findChannel(store, name);
        if (!found) return tl::unexpected(found.error());
        channels.push_back(*found);
    }
    if (arguments.channels.empty())
        for (int c = 0; c < store.footer().channels_size(); ++c) channels.push_back(std::uint32_t(c));
    std::uint32_t levels = 0;
    for (const std::uint32_t c : channels)
        levels = std::max(levels, store.footer().channels(int(c)).levels());
    if (arguments.level > 0 && std::uint32_t(arguments.level) >= levels)
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: has {} level{} there; choose --level 0{}", store.path().string(), levels,
                                levels == 1 ? "" : "s", levels > 1 ? fmt::format(" to {}", levels - 1) : ""));
    return channels;
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
    const auto channels = chooseChannels(arguments, **store);
    if (!channels) return tl::unexpected(channels.error());

    const std::string extension = std::filesystem::path(arguments.output).extension();
    if (extension == ".vdb" || extension == ".nvdb")
        return exportGrids(arguments, *store, *channels, extension == ".nvdb");
    if (extension == ".raw") {
        if (channels->size() != 1)
            return fail(ErrorCode::kInvalid,
                        fmt::format("{}: a .raw holds one channel; choose one of {} with --channel",
                                    arguments.output, channels->size()));
        return exportRaw(arguments, *store, channels->front());
    }
    return fail(ErrorCode::kInvalid,
                fmt::format("{}: unknown kind of file; write .vdb, .nvdb or .raw", arguments.output));
}

}  // namespace

void addExportCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<ExportArguments>();
    CLI::App* command =
        app.add_subcommand("export", "Write a frame as .vdb or .nvdb, or one channel as a dense .raw");
    command->add_option("dataset", arguments->dataset, "The dataset folder")
        ->required()
        ->type_name("DATASET");
    command
        ->add_option("output", arguments->output,
                     "File to write: OUT.vdb (values, states, metadata), OUT.nvdb (values, states),\n"
                     "OUT.raw (one channel, x fastest, little-endian; prints its layout as --raw takes it)")
        ->required()
        ->type_name("OUT");
    command->add_option("--frame", arguments->frame, "Which frame; may be left out where there is one")
        ->type_name("F");
    command
        ->add_option("--level", arguments->level,
                     "Which level: 0 is the full resolution, L is 2^L times coarser, as floats")
        ->check(CLI::Range(0, int(kMaxLevel)))
        ->type_name("L")
        ->capture_default_str();
    command
        ->add_option("--channel", arguments->channels,
                     "Only these channels, separated by commas; default all")
        ->type_name("A,B");
    command
        ->add_option(
            "--box", arguments->box,
            "Only these voxels: two corners, both inside, in voxels of level 0 whatever the --level;\n"
            "default everything (.raw: the active voxels' box). Write --box=-1,... before a minus")
        ->type_name("X0,Y0,Z0,X1,Y1,Z1")
        ->check([](const std::string& text) {
            const auto parsed = parseBox(text);
            return parsed ? std::string() : parsed.error().message;
        });
    command->add_option("--codec", arguments->codec, "Compression of a .nvdb: none, zip or blosc")
        ->check(CLI::IsMember({"none", "zip", "blosc"}))
        ->type_name("CODEC")
        ->capture_default_str();
    command->callback([arguments, &status] {
        const auto exported = runExport(*arguments);
        status = exported ? int(kExitDone) : reportError("export", exported.error());
    });
}

}  // namespace brickyard

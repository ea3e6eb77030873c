// `brickyard info`: what a dataset holds, for a person or (--json) for a program.
#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>

#include "core/dataset.h"
#include "core/printable_name.h"
#include "tools/command.h"
#include "tools/field_reader.h"
#include "tools/level_summary.h"
#include "tools/progress_line.h"
#include "tools/slice_picture.h"
#include "tools/value_histogram.h"

namespace brickyard {
namespace {

using Json = nlohmann::ordered_json;

struct InfoArguments {
    std::string dataset;
    std::optional<std::uint32_t> frame;
    std::string channels, slice, picture, range;
    std::optional<int> level;
    int bins = 16;
    bool json = false, histogram = false;
};

// A quick look decodes about so many bricks of a channel.
constexpr std::uint64_t kQuickBricks = 512;

std::string typeText(const ChannelFooter& channel) {
    std::string text = toString(SampleType(int(channel.sample_type())));
    if (channel.components() > 1) text += fmt::format("x{}", channel.components());
    if (channel.saved_as_half()) text += " (half)";
    return text;
}

std::string boxText(const ChannelFooter& channel) {
    if (channel.active_min().empty()) return "empty";
    return fmt::format("{},{},{} .. {},{},{}", channel.active_min(0), channel.active_min(1),
                       channel.active_min(2), channel.active_max(0), channel.active_max(1),
                       channel.active_max(2));
}

std::string sourcesText(const FrameEntry& entry) {
    std::string text;
    for (const SourceFile& source : entry.sources())
        text += fmt::format("{}{} ({})", text.empty() ? "" : ", ", printableName(source.name()),
                            describeBytes(source.bytes()));
    return text.empty() ? "an unknown source" : text;
}

// At most `width` characters, at least one where there is anything.
std::string bar(double part, double whole, int width) {
    if (!(part > 0) || !(whole > 0)) return {};
    return std::string(std::size_t(std::clamp(std::lround(width * part / whole), 1l, long(width))), '#');
}

// The level that was asked for; else the finest that is quick to read, with --histogram the finest.
int histogramLevel(const InfoArguments& arguments, const std::vector<LevelSummary>& levels) {
    const int coarsest = std::max(int(levels.size()) - 1, 0);
    if (arguments.level) return std::min(*arguments.level, coarsest);
    if (arguments.histogram) return 0;
    int level = 0;
    while (level < coarsest && levels[std::size_t(level)].bricks > kQuickBricks) ++level;
    return level;
}

void printLevels(const std::vector<LevelSummary>& levels) {
    if (levels.empty()) return;
    std::uint64_t most = 0;
    for (const LevelSummary& level : levels) most = std::max(most, level.payload_bytes);
    fmt::print("    level     nodes    bricks       bytes                      RMS error  largest error\n");
    for (std::size_t l = 0; l < levels.size(); ++l) {
        const LevelSummary& level = levels[l];
        fmt::print("    {:>5} {:>9} {:>9} {:>11} {:<20} {:>10.4g} {:>14.4g}\n", l, level.nodes, level.bricks,
                   describeBytes(level.payload_bytes), bar(double(level.payload_bytes), double(most), 20),
                   level.rms, level.bound);
    }
}

void printHistogram(const ValueHistogram& histogram) {
    std::uint64_t most = 0;
    double all = 0;
    for (const std::uint64_t voxels : histogram.voxels) {
        most = std::max(most, voxels);
        all += double(voxels);
    }
    if (most == 0) return;
    fmt::print(
        "    values    active voxels{}\n",
        histogram.level > 0 ? fmt::format(", from level {}; --histogram counts all", histogram.level) : "");
    const double step = (histogram.highest - histogram.lowest) / double(histogram.voxels.size());
    for (std::size_t i = 0; i < histogram.voxels.size(); ++i) {
        const double voxels = double(histogram.voxels[i]);
        fmt::print("    from {:>11.5g} {:>14} {:>6.2f} %{}{}\n", histogram.lowest + step * double(i),
                   histogram.voxels[i], 100 * voxels / all, voxels > 0 ? "  " : "",
                   bar(voxels, double(most), 40));
    }
}

Result<void> printChannel(const FieldReader& reader, const InfoArguments& arguments) {
    const ChannelFooter& channel = reader.channel();
    const auto levels = summarizeLevels(reader);
    if (!levels) return tl::unexpected(levels.error());
    fmt::print("  {}: {}, {}\n", printableName(channel.name()), typeText(channel), channel.grid_class());
    fmt::print("    active     {} voxels, box {}\n", channel.active_voxels(), boxText(channel));
    fmt::print("    voxel      {:.6g} world units\n", reader.indexToWorld().voxelSize());
    fmt::print("    range      {:.6g} .. {:.6g}\n", channel.value_min(), channel.value_max());
    fmt::print("    error      {}\n",
               channel.error_bound() == 0 && channel.error_made() == 0
                   ? std::string("0, exact")
                   : fmt::format("at most {:.6g}, made {:.6g}", channel.error_bound(), channel.error_made()));
    fmt::print("    stored     {} bricks, {}, {} level{}\n", channel.bricks(),
               describeBytes(channel.payload_bytes()), channel.levels(), channel.levels() == 1 ? "" : "s");
    printLevels(*levels);
    const auto histogram = countValues(reader, histogramLevel(arguments, *levels), arguments.bins);
    if (!histogram) return tl::unexpected(histogram.error());
    printHistogram(*histogram);
    return {};
}

// Those that were named, else all.
Result<std::vector<std::uint32_t>> chosenChannels(const BrickStore& store, const InfoArguments& arguments) {
    std::vector<std::uint32_t> channels;
    for (const std::string& name : splitNames(arguments.channels)) {
        const auto found = findChannel(store, name);
        if (!found) return tl::unexpected(found.error());
        channels.push_back(*found);
    }
    if (arguments.channels.empty())
        for (int c = 0; c < store.footer().channels_size(); ++c) channels.push_back(std::uint32_t(c));
    return channels;
}

Result<void> printDataset(const Dataset& dataset, const InfoArguments& arguments) {
    const Manifest& manifest = dataset.manifest();
    std::uint64_t bytes = 0;
    for (const FrameEntry& entry : manifest.frames()) bytes += entry.file_bytes();
    fmt::print("{}: {} frame{}, {}\n", dataset.folder().string(), manifest.frames_size(),
               manifest.frames_size() == 1 ? "" : "s", describeBytes(bytes));
    fmt::print("  format {}.{}, bricks of {}^3 cells, written by {}\n", manifest.format_major(),
               manifest.format_minor(), manifest.brick_edge(), printableName(manifest.writer()));
    fmt::print("  frames {}\n", describeFrames(manifest));
    if (manifest.frames().empty()) return {};
    const std::uint32_t frame = arguments.frame.value_or(manifest.frames(manifest.frames_size() - 1).frame());
    const auto store = dataset.openFrame(frame);
    if (!store) return tl::unexpected(store.error());
    const auto channels = chosenChannels(**store, arguments);
    if (!channels) return tl::unexpected(channels.error());
    const FrameEntry& entry = *dataset.findFrame(frame);
    fmt::print("frame {}: {}, {} channel{}, from {}\n", frame, describeBytes(entry.file_bytes()),
               entry.channels_size(), entry.channels_size() == 1 ? "" : "s", sourcesText(entry));
    for (const std::uint32_t c : *channels)
        if (auto printed = printChannel(FieldReader(*store, c), arguments); !printed) return printed;
    return {};
}

Result<Json> describeChannel(const FieldReader& reader, const InfoArguments& arguments) {
    const ChannelFooter& channel = reader.channel();
    const auto levels = summarizeLevels(reader);
    if (!levels) return tl::unexpected(levels.error());
    Json json{{"name", channel.name()},
              {"type", toString(reader.type())},
              {"components", channel.components()},
              {"saved_as_half", channel.saved_as_half()},
              {"grid_class", channel.grid_class()},
              {"vector_type", channel.vector_type()},
              {"background", Json::array()},
              {"index_to_world",
               std::vector<double>(channel.index_to_world().begin(), channel.index_to_world().end())},
              {"voxel_size", reader.indexToWorld().voxelSize()},
              {"active_voxels", channel.active_voxels()},
              {"active_box", nullptr},
              {"range", {channel.value_min(), channel.value_max()}},
              {"error_bound", channel.error_bound()},
              {"error_made", channel.error_made()},
              {"bricks", channel.bricks()},
              {"payload_bytes", channel.payload_bytes()},
              {"tree_blocks", channel.blocks_size()},
              {"levels", Json::array()}};
    for (const ValueBits bits : reader.background())
        json["background"].push_back(toDouble(reader.type(), bits));
    if (!channel.active_min().empty())
        json["active_box"] = {
            {"min", std::vector<std::int32_t>(channel.active_min().begin(), channel.active_min().end())},
            {"max", std::vector<std::int32_t>(channel.active_max().begin(), channel.active_max().end())}};
    for (std::size_t l = 0; l < levels->size(); ++l)
        json["levels"].push_back({{"level", l},
                                  {"nodes", (*levels)[l].nodes},
                                  {"bricks", (*levels)[l].bricks},
                                  {"payload_bytes", (*levels)[l].payload_bytes},
                                  {"rms_error", (*levels)[l].rms},
                                  {"largest_error", (*levels)[l].bound}});
    const auto histogram = countValues(reader, histogramLevel(arguments, *levels), arguments.bins);
    if (!histogram) return tl::unexpected(histogram.error());
    json["histogram"] = {{"level", histogram->level},
                         {"lowest", histogram->lowest},
                         {"highest", histogram->highest},
                         {"voxels", histogram->voxels}};
    return json;
}

Result<void> printJson(const Dataset& dataset, const InfoArguments& arguments) {
    const Manifest& manifest = dataset.manifest();
    Json json{{"dataset", validUtf8(dataset.folder().string())},
              {"format", fmt::format("{}.{}", manifest.format_major(), manifest.format_minor())},
              {"writer", manifest.writer()},
              {"brick_edge", manifest.brick_edge()},
              {"nonfinite", manifest.nonfinite()},
              {"frame_numbers", Json::array()},
              {"bytes", 0},
              {"frames", Json::array()}};
    std::uint64_t bytes = 0;
    for (const FrameEntry& entry : manifest.frames()) {
        json["frame_numbers"].push_back(entry.frame());
        bytes += entry.file_bytes();
        if (arguments.frame && entry.frame() != *arguments.frame) continue;
        const auto store = dataset.openFrame(entry.frame());
        if (!store) return tl::unexpected(store.error());
        Json frame{{"frame", entry.frame()},
                   {"file", entry.file()},
                   {"bytes", entry.file_bytes()},
                   {"sources", Json::array()},
                   {"channels", Json::array()}};
        for (const SourceFile& source : entry.sources())
            frame["sources"].push_back(
                {{"name", source.name()}, {"bytes", source.bytes()}, {"modified_ns", source.modified_ns()}});
        const auto channels = chosenChannels(**store, arguments);
        if (!channels) return tl::unexpected(channels.error());
        for (const std::uint32_t c : *channels) {
            auto channel = describeChannel(FieldReader(*store, c), arguments);
            if (!channel) return tl::unexpected(channel.error());
            frame["channels"].push_back(std::move(*channel));
        }
        json["frames"].push_back(std::move(frame));
    }
    json["bytes"] = bytes;
    fmt::print("{}\n", json.dump(2));
    return {};
}

// "0,1.5": two rising numbers.
Result<std::array<double, 2>> parseRange(const std::string& text) {
    std::array<double, 2> range{};
    const char* const end = text.data() + text.size();
    const auto low = std::from_chars(text.data(), end, range[0]);
    if (low.ec == std::errc() && low.ptr != end && *low.ptr == ',') {
        const auto high = std::from_chars(low.ptr + 1, end, range[1]);
        if (high.ec == std::errc() && high.ptr == end && range[0] < range[1]) return range;
    }
    return fail(ErrorCode::kInvalid, fmt::format("'{}' is no range; write two rising numbers, LO,HI", text));
}

// What to show where nobody chose: density, or the first channel that has anything.
std::uint32_t defaultChannel(const BrickStore& store) {
    std::uint32_t first = 0;
    for (int c = store.footer().channels_size() - 1; c >= 0; --c) {
        if (store.footer().channels(c).active_voxels() == 0) continue;
        first = std::uint32_t(c);
        if (store.footer().channels(c).name() == "density") break;
    }
    return first;
}

Result<void> writeSlice(const Dataset& dataset, const InfoArguments& arguments) {
    const Manifest& manifest = dataset.manifest();
    if (manifest.frames().empty())
        return fail(ErrorCode::kNotFound, fmt::format("{}: has no frames; convert some", arguments.dataset));
    const std::uint32_t frame = arguments.frame.value_or(manifest.frames(manifest.frames_size() - 1).frame());
    const auto store = dataset.openFrame(frame);
    if (!store) return tl::unexpected(store.error());
    const auto channels = chosenChannels(**store, arguments);
    if (!channels) return tl::unexpected(channels.error());
    if (channels->empty())
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: frame {} has no channels", arguments.dataset, frame));
    const FieldReader reader(*store,
                             arguments.channels.empty() ? defaultChannel(**store) : channels->front());
    // Checked when the command line was parsed.
    SliceRequest request = *parseSlice(arguments.slice);
    request.level = arguments.level;
    if (!arguments.range.empty()) request.range = *parseRange(arguments.range);
    const auto slice = brickyard::writeSlice(reader, request, arguments.picture);
    if (!slice) return tl::unexpected(slice.error());
    if (arguments.json) {
        const Json json{{"file", validUtf8(arguments.picture)},
                        {"frame", frame},
                        {"channel", reader.channel().name()},
                        {"slice", arguments.slice},
                        {"level", slice->level},
                        {"width", slice->width},
                        {"height", slice->height},
                        {"first_voxel", slice->box.begin},
                        {"range", slice->range},
                        {"colors", slice->diverging ? "diverging" : "grey"}};
        fmt::print("{}\n", json.dump(2));
        return {};
    }
    fmt::print("{}: {} x {} pixels, frame {}, channel '{}', {}, level {}, {} {:.6g} .. {:.6g}\n",
               arguments.picture, slice->width, slice->height, frame, printableName(reader.channel().name()),
               arguments.slice, slice->level, slice->diverging ? "blue, white, red" : "black to white",
               slice->range[0], slice->range[1]);
    return {};
}

Result<void> runInfo(const InfoArguments& arguments) {
    const auto dataset = Dataset::open(arguments.dataset);
    if (!dataset) return tl::unexpected(dataset.error());
    if (arguments.frame && !dataset->findFrame(*arguments.frame))
        return fail(ErrorCode::kNotFound, fmt::format("{}: has no frame {}; it has {}", arguments.dataset,
                                                      *arguments.frame, describeFrames(dataset->manifest())));
    if (!arguments.slice.empty()) return writeSlice(*dataset, arguments);
    return arguments.json ? printJson(*dataset, arguments) : printDataset(*dataset, arguments);
}

}  // namespace

void addInfoCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<InfoArguments>();
    CLI::App* command = app.add_subcommand("info", "Describe a dataset");
    command->add_option("dataset", arguments->dataset, "The dataset folder")
        ->required()
        ->type_name("DATASET");
    command
        ->add_option("--frame", arguments->frame,
                     "Which frame to describe in detail; default the last, with --json all")
        ->type_name("F");
    command->add_option("--channel", arguments->channels, "Only these channels, separated by commas")
        ->type_name("A,B");
    command->add_flag("--histogram", arguments->histogram,
                      "Count all voxels of level 0 (or --level); default a level that is quick to read");
    command
        ->add_option("--level", arguments->level,
                     "Level of the histogram or the slice; default one that is quick, or fits")
        ->check(CLI::Range(0, int(kMaxLevel)))
        ->type_name("L");
    command->add_option("--bins", arguments->bins, "Bins of the histogram")
        ->check(CLI::Range(1, 4096))
        ->type_name("N")
        ->capture_default_str();
    const auto valid = [](const auto& parsed) { return parsed ? std::string() : parsed.error().message; };
    CLI::Option* slice =
        command
            ->add_option("--slice", arguments->slice,
                         "Write a plane of one channel as a PNG: x=, y= or z= and a voxel of level 0.\n"
                         "One pixel a voxel; of a z slice x points right and y up")
            ->check([valid](const std::string& text) { return valid(parseSlice(text)); })
            ->type_name("z=40");
    CLI::Option* output = command->add_option("-o,--output", arguments->picture, "The picture to write")
                              ->needs(slice)
                              ->type_name("OUT.png");
    slice->needs(output);
    command
        ->add_option("--range", arguments->range,
                     "Values that are black and white; default the channel's range. Both signs: blue to red")
        ->check([valid](const std::string& text) { return valid(parseRange(text)); })
        ->needs(slice)
        ->type_name("LO,HI");
    command->add_flag("--json", arguments->json, "Print a JSON object on stdout");
    command->callback([arguments, &status] {
        const auto printed = runInfo(*arguments);
        status = printed ? int(kExitDone) : reportError("info", printed.error());
    });
}

}  // namespace brickyard

// `brickyard info`: what a dataset holds, for a person or (--json) for a program.
#include <fmt/format.h>

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

namespace brickyard {
namespace {

using Json = nlohmann::ordered_json;

struct InfoArguments {
    std::string dataset;
    std::optional<std::uint32_t> frame;
    bool json = false;
};

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

Result<void> printChannel(const FieldReader& reader) {
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
    for (std::size_t l = 0; l < levels->size(); ++l) {
        const LevelSummary& level = (*levels)[l];
        fmt::print("      level {:<2} {:>7} nodes {:>7} bricks {:>10}   RMS error {:<10.4g} largest {:.4g}\n",
                   l, level.nodes, level.bricks, describeBytes(level.payload_bytes), level.rms, level.bound);
    }
    return {};
}

Result<void> printDataset(const Dataset& dataset, std::optional<std::uint32_t> chosen) {
    const Manifest& manifest = dataset.manifest();
    std::uint64_t bytes = 0;
    for (const FrameEntry& entry : manifest.frames()) bytes += entry.file_bytes();
    fmt::print("{}: {} frame{}, {}\n", dataset.folder().string(), manifest.frames_size(),
               manifest.frames_size() == 1 ? "" : "s", describeBytes(bytes));
    fmt::print("  format {}.{}, bricks of {}^3 cells, written by {}\n", manifest.format_major(),
               manifest.format_minor(), manifest.brick_edge(), printableName(manifest.writer()));
    fmt::print("  frames {}\n", describeFrames(manifest));
    if (manifest.frames().empty()) return {};
    const std::uint32_t frame = chosen.value_or(manifest.frames(manifest.frames_size() - 1).frame());
    const auto store = dataset.openFrame(frame);
    if (!store) return tl::unexpected(store.error());
    const FrameEntry& entry = *dataset.findFrame(frame);
    fmt::print("frame {}: {}, {} channel{}, from {}\n", frame, describeBytes(entry.file_bytes()),
               entry.channels_size(), entry.channels_size() == 1 ? "" : "s", sourcesText(entry));
    for (int c = 0; c < (*store)->footer().channels_size(); ++c)
        if (auto printed = printChannel(FieldReader(*store, std::uint32_t(c))); !printed) return printed;
    return {};
}

Result<Json> describeChannel(const FieldReader& reader) {
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
    return json;
}

Result<void> printJson(const Dataset& dataset, std::optional<std::uint32_t> chosen) {
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
        if (chosen && entry.frame() != *chosen) continue;
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
        for (int c = 0; c < (*store)->footer().channels_size(); ++c) {
            auto channel = describeChannel(FieldReader(*store, std::uint32_t(c)));
            if (!channel) return tl::unexpected(channel.error());
            frame["channels"].push_back(std::move(*channel));
        }
        json["frames"].push_back(std::move(frame));
    }
    json["bytes"] = bytes;
    fmt::print("{}\n", json.dump(2));
    return {};
}

Result<void> runInfo(const InfoArguments& arguments) {
    const auto dataset = Dataset::open(arguments.dataset);
    if (!dataset) return tl::unexpected(dataset.error());
    if (arguments.frame && !dataset->findFrame(*arguments.frame))
        return fail(ErrorCode::kNotFound, fmt::format("{}: has no frame {}; it has {}", arguments.dataset,
                                                      *arguments.frame, describeFrames(dataset->manifest())));
    return arguments.json ? printJson(*dataset, arguments.frame) : printDataset(*dataset, arguments.frame);
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
    command->add_flag("--json", arguments->json, "Print a JSON object on stdout");
    command->callback([arguments, &status] {
        const auto printed = runInfo(*arguments);
        status = printed ? int(kExitDone) : reportError("info", printed.error());
    });
}

}  // namespace brickyard

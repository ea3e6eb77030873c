// `brickyard bake`: light into a dataset, so that it streams like any other channel.

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "client/scene.h"
#include "core/printable_name.h"
#include "tools/bake/bake.h"
#include "tools/bake/lit_voxels.h"
#include "tools/command.h"
#include "tools/progress_line.h"
#include "tools/render_options.h"
#include "tools/stop_signal.h"

namespace brickyard {

namespace {

struct BakeArguments {
    std::string dataset, output, scene, frames;
    std::optional<std::uint32_t> frame;
    double max_error = 0.002;
    int level = 0;
    unsigned jobs = 0;
    bool overwrite = false, json = false;
};

// "plume.bricks" is baked to "plume-lit.bricks" beside it.
std::filesystem::path litName(std::filesystem::path dataset) {
    if (!dataset.has_filename()) dataset = dataset.parent_path();
    return dataset.parent_path() / (dataset.stem().string() + "-lit" + dataset.extension().string());
}

// What the arguments say by themselves. An error is wrong usage.
Result<BakeOptions> optionsOf(const BakeArguments& arguments) {
    BakeOptions options;
    options.dataset = arguments.dataset;
    options.output =
        arguments.output.empty() ? litName(arguments.dataset) : std::filesystem::path(arguments.output);
    if (arguments.frame && !arguments.frames.empty())
        return fail(ErrorCode::kInvalid, "--frame names one, --frames several; leave one of them out");
    const std::string listed = arguments.frame ? std::to_string(*arguments.frame) : arguments.frames;
    if (!listed.empty()) {
        const Result<FrameSet> frames = FrameSet::parse(listed);
        if (!frames) return tl::unexpected(frames.error());
        options.frames = *frames;
    }
    if (!(arguments.max_error >= 0 && arguments.max_error < 1))
        return fail(ErrorCode::kInvalid,
                    fmt::format("--error {}: give a number of at least 0, below 1", arguments.max_error));
    options.max_error = arguments.max_error;
    options.level = arguments.level;
    options.jobs = arguments.jobs;
    options.overwrite = arguments.overwrite;
    return options;
}

void report(const BakeArguments& arguments, const BakeOptions& options, const BakeReport& report) {
    if (arguments.json) {
        nlohmann::json json{{"output", validUtf8(options.output.string())},
                            {"frames", report.frames.size()},
                            {"output_bytes", report.output_bytes},
                            {"seconds", report.seconds},
                            {"channels", nlohmann::json::array()}};
        for (const std::string& name : report.channels) {
            double made = 0;
            std::uint64_t bytes = 0;
            for (const FrameEntry& frame : report.frames)
                for (const ChannelSummary& channel : frame.channels())
                    if (channel.name() == name) {
                        made = std::max(made, channel.error_made());
                        bytes += channel.payload_bytes();
                    }
            json["channels"].push_back(
                {{"name", name}, {"error_bound", options.max_error}, {"error_made", made}, {"bytes", bytes}});
        }
        fmt::print("{}\n", json.dump());
        return;
    }
    fmt::print("{}: {} frame{} with {} to {}, {}, {}\n", options.output.string(), report.frames.size(),
               report.frames.size() == 1 ? "" : "s", report.channels.front(), report.channels.back(),
               describeBytes(report.output_bytes), describeSeconds(report.seconds));
    fmt::print("name them in the scene: \"baked\": \"{}\" in the first light, and so on\n",
               report.channels.front());
}

int runBake(const BakeArguments& arguments) {
    Result<BakeOptions> options = optionsOf(arguments);
    if (!options) {
        reportError("bake", options.error());
        return kExitUsage;
    }
    if (!arguments.scene.empty()) {
        Result<Scene> scene = readScene(arguments.scene);
        if (!scene) return reportError("bake", scene.error());
        options->scene = std::move(*scene);
        options->folder = sceneFolder(arguments.scene);
    }
    const StopSignal stop;
    options->stop = [] { return StopSignal::received() != 0; };
    ProgressLine line;
    options->progress = [&](std::uint32_t done, std::uint32_t frames, double part) {
        line.show(fmt::format("frame {} of {}", done + 1, frames), (done + part) / double(frames), 0);
    };
    const Result<BakeReport> baked = bake(*options);
    line.clear();
    if (!baked) return reportError("bake", baked.error());
    report(arguments, *options, *baked);
    return kExitDone;
}

}  // namespace

void addBakeCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<BakeArguments>();
    CLI::App* command = app.add_subcommand(
        "bake",
        "Write a dataset with a channel more for each light of a scene: what reaches the medium of it");
    command->add_option("dataset", arguments->dataset, "The dataset folder")
        ->required()
        ->type_name("DATASET");
    command->add_option("--scene", arguments->scene, "File or JSON: media and lights (docs/scene.md)");
    command->add_option("-o,--output", arguments->output, "OUT.bricks; DATASET-lit.bricks if left out");
    command->add_option("--frame", arguments->frame, "This frame only; all there are if left out");
    command->add_option("--frames", arguments->frames, "These frames only: 10-19, or 1,5,10-20x2")
        ->type_name("LIST");
    command->add_option("--error", arguments->max_error, "Of the baked channels, which lie in [0, 1]")
        ->capture_default_str();
    command
        ->add_option("--level", arguments->level,
                     "Voxels twice as wide for each level: an eighth of the rays and bytes")
        ->check(CLI::Range(0, kMaxBakeLevel))
        ->capture_default_str();
    command->add_option("--jobs", arguments->jobs, "Threads; default one per processor")
        ->check(CLI::Range(1u, 1024u))
        ->type_name("N");
    command->add_flag("--overwrite", arguments->overwrite, "Replace a dataset that is there");
    command->add_flag("--json", arguments->json, "One JSON object on stdout and nothing else");
    command->callback([arguments, &status] { status = runBake(*arguments); });
}

}  // namespace brickyard

// `brickyard convert` and the hidden `brickyard probe-vdb`, which reads one file for it under limits.
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <malloc.h>
#include <sys/resource.h>

#include <charconv>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <optional>

#include "core/printable_name.h"
#include "tools/command.h"
#include "tools/conversion.h"
#include "tools/frame_watch.h"
#include "tools/importers/vdb_reader_guard.h"
#include "tools/progress_line.h"
#include "tools/raw_arguments.h"
#include "tools/stop_signal.h"

namespace brickyard {
namespace {

using Json = nlohmann::ordered_json;

constexpr int kCompactBrickEdge = 32;

struct ConvertArguments {
    std::vector<std::string> paths;
    std::string channels, frames, memory, nonfinite = "reject";
    std::vector<std::string> errors;
    RawArguments raw;
    std::optional<int> brick;
    bool compact = false;
    unsigned jobs = 0;
    bool append = false, overwrite = false, json = false, dry_run = false, watch = false;
    std::optional<double> settle, idle;
    std::optional<std::uint32_t> until_frame;
};

// "0.01" or "density=0.01". A channel's name may contain '=': the last one counts.
Result<std::pair<std::string, double>> parseErrorRequest(const std::string& text) {
    const std::size_t equals = text.rfind('=');
    const std::string name = equals == std::string::npos ? "" : text.substr(0, equals);
    const std::string number = equals == std::string::npos ? text : text.substr(equals + 1);
    double value = 0;
    const auto parsed = std::from_chars(number.data(), number.data() + number.size(), value);
    if (parsed.ec != std::errc() || parsed.ptr != number.data() + number.size() || !std::isfinite(value) ||
        value < 0 || equals == 0)
        return fail(ErrorCode::kInvalid,
                    fmt::format("'{}' is no error; write a number from 0 up, or NAME=NUMBER", text));
    return std::pair(name, value);
}

const char* typeName(const ChannelSummary& channel) {
    return toString(SampleType(int(channel.sample_type())));
}

// Channels over all frames: the same name is the same channel.
struct ChannelTotal {
    ChannelSummary all;
    bool any_active = false;
};
std::vector<ChannelTotal> totalChannels(const std::vector<FrameEntry>& frames) {
    std::vector<ChannelTotal> totals;
    for (const FrameEntry& frame : frames)
        for (const ChannelSummary& channel : frame.channels()) {
            auto total = std::find_if(totals.begin(), totals.end(), [&](const ChannelTotal& other) {
                return other.all.name() == channel.name();
            });
            const bool active = channel.active_voxels() > 0;
            if (total == totals.end()) {
                totals.push_back({channel, active});
                continue;
            }
            ChannelSummary& all = total->all;
            if (active) {
                all.set_value_min(total->any_active ? std::min(all.value_min(), channel.value_min())
                                                    : channel.value_min());
                all.set_value_max(total->any_active ? std::max(all.value_max(), channel.value_max())
                                                    : channel.value_max());
                total->any_active = true;
            }
            all.set_active_voxels(all.active_voxels() + channel.active_voxels());
            all.set_bricks(all.bricks() + channel.bricks());
            all.set_levels(std::max(all.levels(), channel.levels()));
            all.set_payload_bytes(all.payload_bytes() + channel.payload_bytes());
            all.set_error_bound(std::max(all.error_bound(), channel.error_bound()));
            all.set_error_made(std::max(all.error_made(), channel.error_made()));
        }
    return totals;
}

void printReport(const ConvertArguments& arguments, const std::filesystem::path& output,
                 const ConversionReport& report) {
    const std::vector<ChannelTotal> totals = totalChannels(report.frames);
    std::uint64_t voxels = 0, bricks = 0, output_bytes = 0;
    std::uint32_t levels = 0;
    for (const ChannelTotal& total : totals) {
        voxels += total.all.active_voxels();
        bricks += total.all.bricks();
        levels = std::max(levels, total.all.levels());
    }
    for (const FrameEntry& frame : report.frames) output_bytes += frame.file_bytes();

    if (!arguments.json) {
        const std::size_t there = report.frames.size() - report.converted;
        fmt::print("{}: {} frame{}{}, {} channel{}, {} bricks, {} from {}, in {}\n", output.string(),
                   report.frames.size(), report.frames.size() == 1 ? "" : "s",
                   there > 0 ? fmt::format(" ({} there already)", there) : "", totals.size(),
                   totals.size() == 1 ? "" : "s", bricks, describeBytes(output_bytes),
                   describeBytes(report.input_bytes), describeSeconds(report.seconds));
        return;
    }
    rusage usage{};
    ::getrusage(RUSAGE_SELF, &usage);
    Json channels = Json::array();
    for (const auto& [channel, any_active] : totals)
        channels.push_back({{"name", channel.name()},
                            {"type", typeName(channel)},
                            {"components", channel.components()},
                            {"range", {channel.value_min(), channel.value_max()}},
                            {"error_bound", channel.error_bound()},
                            {"error_made", channel.error_made()},
                            {"active_voxels", channel.active_voxels()},
                            {"bricks", channel.bricks()},
                            {"levels", channel.levels()},
                            {"payload_bytes", channel.payload_bytes()},
                            {"saved_as_half", channel.saved_as_half()}});
    const Json all{{"dataset", validUtf8(output.string())},
                   {"frames", report.frames.size()},
                   {"frames_converted", report.converted},
                   {"active_voxels", voxels},
                   {"bricks", bricks},
                   {"levels", levels},
                   {"input_bytes", report.input_bytes},
                   {"output_bytes", output_bytes},
                   {"seconds", report.seconds},
                   {"peak_memory_bytes", std::uint64_t(usage.ru_maxrss) * 1024},
                   {"channels", channels}};
    fmt::print("{}\n", all.dump(2));
}

// What is freed is taken again at once: giving it back to the system in between costs a tenth of the time.
void keepFreedMemory() {
#ifdef __GLIBC__
    ::mallopt(M_TRIM_THRESHOLD, 64 << 20);
    ::mallopt(M_TOP_PAD, 4 << 20);
#endif
}

// The exit status that a shell gives a program ended by the signal.
int reportStopped(const std::string& state) {
    fmt::print(stderr, "brickyard convert: stopped; run the same command again, {}\n", state);
    return 128 + StopSignal::received();
}

int runForecast(const ConvertArguments& arguments, const ConversionOptions& options) {
    const auto forecast = brickyard::forecast(options);
    if (StopSignal::received() != 0) return reportStopped("nothing was written");
    if (!forecast) return reportError("convert", forecast.error());
    if (arguments.json) {
        const Json all{{"dataset", validUtf8(options.output.string())},
                       {"dry_run", true},
                       {"frames", forecast->frames},
                       {"frames_done", forecast->frames_done},
                       {"input_bytes", forecast->input_bytes},
                       {"predicted_bytes", std::uint64_t(forecast->bytes)},
                       {"predicted_seconds", forecast->seconds},
                       {"sampled_frames", forecast->sampled_frames},
                       {"sampled_share", forecast->sampled}};
        fmt::print("{}\n", all.dump(2));
        return kExitDone;
    }
    const std::uint32_t todo = forecast->frames - forecast->frames_done;
    fmt::print("{}: {} frame{} to do{}: about {} from {}, in about {}\n", options.output.string(), todo,
               todo == 1 ? "" : "s",
               forecast->frames_done > 0 ? fmt::format(" ({} there already)", forecast->frames_done) : "",
               describeBytes(std::uint64_t(forecast->bytes)), describeBytes(forecast->input_bytes),
               describeSeconds(forecast->seconds));
    if (todo > 0)
        fmt::print("  from {:.0f} % of the bricks of frame{} {}; nothing was written\n",
                   100 * forecast->sampled, forecast->sampled_frames.size() == 1 ? "" : "s",
                   fmt::join(forecast->sampled_frames, ", "));
    return kExitDone;
}

int runWatch(const ConvertArguments& arguments, const ConversionOptions& options) {
    if (options.inputs.size() > 2)
        return reportError("convert", {ErrorCode::kInvalid,
                                       "--watch takes one folder and one pattern (quoted, or the shell makes "
                                       "it many), then the dataset"});
    WatchOptions watch;
    watch.folder = options.inputs[0];
    if (options.inputs.size() > 1) watch.pattern = options.inputs[1];
    watch.settle = std::chrono::duration<double>(arguments.settle.value_or(2));
    if (arguments.idle) watch.idle = std::chrono::duration<double>(*arguments.idle);
    watch.until_frame = arguments.until_frame;
    watch.tell = [](const std::string& line) { fmt::print(stderr, "brickyard convert: {}\n", line); };
    const auto report = watchFrames(watch, options);
    if (!report) return reportError("convert", report.error());
    if (report->stopped) return reportStopped(fmt::format("{} frames were taken", report->converted));
    if (report->failed > 0)
        return reportError("convert",
                           {ErrorCode::kCorrupt, fmt::format("{}: {} frames could not be taken; see above",
                                                             watch.folder.string(), report->failed)});
    if (arguments.json)
        fmt::print("{}\n", Json{{"dataset", validUtf8(options.output.string())},
                                {"frames_converted", report->converted}}
                               .dump(2));
    else
        fmt::print("{}: {} frames taken from {}\n", options.output.string(), report->converted,
                   watch.folder.string());
    return kExitDone;
}

int runConvert(const ConvertArguments& arguments) {
    keepFreedMemory();
    ConversionOptions options;
    options.inputs.assign(arguments.paths.begin(), arguments.paths.end() - 1);
    options.output = arguments.paths.back();
    options.channels = splitNames(arguments.channels);
    // Checked when the command line was parsed.
    if (!arguments.frames.empty()) options.frames = *FrameSet::parse(arguments.frames);
    for (const std::string& text : arguments.errors) {
        const auto [name, error] = *parseErrorRequest(text);
        if (name.empty())
            options.max_error = error;
        else
            options.channel_errors[name] = error;
    }
    options.brick_edge = arguments.brick.value_or(arguments.compact ? kCompactBrickEdge : kDefaultBrickEdge);
    options.drafts = !arguments.compact;
    if (!arguments.memory.empty()) options.memory_bytes = *parseSize(arguments.memory);
    InputOptions raw;
    applyRawOptions(arguments.raw, raw);
    options.raw = raw.raw;
    options.name = raw.name;
    options.raw_voxel_size = raw.raw_voxel_size;
    options.jobs = arguments.jobs;
    options.nonfinite = arguments.nonfinite == "zero"    ? NonFinite::kZero
                        : arguments.nonfinite == "clamp" ? NonFinite::kClamp
                                                         : NonFinite::kReject;
    options.existing = arguments.append      ? ExistingDataset::kAppend
                       : arguments.overwrite ? ExistingDataset::kOverwrite
                                             : ExistingDataset::kContinue;
    options.note = [](const std::string& note) { fmt::print(stderr, "brickyard convert: {}\n", note); };
    options.settle = std::chrono::duration<double>(arguments.settle.value_or(0));
    const StopSignal listening;
    options.stop = [] { return StopSignal::received() != 0; };
    if (arguments.watch) return runWatch(arguments, options);
    if (arguments.dry_run) return runForecast(arguments, options);
    const auto report = convert(options);
    if (!report) return reportError("convert", report.error());
    if (report->stopped)
        return reportStopped(arguments.overwrite ? fmt::format("{} is as it was", options.output.string())
                                                 : fmt::format("{} of {} frames are done",
                                                               report->frames.size(), report->planned));
    printReport(arguments, options.output, *report);
    return kExitDone;
}

void addProbeCommand(CLI::App& app, int& status) {
    struct Arguments {
        std::string file;
        std::vector<std::string> channels;
        std::uint64_t memory = 0;
        std::int64_t seconds = 0;
    };
    const auto arguments = std::make_shared<Arguments>();
    CLI::App* command = app.add_subcommand(kProbeCommand, "Read one .vdb file under limits")->group("");
    command->add_option("file", arguments->file)->required();
    command->add_option("--channel", arguments->channels)->allow_extra_args(false);
    command->add_option("--memory", arguments->memory);
    command->add_option("--seconds", arguments->seconds);
    command->callback([arguments, &status] {
        status = runVdbProbe(arguments->file, arguments->channels,
                             {arguments->memory, std::chrono::seconds(arguments->seconds)});
    });
}

void addWatchOptions(CLI::App& command, ConvertArguments& arguments, CLI::Option* overwrite) {
    const CLI::Range seconds(0.0, 1e9);
    command
        .add_option("--settle", arguments.settle,
                    "Take a file when its size and time have not changed for so long;\n"
                    "default 0, with --watch 2")
        ->check(seconds)
        ->type_name("SECONDS");
    CLI::Option* watch =
        command
            .add_flag(
                "--watch", arguments.watch,
                "Follow a simulation: --watch DIR [PATTERN] OUT.bricks takes each new frame of DIR when it\n"
                "is complete, until interrupted, --until-frame or --idle")
            ->excludes(overwrite);
    command.add_option("--until-frame", arguments.until_frame, "End --watch when this frame is taken")
        ->needs(watch)
        ->type_name("N");
    command.add_option("--idle", arguments.idle, "End --watch when nothing has changed for so long")
        ->check(seconds)
        ->needs(watch)
        ->type_name("SECONDS");
    command
        .add_flag("--dry-run", arguments.dry_run,
                  "Write nothing: predict size and time from a sample of the first, middle and last frame")
        ->excludes(watch);
}

}  // namespace

void addConvertCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<ConvertArguments>();
    CLI::App* command = app.add_subcommand("convert", "Convert volume files to a dataset");
    command
        ->add_option(
            "paths", arguments->paths,
            "INPUT... OUT: OpenVDB or NRRD files, or raw dumps, then the dataset folder to write, "
            "OUT.bricks.\n"
            "The last digits of a file's name are its frame number; files of one number make one frame.\n"
            "A sequence may be a quoted pattern: 'plume.%04d.vdb', 'plume.####.vdb', 'plume.$F4.vdb' or\n"
            "'plume.*.vdb' is every file there is of it")
        ->required()
        ->expected(2, 1 << 24)
        ->type_name("PATH");
    command
        ->add_option("--frames", arguments->frames,
                     "Only these frames, for example 10-19 or 1,5,10-20:2. Frames that the dataset has\n"
                     "beside them are left alone: several machines may convert a part each")
        ->type_name("LIST")
        ->check([](const std::string& text) {
            const auto parsed = FrameSet::parse(text);
            return parsed ? std::string() : parsed.error().message;
        });
    command->add_option("--channel", arguments->channels, "Only these grids, separated by commas")
        ->type_name("A,B");
    command
        ->add_option(
            "--error", arguments->errors,
            "Largest error of a value, for all floating channels or (NAME=E) for one; default 0, exact")
        ->allow_extra_args(false)
        ->type_name("[NAME=]E")
        ->check([](const std::string& text) {
            const auto parsed = parseErrorRequest(text);
            return parsed ? std::string() : parsed.error().message;
        });
    command
        ->add_option("--brick", arguments->brick,
                     "Cells per brick edge: 8, 16, 32 or 64; default 16, with --compact 32")
        ->check(CLI::IsMember({8, 16, 32, 64}))
        ->type_name("N");
    command->add_flag(
        "--compact", arguments->compact,
        "For storage: larger bricks and no drafts make files 10 to 20 % smaller, but a picture that may\n"
        "err, or is taken close by, streams more");
    command
        ->add_option("--memory", arguments->memory,
                     "What the whole conversion may take, for example 512M; default some 1G")
        ->type_name("SIZE")
        ->check([](const std::string& text) {
            const auto parsed = parseSize(text);
            return parsed ? std::string() : parsed.error().message;
        });
    command->add_option("--jobs", arguments->jobs, "Threads; default one per processor")
        ->check(CLI::Range(1u, 1024u))
        ->type_name("N");
    command
        ->add_option("--nonfinite", arguments->nonfinite,
                     "What becomes of NaN and infinity: reject, zero or clamp")
        ->check(CLI::IsMember({"reject", "zero", "clamp"}))
        ->type_name("HOW")
        ->capture_default_str();
    addRawOptions(*command, arguments->raw);
    CLI::Option* append =
        command->add_flag("--append", arguments->append, "Add new frames to an existing dataset");
    CLI::Option* overwrite = command
                                 ->add_flag("--overwrite", arguments->overwrite,
                                            "Replace an existing dataset, in one step at the end")
                                 ->excludes(append);
    addWatchOptions(*command, *arguments, overwrite);
    command->add_flag("--json", arguments->json, "Print a JSON object on stdout");
    command->callback([arguments, &status] { status = runConvert(*arguments); });
    addProbeCommand(app, status);
}

}  // namespace brickyard

// `brickyard bench`: chooses benchmarks, finds their data, prints what they measured.
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "core/brick_shape.h"
#include "core/io_error.h"
#include "core/printable_name.h"
#include "tools/bench/benchmark.h"
#include "tools/bench/mode_groups.h"
#include "tools/bench/scratch_folder.h"
#include "tools/command.h"

namespace brickyard {
namespace {

struct Benchmark {
    const char* name;
    const char* what;  // one line of the help
    Result<nlohmann::json> (*run)(const BenchOptions& options);
    bool asked_only = false;  // runs only where it is named: it takes minutes, or thousands of sockets
};

constexpr Benchmark kBenchmarks[] = {
    {"render", "speed at equal error, beside NanoVDB, a plain cell walk and vdb_render", benchRender},
    {"trade", "what error costs in bytes and seconds; whether estimates and bounds hold", benchTrade},
    {"pay", "what each feature of a scene costs", benchPay},
    {"stream", "picture by bytes for our order of pages, others and an oracle", benchStream},
    {"fly", "hits, bytes and memory of a flight through a medium at a constant cache", benchFly},
    {"zoom", "what flickers in a slow zoom, of the picture's levels, samples and noise", benchZoom},
    {"convert", "seconds and bytes of the converter, beside nanovdb_convert and zstd", benchConvert},
    {"codec", "bytes and speed of the brick codec, beside zfp, Blosc and zstd at equal error", benchCodec},
#ifdef BRICKYARD_WITH_SERVER
    {"viewers", "a server with many viewers, and with many connections that do nothing", benchViewers, true},
    {"first-picture", "seconds to a picture over a far network, beside a client that finds its own pages",
     benchFirstPicture, true},
    {"fairness", "viewers beside a greedy client; what a slow one gets of a wish that is replaced",
     benchFairness, true},
#endif
};

struct BenchArguments {
    std::vector<std::string> names;
    std::string data, output = ".";
    std::uint32_t size = 512;
    unsigned repeats = 5;
    int brick = kDefaultBrickEdge;
    BenchOptions passed{};  // what goes to the benchmarks as it is
    bool json = false;
};

// The caches beside the checkout where they are, else the three frames that come with it.
std::filesystem::path findData(const std::string& asked) {
    if (!asked.empty()) return asked;
    const std::filesystem::path checkout = BRICKYARD_SOURCE_DIR;
    const std::filesystem::path beside = checkout.parent_path() / "shared" / "data";
    std::error_code ignored;
    return std::filesystem::is_directory(beside, ignored) ? beside : checkout / "tests" / "data" / "plume";
}

Result<void> checkFolders(const BenchOptions& options) {
    std::error_code ignored;
    if (!std::filesystem::is_directory(options.data, ignored))
        return fail(
            ErrorCode::kNotFound,
            fmt::format("--data {}: no such folder; name one that holds .vdb files", options.data.string()));
    if (!std::filesystem::is_directory(options.output, ignored))
        return fail(ErrorCode::kNotFound,
                    fmt::format("--output {}: no such folder; make it first", options.output.string()));
    return {};
}

Result<nlohmann::json> runAll(const std::vector<const Benchmark*>& chosen, const BenchArguments& arguments) {
    const auto scratch = ScratchFolder::create();
    if (!scratch) return tl::unexpected(scratch.error());
    BenchOptions options = arguments.passed;
    options.data = findData(arguments.data);
    options.output = arguments.output;
    options.size = arguments.size;
    options.repeats = arguments.repeats;
    options.brick_edge = arguments.brick;
    options.print = [&](const std::string& text) {
        if (!arguments.json) fmt::print("{}\n", text);
        std::fflush(stdout);
    };
    options.progress = [terminal = ::isatty(STDERR_FILENO) != 0](const std::string& line) {
        if (terminal) fmt::print(stderr, "brickyard bench: {}\n", line);
    };
    if (Result<void> checked = checkFolders(options); !checked) return tl::unexpected(checked.error());
    const unsigned processors = std::max(std::thread::hardware_concurrency(), 1u);
    options.print(fmt::format("Data: {}; {} processors; pictures of {} x {}; medians of {}",
                              options.data.string(), processors, options.size, options.size,
                              options.repeats));

    nlohmann::json all{{"data", validUtf8(options.data.string())},
                       {"processors", processors},
                       {"size", options.size},
                       {"repeats", options.repeats}};
    for (const Benchmark* benchmark : chosen) {
        // Each begins with an empty folder, so that none depends on which ran before.
        options.scratch = (*scratch)->path() / benchmark->name;
        std::error_code error;
        if (!std::filesystem::create_directory(options.scratch, error))
            return ioError("create", options.scratch, error.value());
        Result<nlohmann::json> figures = benchmark->run(options);
        if (!figures)
            return fail(figures.error().code,
                        fmt::format("{}: {}", benchmark->name, figures.error().message));
        all[benchmark->name] = std::move(*figures);
    }
    return all;
}

int runBench(const BenchArguments& arguments) {
    std::vector<const Benchmark*> chosen;
    for (const Benchmark& benchmark : kBenchmarks)
        if (arguments.names.empty() ? !benchmark.asked_only
                                    : std::find(arguments.names.begin(), arguments.names.end(),
                                                benchmark.name) != arguments.names.end())
            chosen.push_back(&benchmark);
    const Result<nlohmann::json> figures = runAll(chosen, arguments);
    if (!figures) return reportError("bench", figures.error());
    if (arguments.json) fmt::print("{}\n", figures->dump());
    return kExitDone;
}

}  // namespace

void addBenchCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<BenchArguments>();
    CLI::App* command = app.add_subcommand("bench", "Measure speed, error and bytes, beside other programs");
    std::vector<std::string> names;
    std::string footer = "Benchmarks:";
    for (const Benchmark& benchmark : kBenchmarks) {
        names.push_back(benchmark.name);
        footer += fmt::format("\n  {:<15}{}{}", benchmark.name, benchmark.what,
                              benchmark.asked_only ? " (only where it is named)" : "");
    }
    command
        ->add_option("NAME", arguments->names,
                     fmt::format("Which: {}; where none is named, all up to codec", fmt::join(names, ", ")))
        ->check(CLI::IsMember(names))
        ->type_name("");
    command
        ->add_option(
            "--data", arguments->data,
            "Folder of caches, laid out as ../shared/data, or any that holds .vdb files; without it\n"
            "../shared/data beside the checkout, else the checkout's tests/data/plume")
        ->type_name("DIR");
    command->add_option("--output", arguments->output, "Folder for charts and tables")
        ->type_name("DIR")
        ->capture_default_str();
    command
        ->add_option(
            "--size", arguments->size,
            "Pixels a side of each picture; of convert, voxels a side of its raw dump (2048: 16 GiB)")
        ->check(CLI::Range(8u, 4096u))
        ->type_name("N")
        ->capture_default_str();
    command
        ->add_option("--repeat", arguments->repeats, "Times that each timed run is repeated; medians count")
        ->check(CLI::Range(1u, 1000u))
        ->type_name("N")
        ->capture_default_str();
    const std::vector<std::string> modes(std::begin(kModeGroups), std::end(kModeGroups));
    command
        ->add_option("--modes", arguments->passed.modes,
                     fmt::format("Of trade: these options alone: {}", fmt::join(modes, ", ")))
        ->delimiter(',')
        ->check(CLI::IsMember(modes))
        ->type_name("NAME,NAME");
    command->add_option("--brick", arguments->brick, "Of codec: cells per brick edge: 8, 16 or 32")
        ->check(CLI::IsMember({8, 16, 32}))
        ->type_name("N")
        ->capture_default_str();
#ifdef BRICKYARD_WITH_SERVER
    BenchOptions& passed = arguments->passed;
    const auto number = [&](const char* name, auto& value, double least, double most, const char* what) {
        command->add_option(name, value, what)
            ->check(CLI::Range(least, most))
            ->type_name("N")
            ->capture_default_str();
    };
    number("--viewers", passed.viewers, 1, 100'000, "Of viewers: how many stream");
    number("--idle", passed.idle, 0, 1'000'000, "Of viewers: connections that do nothing");
    number("--seconds", passed.seconds, 0.2, 86'400,
           "Of viewers: how long; each part of fairness has a sixth");
    number("--wish-kib", passed.wish_kib, 1, 65'536, "Of viewers and fairness: KiB that each wish asks for");
    number("--normal", passed.normal, 1, 10'000, "Of fairness: viewers beside the greedy client");
    number("--delay-ms", passed.delay_ms, 0, 10'000, "Of first-picture: a round trip, half of it each way");
    number("--mbit", passed.mbit, 0.1, 10'000, "Of first-picture and fairness: a slow network's Mbit/s");
#endif
    command->add_flag("--json", arguments->json, "One JSON object on stdout and nothing else");
    command->footer(footer +
                    "\nDatasets are converted into a temporary folder, which is removed afterwards.");
    command->callback([arguments, &status] { status = runBench(*arguments); });
}

}  // namespace brickyard

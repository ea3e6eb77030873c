// `brickyard verify`: is a dataset what was written, and is it what its source says?
#include <fmt/format.h>

#include <cstdio>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "core/printable_name.h"
#include "tools/command.h"
#include "tools/dataset_check.h"
#include "tools/progress_line.h"
#ifdef BRICKYARD_WITH_OPENVDB
#include "tools/raw_arguments.h"
#include "tools/source_check.h"
#endif
#include "tools/worker_pool.h"

namespace brickyard {
namespace {

using Json = nlohmann::ordered_json;

struct VerifyArguments {
    std::string dataset;
    std::vector<std::string> against;
#ifdef BRICKYARD_WITH_OPENVDB
    RawArguments raw;
#endif
    unsigned jobs = 0;
    bool json = false;
};

Json describeFault(const CheckFault& fault) {
    Json json{{"file", validUtf8(fault.file)}};
    if (!fault.channel.empty()) json["channel"] = fault.channel;
    if (!fault.node.empty()) json["page"] = fault.node;
    if (fault.end > fault.begin) json["bytes"] = {fault.begin, fault.end};
    json["message"] = validUtf8(fault.message);
    return json;
}

#ifdef BRICKYARD_WITH_OPENVDB
Json describeSource(const SourceReport& report) {
    Json json{{"frames", report.frames},          {"channels", report.channels},
              {"voxels_compared", report.voxels}, {"regions_compared", report.regions},
              {"points_compared", report.points}, {"largest_point_deviation", report.worst_point},
              {"faults", report.fault_count},     {"fault_messages", report.faults}};
    for (const WorstVoxel& worst : report.worst_of_channels) {
        Json& voxel = json["worst_voxels"].emplace_back();
        voxel = {
            {"channel", worst.channel},     {"frame", worst.frame},   {"index", {worst.x, worst.y, worst.z}},
            {"component", worst.component}, {"stored", worst.stored}, {"source", worst.source},
            {"deviation", worst.deviation}};
    }
    return json;
}

void printSource(const SourceReport& report) {
    for (const std::string& fault : report.faults) fmt::print("{}\n", fault);
    if (report.fault_count > report.faults.size())
        fmt::print("... and {} more\n", report.fault_count - report.faults.size());
    fmt::print(
        "against the source: {} frames, {} channels, {} voxels and {} regions of one value compared{}\n",
        report.frames, report.channels, report.voxels, report.regions,
        report.points > 0 ? fmt::format(", {} points against OpenVDB's sampler (largest deviation {:.3g})",
                                        report.points, report.worst_point)
                          : "");
    bool exact = report.fault_count == 0;
    for (const WorstVoxel& worst : report.worst_of_channels) {
        if (!(worst.deviation > 0)) continue;
        exact = false;
        fmt::print("worst voxel of '{}': frame {}, ({}, {}, {}): {} here, {} in the source, {:.3g} off\n",
                   printableName(worst.channel), worst.frame, worst.x, worst.y, worst.z, worst.stored,
                   worst.source, worst.deviation);
    }
    if (exact) fmt::print("every voxel is bit-exact\n");
}
#endif

int runVerify(const VerifyArguments& arguments) {
    WorkerPool pool(arguments.jobs);
    ProgressLine progress;
    const CheckReport report = checkDataset(
        arguments.dataset, pool.parallelFor(), [&](std::size_t done, std::size_t total, std::uint64_t bytes) {
            progress.show(fmt::format("frame {} of {}", done, total), double(done) / double(total), bytes);
        });
    progress.clear();
    Json json{{"dataset", validUtf8(arguments.dataset)},
              {"ok", report.faults.empty()},
              {"frames", report.frames},
              {"channels", report.channels},
              {"tree_blocks", report.blocks},
              {"bricks", report.bricks},
              {"bytes", report.bytes},
              {"faults", Json::array()}};
    std::set<std::string> files;
    for (const CheckFault& fault : report.faults) {
        json["faults"].push_back(describeFault(fault));
        files.insert(fault.file);
        // The first is told on stderr at the end.
        if (!arguments.json && &fault != &report.faults.front()) fmt::print("{}\n", fault.message);
    }

    std::uint64_t source_faults = 0;
    std::optional<Error> source_error;
#ifdef BRICKYARD_WITH_OPENVDB
    if (report.faults.empty() && !arguments.against.empty()) {
        InputOptions reading;
        applyRawOptions(arguments.raw, reading);
        if (const auto source =
                checkAgainst(arguments.dataset, arguments.against, pool.parallelFor(), 100'000, reading)) {
            source_faults = source->fault_count;
            json["against"] = describeSource(*source);
            if (!arguments.json) printSource(*source);
        } else {
            source_error = source.error();
        }
    }
#else
    if (!arguments.against.empty())
        source_error = Error{ErrorCode::kUnsupported,
                             "--against is left out of this build; configure with -DBRICKYARD_OPENVDB=ON"};
#endif
    if (source_error) json["ok"] = false;
    if (source_faults > 0) json["ok"] = false;
    if (arguments.json) fmt::print("{}\n", json.dump(2));

    if (!report.faults.empty()) {
        const std::size_t more = report.faults.size() - 1;
        Error error{ErrorCode::kCorrupt, report.faults.front().message};
        if (more > 0)
            error.message += fmt::format(" (and {} more fault{} in {} file{})", more, more == 1 ? "" : "s",
                                         files.size(), files.size() == 1 ? "" : "s");
        return reportError("verify", error);
    }
    if (source_error) return reportError("verify", *source_error);
    if (source_faults > 0)
        return reportError(
            "verify",
            {ErrorCode::kCorrupt, fmt::format("{}: differs from its source in {} places; convert it again",
                                              arguments.dataset, source_faults)});
    if (!arguments.json)
        fmt::print("{}: sound: {} frame{}, {} bricks, {}\n", arguments.dataset, report.frames,
                   report.frames == 1 ? "" : "s", report.bricks, describeBytes(report.bytes));
    return kExitDone;
}

}  // namespace

void addVerifyCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<VerifyArguments>();
    CLI::App* command =
        app.add_subcommand("verify", "Check every byte of a dataset, or compare it with its source");
    command->add_option("dataset", arguments->dataset, "The dataset folder")
        ->required()
        ->type_name("DATASET");
    command
        ->add_option(
            "--against", arguments->against,
            "The files it was made of: compares every voxel, and random points with OpenVDB's sampler")
        ->expected(1, 1 << 24)
        ->type_name("INPUT...");
#ifdef BRICKYARD_WITH_OPENVDB
    addRawOptions(*command, arguments->raw);
#endif
    command->add_option("--jobs", arguments->jobs, "Threads; default one per processor")
        ->check(CLI::Range(1u, 1024u))
        ->type_name("N");
    command->add_flag("--json", arguments->json, "Print a JSON object on stdout");
    command->callback([arguments, &status] { status = runVerify(*arguments); });
}

}  // namespace brickyard

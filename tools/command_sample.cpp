// `brickyard sample`: the field's value at positions from stdin, so that anybody can check it against their
// own reader.
#include <fmt/format.h>

#include <cstdio>
#include <iostream>
#include <optional>
#include <sstream>

#include "core/dataset.h"
#include "tools/command.h"
#include "tools/field_reader.h"

namespace brickyard {
namespace {

struct SampleArguments {
    std::string dataset, channel, space = "index";
    std::optional<std::uint32_t> frame;
    int level = 0;
};

int runSample(const SampleArguments& arguments) {
    const auto dataset = Dataset::open(arguments.dataset);
    if (!dataset) return reportError("sample", dataset.error());
    if (dataset->manifest().frames().empty())
        return reportError("sample",
                           {ErrorCode::kNotFound, arguments.dataset + ": has no frames; convert some"});
    const auto store = dataset->openFrame(arguments.frame.value_or(dataset->manifest().frames(0).frame()));
    if (!store) return reportError("sample", store.error());
    const auto channel = findChannel(**store, arguments.channel);
    if (!channel) return reportError("sample", channel.error());
    const FieldReader reader(*store, *channel);

    std::string line;
    for (std::uint64_t number = 1; std::getline(std::cin, line); ++number) {
        std::istringstream words(line);
        std::array<std::string, 3> text;
        std::string rest;
        glm::dvec3 position(0);
        bool valid = bool(words >> text[0] >> text[1] >> text[2]) && !(words >> rest);
        for (int a = 0; valid && a < 3; ++a) {
            const std::string& word = text[std::size_t(a)];
            char* end = nullptr;
            position[a] = std::strtod(word.c_str(), &end);
            valid = end == word.c_str() + word.size();
        }
        if (!valid)
            return reportError(
                "sample", {ErrorCode::kInvalid, fmt::format("stdin, line {}: not a position; write three "
                                                            "numbers, x y z",
                                                            number)});
        if (arguments.space == "world") position = reader.indexToWorld().inversePoint(position);
        const auto value = reader.sample(position, arguments.level);
        if (!value) return reportError("sample", value.error());
        for (int c = 0; c < reader.components(); ++c)
            fmt::print("{}{:.17g}", c > 0 ? " " : "", (*value)[std::size_t(c)]);
        fmt::print("\n");
    }
    return kExitDone;
}

}  // namespace

void addSampleCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<SampleArguments>();
    CLI::App* command =
        app.add_subcommand("sample", "Print a channel's value at positions \"x y z\" read from stdin");
    command->add_option("dataset", arguments->dataset, "The dataset folder")
        ->required()
        ->type_name("DATASET");
    command->add_option("--channel", arguments->channel, "Which channel")->required()->type_name("NAME");
    command->add_option("--frame", arguments->frame, "Which frame; default the first")->type_name("F");
    command->add_option("--level", arguments->level, "Which level: 0 is the full resolution")
        ->check(CLI::Range(0, int(kMaxLevel)))
        ->type_name("L")
        ->capture_default_str();
    command->add_option("--space", arguments->space, "What positions mean: index or world")
        ->check(CLI::IsMember({"index", "world"}))
        ->type_name("SPACE")
        ->capture_default_str();
    command->callback([arguments, &status] { status = runSample(*arguments); });
}

}  // namespace brickyard

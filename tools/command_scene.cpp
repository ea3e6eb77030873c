// `brickyard scene`: a scene file to begin with, from what a dataset holds.
#include <fmt/format.h>

#include <fstream>
#include <optional>

#include "core/dataset.h"
#include "tools/command.h"
#include "tools/output_file.h"
#include "tools/scene_proposal.h"
#include "tools/scene_text.h"

namespace brickyard {
namespace {

struct SceneArguments {
    std::string dataset, output;
    std::optional<std::uint32_t> frame;
};

// Most are fullest in the middle of their time, where a plume has grown and a fire still burns.
std::uint32_t middleFrame(const Manifest& manifest) {
    return manifest.frames(manifest.frames_size() / 2).frame();
}

Result<void> writeText(const std::string& text, const std::string& name) {
    OutputFile file{std::filesystem::path(name)};
    std::ofstream out(file.temporary(), std::ios::binary);
    out << text;
    out.close();
    if (!out)
        return fail(ErrorCode::kIo, fmt::format("-o {}: cannot be written; does its folder exist?", name));
    return file.commit();
}

Result<void> runScene(const SceneArguments& arguments) {
    const auto dataset = Dataset::open(arguments.dataset);
    if (!dataset) return tl::unexpected(dataset.error());
    if (dataset->manifest().frames().empty())
        return fail(ErrorCode::kNotFound, fmt::format("{}: has no frames; convert some", arguments.dataset));
    const std::uint32_t frame = arguments.frame.value_or(middleFrame(dataset->manifest()));
    const Result<SceneProposal> proposal = proposeScene(*dataset, frame);
    if (!proposal) return tl::unexpected(proposal.error());
    const Result<std::string> text = printScene(proposal->scene);
    if (!text) return tl::unexpected(text.error());
    if (!arguments.output.empty()) return writeText(*text, arguments.output);
    fmt::print("{}", *text);
    return {};
}

}  // namespace

void addSceneCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<SceneArguments>();
    CLI::App* command = app.add_subcommand("scene",
                                           "Write a scene that shows a dataset, for `brickyard render "
                                           "--scene`: from its channels and their values");
    command->add_option("dataset", arguments->dataset, "The dataset folder")
        ->required()
        ->type_name("DATASET");
    command->add_option("-o,--output", arguments->output, "The file to write; default stdout")
        ->type_name("FILE.json");
    command->add_option("--frame", arguments->frame, "The frame to look at; default the middle one")
        ->type_name("F");
    command->callback([arguments, &status] {
        const auto run = runScene(*arguments);
        status = run ? int(kExitDone) : reportError("scene", run.error());
    });
}

}  // namespace brickyard

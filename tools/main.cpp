// The `brickyard` command line. Exit status: 0 done, 1 failed, 2 wrong usage; a failure is one line on
// stderr.
#include <fmt/core.h>

#include <algorithm>
#include <cstdio>
#include <exception>
#include <new>
#include <string>

#include "tools/command.h"

namespace brickyard {
namespace {

// A command of the contract, whether or not this build has it.
struct CommandEntry {
    const char* name;
    void (*add)(CLI::App& app, int& status);  // null: left out of this build
    const char* cmake_option;                 // what brings it back; empty for what is never left out
};

// In the order of their use.
constexpr CommandEntry kCommands[] = {
#ifdef BRICKYARD_WITH_OPENVDB
    {"convert", addConvertCommand, "BRICKYARD_OPENVDB"},
#else
    {"convert", nullptr, "BRICKYARD_OPENVDB"},
#endif
    {"info", addInfoCommand, ""},
    {"verify", addVerifyCommand, ""},
#ifdef BRICKYARD_WITH_OPENVDB
    {"export", addExportCommand, "BRICKYARD_OPENVDB"},
#else
    {"export", nullptr, "BRICKYARD_OPENVDB"},
#endif
    {"sample", addSampleCommand, ""},
#ifdef BRICKYARD_WITH_SERVER
    {"serve", addServeCommand, "BRICKYARD_SERVER"},
#else
    {"serve", nullptr, "BRICKYARD_SERVER"},
#endif
#ifdef BRICKYARD_WITH_CLIENT
    {"scene", addSceneCommand, "BRICKYARD_CLIENT"},
    {"render", addRenderCommand, "BRICKYARD_CLIENT"},
    {"bake", addBakeCommand, "BRICKYARD_CLIENT"},
    {"compare", addCompareCommand, "BRICKYARD_CLIENT"},
#else
    {"scene", nullptr, "BRICKYARD_CLIENT"},
    {"render", nullptr, "BRICKYARD_CLIENT"},
    {"bake", nullptr, "BRICKYARD_CLIENT"},
    {"compare", nullptr, "BRICKYARD_CLIENT"},
#endif
#ifdef BRICKYARD_WITH_OPENVDB
    {"synth", addSynthCommand, "BRICKYARD_OPENVDB"},
#else
    {"synth", nullptr, "BRICKYARD_OPENVDB"},
#endif
#if defined(BRICKYARD_WITH_BENCH)
    {"bench", addBenchCommand, "BRICKYARD_BENCH"},
#elif !defined(BRICKYARD_WITH_OPENVDB)
    {"bench", nullptr, "BRICKYARD_OPENVDB"},
#elif !defined(BRICKYARD_WITH_CLIENT)
    {"bench", nullptr, "BRICKYARD_CLIENT"},
#else
    {"bench", nullptr, "BRICKYARD_BENCH"},
#endif
};

// Takes any arguments, so that the answer is the missing option and not a complaint about the first of them.
void addMissingCommand(CLI::App& app, const CommandEntry& entry, int& status) {
    const std::string why = fmt::format("left out of this build; configure with -D{}=ON", entry.cmake_option);
    CLI::App* command = app.add_subcommand(entry.name, fmt::format("({})", why));
    command->allow_extras();
    command->callback([&status, &entry, why] {
        const Error error{ErrorCode::kUnsupported, why};
        status = reportError(entry.name, error);
    });
}

// CLI11's message on one line, and where to look next.
int reportUsage(const CLI::App& app, const CLI::ParseError& error) {
    std::string path = "brickyard";
    for (const CLI::App* chosen : app.get_subcommands()) path += " " + chosen->get_name();
    std::string message = error.what();
    std::replace(message.begin(), message.end(), '\n', ' ');
    message.erase(message.find_last_not_of(" .") + 1);
    fmt::print(stderr, "{}: {}; see `{} --help`\n", path, message, path);
    return kExitUsage;
}

int run(int argc, char** argv) {
    CLI::App app("Brickyard: an out-of-core streaming voxel server", "brickyard");
    app.set_version_flag("--version", "brickyard " BRICKYARD_VERSION);
    app.require_subcommand(1);
    app.footer(
        "`brickyard COMMAND --help` describes a command.\nExit status: 0 done, 1 failed, 2 wrong usage.");
    int status = kExitDone;
    for (const CommandEntry& entry : kCommands) {
        if (entry.add)
            entry.add(app, status);
        else
            addMissingCommand(app, entry, status);
    }

    try {
        app.parse(argc, argv);
    } catch (const CLI::CallForHelp& help) {
        return app.exit(help);
    } catch (const CLI::CallForAllHelp& help) {
        return app.exit(help);
    } catch (const CLI::CallForVersion& version) {
        return app.exit(version);
    } catch (const CLI::ParseError& error) {
        return reportUsage(app, error);
    }
    return status;
}

}  // namespace
}  // namespace brickyard

int main(int argc, char** argv) {
    // Failures are values in our own code; what still throws is memory and libraries.
    try {
        return brickyard::run(argc, argv);
    } catch (const std::bad_alloc&) {
        std::fputs("brickyard: out of memory; give it less to do at once, or more memory\n", stderr);
    } catch (const std::exception& error) {
        fmt::print(stderr, "brickyard: unexpected failure: {}; please report it\n", error.what());
    }
    return brickyard::kExitFailed;
}

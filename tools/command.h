// The shape of a `brickyard` command: it adds itself to the command line, and runs when it was chosen.
#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <vector>

#include "core/result.h"

namespace brickyard {

// Exit status: 0 done, 1 failed, 2 wrong usage.
enum ExitStatus { kExitDone = 0, kExitFailed = 1, kExitUsage = 2 };

// Each adds one subcommand; its callback stores the exit status in `status`.
void addConvertCommand(CLI::App& app, int& status);
void addInfoCommand(CLI::App& app, int& status);
void addVerifyCommand(CLI::App& app, int& status);
void addExportCommand(CLI::App& app, int& status);
void addSampleCommand(CLI::App& app, int& status);
void addServeCommand(CLI::App& app, int& status);
void addRenderCommand(CLI::App& app, int& status);
void addBakeCommand(CLI::App& app, int& status);
void addSceneCommand(CLI::App& app, int& status);
void addCompareCommand(CLI::App& app, int& status);
void addSynthCommand(CLI::App& app, int& status);
void addBenchCommand(CLI::App& app, int& status);

// Prints "brickyard COMMAND: message" on stderr and gives kExitFailed.
int reportError(const std::string& command, const Error& error);

// "density,flame": the names between commas; empty ones are left out.
std::vector<std::string> splitNames(const std::string& text);

// "512M", "1.5G", "65536": bytes, powers of 1024. Errors: kInvalid.
Result<std::uint64_t> parseSize(const std::string& text);

}  // namespace brickyard

// The options that say what a raw dump is, for every command that reads one.
#pragma once

#include "tools/command.h"
#include "tools/importers/input_file.h"

namespace brickyard {

struct RawArguments {
    std::string layout, name, voxel_size;
};

// Adds --raw, --voxel-size and --name, checked as they are parsed.
void addRawOptions(CLI::App& command, RawArguments& arguments);

// REQUIRES: arguments that were checked.
void applyRawOptions(const RawArguments& arguments, InputOptions& options);

}  // namespace brickyard

// Our own reader of .vdb files held against libopenvdb, field by field and bit by bit.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace brickyard {

struct ComparisonEffort {
    int random_boxes = 200;
    // Boxes of the active box that are compared whole; beyond them samples must do.
    int most_boxes = 2000;
};

// What differs between what openVdb and readVdb make of `file`, one line each; nothing where all is the same.
// REQUIRES: libopenvdb survives the file.
std::vector<std::string> differencesToOpenVdb(const std::filesystem::path& file,
                                              ComparisonEffort effort = {});

}  // namespace brickyard

// Which file a frame was made of: name, size and time of change. What tells a repeated command from a new
// one, and a file that is still being written from a complete one.
#pragma once

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "core/result.h"
#include "proto/dataset.pb.h"

namespace brickyard {

// Errors: kNotFound, kIo.
Result<SourceFile> describeSource(const std::filesystem::path& file);

std::string sourceKey(const SourceFile& source);

// Of files as they are now; one that is not there has a key of its own.
std::vector<std::string> sourceKeys(const std::vector<std::filesystem::path>& files);

// Sorted, so that the order of a frame's files says nothing.
template <class Sources>
std::vector<std::string> sourceKeys(const Sources& sources) {
    std::vector<std::string> keys;
    for (const SourceFile& source : sources) keys.push_back(sourceKey(source));
    std::sort(keys.begin(), keys.end());
    return keys;
}

}  // namespace brickyard

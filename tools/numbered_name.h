// File names of sequences: "frame.%04d.png". Pure functions, any thread.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

namespace brickyard {

// "frame.%04d.png" for frame 7 is "frame.0007.png"; a name without a place is itself.
std::filesystem::path numberedName(const std::string& pattern, std::uint32_t frame);
bool hasNumberPlace(const std::string& pattern);

}  // namespace brickyard

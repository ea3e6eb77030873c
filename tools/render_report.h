// What `brickyard render` tells of a picture.
#pragma once

#include <filesystem>

#include "client/renderer.h"

namespace brickyard {

// On stdout: one line for people, or one JSON object; pages that could not be had on stderr. Numbers without
// a guarantee are null in JSON. Gives the exit status.
int reportPicture(const RenderOutcome& outcome, const std::filesystem::path& output, bool json);

}  // namespace brickyard

// The ways that viewers fly, worked out beforehand: at each station a camera and the pages that it sees, so
// that a thousand viewers cost the machine what their connections cost and not what their cameras do.
// Immutable once made: any thread.
#pragma once

#include <vector>

#include "tools/bench/served_subject.h"

namespace brickyard {

inline constexpr std::uint32_t kViewerWidth = 640, kViewerHeight = 480;

struct ViewerStation {
    Camera camera;
    std::vector<DescentStep> steps;  // coarse to fine
};

// A closed way.
struct ViewerPath {
    std::size_t frame = 0;  // in ServedSubject::frames
    std::vector<ViewerStation> stations;
};

// Ways through each of the frames. Errors: those of reading.
Result<std::vector<ViewerPath>> makeViewerPaths(const ServedSubject& subject);

}  // namespace brickyard

// The way of a camera round a medium, into it and back. Pure functions, any thread.
#pragma once

#include "proto/scene.pb.h"

namespace brickyard {

// `part` of the way in [0, 1]: the first third is a full circle at the distance of `framing`, the second goes
// on turning and dives to a fifteenth of it, well inside; the last comes back. It ends where it began.
// `framing` looks at the middle of the medium (frameChannel).
Camera flyCamera(const Camera& framing, double part);

}  // namespace brickyard

// A scene as a person would write it: what is seen first, then what is drawn, then what lights it; short rows
// of numbers on one line. Pure function, any thread.
#pragma once

#include <string>

#include "core/result.h"
#include "proto/scene.pb.h"

namespace brickyard {

// JSON that readScene() takes, ending in a newline. Errors: kInvalid (names that are not UTF-8).
Result<std::string> printScene(const Scene& scene);

}  // namespace brickyard

// An input read to the end, for tests that only want to see how that goes.
#pragma once

#include <vector>

#include "core/result.h"
#include "tools/importers/input_file.h"

namespace brickyard {

// Asks for everything that a converter would: every field's regions from the top down, the boxes in them, the
// info. Gives the errors that reads met.
std::vector<Error> readEverything(const InputContents& contents, int most_boxes);

}  // namespace brickyard

// An input read to the end, for tests that only want to see how that goes.
#pragma once

#include <vector>

#include "core/result.h"
#include "tools/importers/input_file.h"

namespace brickyard {

// Asks for everything that a converter would: of every field the regions from the top down, what is left as
// boxes of 32^3 (at most so many of each field), and the info. Gives the errors that the reads met.
std::vector<Error> readEverything(const InputContents& contents, int most_boxes);

}  // namespace brickyard

// The layout of a raw dump as a user writes it after --raw. Pure function, any thread.
#pragma once

#include <string_view>

#include "core/result.h"
#include "tools/importers/dense_layout.h"

namespace brickyard {

struct RawLayout {
    DenseLayout dense;
    std::uint64_t trailing_bytes = 0;  // behind the samples, not looked at
};

// "128x128x128:uint16", then in any order ":x-fastest" (the default) or ":z-fastest", ":little" (the default)
// or
// ":big", ":skip=BYTES" or ":header=BYTES" in front of the samples, ":trailing=BYTES" behind them. Errors:
// kInvalid: which part is wrong and what could stand there.
Result<RawLayout> parseRawLayout(std::string_view text);

}  // namespace brickyard

#include "tools/bench/benchmark.h"

namespace brickyard {

Result<nlohmann::json> benchTrade(const BenchOptions&) {
    return fail(ErrorCode::kUnsupported, "not written yet");
}

}  // namespace brickyard

#include "tools/bench/benchmark.h"

namespace brickyard {

Result<nlohmann::json> benchPay(const BenchOptions&) {
    return fail(ErrorCode::kUnsupported, "not written yet");
}

}  // namespace brickyard

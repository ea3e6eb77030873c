// The second half of `bench trade`: what each option of a picture costs, and how wrong it makes it.
#pragma once

#include "core/result.h"
#include "tools/bench/benchmark.h"
#include "tools/worker_pool.h"

namespace brickyard {

// Prints a table for each group of options (mode_groups.h) and gives its figures. Errors: those of
// conversions and pictures.
Result<nlohmann::json> tradeModes(const BenchOptions& options, WorkerPool& pool);

}  // namespace brickyard

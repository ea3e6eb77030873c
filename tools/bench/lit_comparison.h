// Our picture with one directional light beside vdb_render's, and both beside a double integral.
#pragma once

#include <nlohmann/json.hpp>

#include "tools/bench/bench_subject.h"
#include "tools/bench/benchmark.h"

namespace brickyard {

// Prints a table of its own. Errors: those of our renderer; a peer that fails is a "skipped" in the object.
Result<nlohmann::json> compareLit(const BenchSubject& subject, const BenchView& view, const ViewTruth& truth,
                                  const BenchOptions& options, WorkerPool& pool);

}  // namespace brickyard

// The views of a channel that are drawn from a StreamTable, and how dense it is in them. Pure functions, any
// thread.
#pragma once

#include <vector>

#include "core/brick_store.h"
#include "core/camera.h"
#include "core/result.h"
#include "proto/dataset.pb.h"
#include "tools/bench/bench_cache.h"

namespace brickyard {

// Far and framing as the other benchmarks have them. Inside: near the middle of the box, along its diagonal,
// because the middle itself may be empty (jets) or opaque (a cloud).
std::vector<BenchView> streamViews(const ChannelFooter& density);

// The density scale at which half of the camera's rays that meet anything have at least this optical depth.
// Errors: those of reading.
Result<double> streamScale(const BrickStore& store, std::uint32_t channel, const PinholeCamera& camera,
                           double median_depth);

}  // namespace brickyard

// Loads the pages of a StreamTable one by one in some order and notes how good the picture is after each.
#pragma once

#include <cstdint>
#include <vector>

#include "client/cpu/page_order.h"
#include "core/brick_store.h"
#include "tools/bench/stream_table.h"

namespace brickyard {

struct StreamPoint {
    std::uint64_t bytes = 0;  // tree blocks and pages so far
    double psnr = 0;          // of alpha, in dB
    double worst = 0;         // largest error of alpha
};

struct StreamRun {
    std::vector<StreamPoint> points;  // bytes rise
    std::uint32_t plans = 0;
    double plan_seconds = 0;  // median of a plan
    // Bytes at the first point of at least `psnr`; 0 where none is.
    std::uint64_t bytesTo(double psnr) const;
};

struct StreamRunOptions {
    double scale = 1;
    double batch_share = 0.125;  // bytes of a batch, of the bytes so far
    double stop_psnr = 60;
};

// The loop draw, plan, load with planPages.
StreamRun runOrder(const StreamTable& table, const BrickStore& store, const PinholeCamera& camera,
                   PageOrder order, const StreamRunOptions& options);

// Knows every brick and the reference, and takes, greedily, the page (at any level below what is drawn, draft
// or whole) that takes most squared error off the picture per byte. At each number of bytes the best of three
// runs: of single pages; of these and all of a node's children together; and of single pages by the error of
// their own parts of the rays.
StreamRun runOracle(const StreamTable& table, const StreamRunOptions& options);

}  // namespace brickyard

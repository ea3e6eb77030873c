// Which nodes a camera sees, coarse to fine, from topology alone: what a server streams to a client that has
// nothing yet, and the order in which it does. Pure function over loaded blocks.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "core/camera.h"
#include "core/page_address.h"
#include "core/result.h"
#include "core/tree_block.h"
#include "proto/dataset.pb.h"

namespace brickyard {

struct DescentStep {
    bool is_block = false;  // a tree block that must come before the nodes in it; `page.node` is then 0
    PageAddress page;
    std::uint32_t bytes = 0;  // stored size
};

struct DescentLimits {
    float pixels_per_voxel = 1;          // stop where a voxel of the node projects to no more than this
    std::uint64_t max_bytes = 1u << 20;  // stop when the steps add up to this
};

// Gives a decoded block of one channel, or an error that ends the descent.
using BlockLoader = std::function<Result<std::shared_ptr<const TreeBlock>>(std::uint32_t block)>;

// Steps for one channel, most wanted first: parents before children, then by the error they are expected to
// remove per byte (RMS^2 of the parent x projected area / bytes). Nodes outside the frustum or the channel's
// active box (plus one sample) are left out. Block 0 is always the first step. Errors: those of the loader.
Result<std::vector<DescentStep>> describeView(const PinholeCamera& camera, const ChannelFooter& channel,
                                              std::uint32_t channel_index, int brick_edge,
                                              const BlockLoader& load, const DescentLimits& limits);

}  // namespace brickyard

// Which nodes a camera sees, coarse to fine, from topology alone: what a server streams to a client that has
// nothing yet, and the order in which it does.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
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

// The steps of one channel, one by one, most wanted first: parents before children, then by the error they
// are expected to remove per byte (RMS^2 of the parent x projected area / bytes). Nodes outside the frustum
// or the channel's active box (plus one sample) are left out. Block 0 is always the first step. One thread at
// a time.
class ViewDescent {
public:
    // `channel` outlives the descent. Errors: kCorrupt (the channel's transform).
    static Result<ViewDescent> create(const PinholeCamera& camera, const ChannelFooter& channel,
                                      std::uint32_t channel_index, int brick_edge, float pixels_per_voxel);
    ViewDescent(ViewDescent&&) noexcept;
    ViewDescent& operator=(ViewDescent&&) noexcept;
    ~ViewDescent();

    // Nothing when there is none left. Loads the blocks that it needs then; the last few it holds. Errors:
    // those of the loader; the descent is over then.
    Result<std::optional<DescentStep>> next(const BlockLoader& load);
    // Of what is still to be looked at. Bounded: a view of very many nodes ends before the finest.
    std::size_t memoryBytes() const;

private:
    class Search;
    explicit ViewDescent(std::unique_ptr<Search> search);
    std::unique_ptr<Search> search_;
};

// The steps until they add up to limits.max_bytes. Errors: those of ViewDescent.
Result<std::vector<DescentStep>> describeView(const PinholeCamera& camera, const ChannelFooter& channel,
                                              std::uint32_t channel_index, int brick_edge,
                                              const BlockLoader& load, const DescentLimits& limits);

}  // namespace brickyard

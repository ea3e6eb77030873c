// All that rays could see of one channel, worked out beforehand: the integral over every stretch of every ray
// from every brick above it. A picture from any set of resident pages is then a sum, so that orders of
// loading can be compared page by page, and an oracle can try each page before it takes one.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "client/paged_channel.h"
#include "core/brick_store.h"
#include "core/camera.h"
#include "core/page_address.h"
#include "core/result.h"

namespace brickyard {

// A node with a brick that a ray meets.
struct StreamNode {
    NodeRef ref;
    NodeKey key;
    std::uint32_t parent = kNoStreamNode;  // stands before it
    std::uint32_t depth = 0;               // nodes above it
    std::uint32_t payload_bytes = 0, draft_bytes = 0;
    // Its stretches: [begin, own_end) its own, [own_end, end) those of nodes below.
    std::uint32_t begin = 0, own_end = 0, end = 0;

    static constexpr std::uint32_t kNoStreamNode = 0xffffffffu;
};

// A part of a ray within one leaf; or within a part of a node where topology alone tells the value.
struct StreamStretch {
    std::uint32_t ray = 0;
    std::uint32_t node = 0;  // the leaf; or the last node with a brick above
    std::uint32_t values =
        0;  // in StreamTable::values: from the root's brick down to the node's, then its draft
    float exact = 0;
    bool is_exact = false;
};

class StreamTable {
public:
    // Reads and decodes every brick that a ray of `camera` meets. `scale` multiplies the field. Errors: those
    // of the store; kCorrupt.
    static Result<StreamTable> create(const BrickStore& store, std::uint32_t channel_index,
                                      const PinholeCamera& camera, double scale);

    const PagedChannel& channel() const { return *channel_; }
    std::uint32_t rayCount() const { return std::uint32_t(first_in_ray_.size() - 1); }
    const std::vector<StreamNode>& nodes() const { return nodes_; }
    const std::vector<StreamStretch>& stretches() const { return stretches_; }
    float value(const StreamStretch& s, std::uint32_t depth) const { return values_[s.values + depth]; }
    // With every page there.
    float reference(const StreamStretch& s) const {
        return s.is_exact ? s.exact : values_[s.values + nodes_[s.node].depth];
    }
    // The node of a page; kNoStreamNode where no ray meets it.
    std::uint32_t find(const NodeRef& ref) const;
    // The stretches of a ray, front to back, and where each ends (world distance).
    std::span<const std::uint32_t> ofRay(std::uint32_t ray) const {
        return {ray_order_.data() + first_in_ray_[ray], first_in_ray_[ray + 1] - first_in_ray_[ray]};
    }
    double endOf(std::uint32_t stretch) const { return double(ends_[stretch]); }

private:
    friend class StreamTableBuilder;
    std::unique_ptr<PagedChannel> channel_;
    std::vector<StreamNode> nodes_;
    std::vector<StreamStretch> stretches_;
    std::vector<float> values_;
    std::vector<float> ends_;
    std::vector<std::uint32_t> ray_order_, first_in_ray_;
    std::vector<std::vector<std::uint32_t>> index_;  // by block, by node
};

}  // namespace brickyard

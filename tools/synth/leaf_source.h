// A sparse field of floats as the blocks of an OpenVDB tree: made again whenever it is asked for, never kept.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace brickyard {

// The leaves of one internal node of 128^3 voxels, in the order of their number in it, (x * 16 + y) * 16 + z.
struct LeafBlock {
    std::array<std::uint64_t, 64> child_mask{};             // bit n: leaf n has active voxels
    std::vector<std::array<std::uint64_t, 8>> value_masks;  // one per leaf; bit (x * 8 + y) * 8 + z
    std::vector<float> values;                              // the active values of all leaves, in that order
};

class LeafSource {
public:
    virtual ~LeafSource() = default;
    // Origins, multiples of 128, of all blocks that may have active voxels; rising by x, then y, then z; each
    // once.
    virtual std::vector<std::array<std::int32_t, 3>> blocks() const = 0;
    // The same leaves each time. Without `with_values` the masks alone. Any thread.
    virtual void fill(const std::array<std::int32_t, 3>& block, bool with_values, LeafBlock& out) const = 0;
};

}  // namespace brickyard

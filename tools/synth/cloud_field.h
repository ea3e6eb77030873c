// Clouds: ellipsoids with ragged edges, scattered over a cube that is mostly empty.
#pragma once

#include "tools/synth/leaf_source.h"

namespace brickyard {

class CloudField final : public LeafSource {
public:
    // As many clouds as have about `voxels` active voxels or somewhat more, within [0, edge_voxels)^3.
    // REQUIRES: edge_voxels in [16, 2^30].
    CloudField(std::int64_t edge_voxels, std::uint64_t voxels, std::uint64_t seed);

    std::size_t cloudCount() const { return clouds_.size(); }
    std::vector<std::array<std::int32_t, 3>> blocks() const override;
    void fill(const std::array<std::int32_t, 3>& block, bool with_values, LeafBlock& out) const override;

private:
    struct Cloud {
        std::array<float, 3> centre, radius;
        std::uint64_t seed;
    };
    bool fillLeaf(const Cloud& cloud, const std::array<std::int32_t, 3>& origin,
                  std::array<float, 512>& values) const;
    bool touches(const Cloud& cloud, const std::array<std::int32_t, 3>& origin, float edge) const;

    std::vector<Cloud> clouds_;
};

}  // namespace brickyard

// The values of one brick, through any source: for programs that want numbers instead of pictures. Blocks
// until they are there.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "client/brick_source.h"
#include "core/brick_shape.h"
#include "core/node_key.h"
#include "core/result.h"

namespace brickyard {

struct BrickValues {
    NodeKey key;  // of the node whose samples these are
    BrickShape shape;
    int components = 1;
    // Component after component, x fastest: components * shape.samples() values at the corners of its cells.
    std::vector<double> samples;

    // Of a corner, each of i, j, k in [0, N].
    double at(int i, int j, int k, int component = 0) const {
        return samples[std::size_t(component) * shape.samples() + shape.sampleAt(i, j, k)];
    }
    // Index coordinates of corner (0, 0, 0); neighbours are stepVoxels() apart.
    std::array<std::int64_t, 3> origin() const {
        const std::int64_t edge = std::int64_t(shape.edge_cells) << key.level;
        return {key.x * edge, key.y * edge, key.z * edge};
    }
    std::int64_t stepVoxels() const { return std::int64_t(1) << key.level; }
};

// The brick of `level` whose cells own the sample at `position`, in index space; where the tree ends above
// that level, the brick it ends with. `footer`: of the source's open frame, as openFrame() gave it. Replaces
// the source's wish. Errors: kNotFound (no such channel; nothing is stored there, so all is background);
// kCorrupt; kTimeout; those of the source.
Result<BrickValues> readBrick(BrickSource& source, const FrameFooter& footer, const std::string& channel,
                              const std::array<std::int64_t, 3>& position, int level,
                              SourceDeadline deadline = SourceDeadline::max());

}  // namespace brickyard

// How far a node's field is from level 0: exact, because the lattices nest. Within a level-0 cell both fields
// are trilinear, so the largest deviation is at a level-0 sample; where level 0 is one value over a box, a
// closed form gives the largest deviation and the sum of squares without visiting its samples. Not
// thread-safe; one per node and thread.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "core/brick_shape.h"
#include "core/node_key.h"
#include "core/tree_block.h"

namespace brickyard {

// What one part of a node's region adds to it.
struct DeviationPart {
    struct SubBox {
        int index = 0;  // in the node's error grid
        double largest = 0;
        double squares =
            0;  // sum of (deviation / scale)^2 over the level-0 samples the part owns in this sub-box
    };
    std::array<SubBox, kErrorGridCells> boxes;
    int count = 0;

    SubBox& at(int index);
};

// `node_samples`: the decoded samples of `node`, (N + 1)^3 of one component. `scale` keeps squares in range.
// The level-0 brick `part` below `node`, with its samples: largest over the closed brick, squares over [0,
// N)^3.
void addBrickDeviation(const NodeKey& node, std::span<const double> node_samples, const NodeKey& part,
                       std::span<const double> part_samples, BrickShape shape, double scale,
                       DeviationPart& out);

// The region of node `part` (any level below `node`'s), where level 0 is `value` everywhere.
void addUniformDeviation(const NodeKey& node, std::span<const double> node_samples, const NodeKey& part,
                         double value, BrickShape shape, double scale, DeviationPart& out);

// All parts of a node together.
class NodeDeviation {
public:
    void merge(const DeviationPart& part);
    void merge(const NodeDeviation& other);
    double largest() const;
    // Over all level-0 samples the node owns. For several components merge each and take the worst.
    double rms(const NodeKey& node, BrickShape shape, double scale) const;
    // Rounded up to what an ErrorGrid can say. `bound` is the node's, as stored.
    ErrorGrid grid(const NodeKey& node, BrickShape shape, double scale, float bound) const;

private:
    std::array<double, kErrorGridCells> largest_{};
    std::array<double, kErrorGridCells> squares_{};
};

}  // namespace brickyard

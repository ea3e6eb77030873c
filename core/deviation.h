// How far a node's field is from level 0, exactly, because the lattices nest. Within a level-0 cell both
// fields are trilinear, so the largest deviation is at a level-0 sample; where level 0 is one value over a
// box, a closed form gives the largest deviation and the sum of squares without visiting its samples. Not
// thread-safe; one per node and thread.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "core/brick_shape.h"
#include "core/node_key.h"
#include "core/sample_cube.h"
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

// The level-0 brick `part` below `node`, with its (N + 1)^3 samples: largest over the closed brick, squares
// over [0, N)^3. `node_samples`: the decoded samples of `node`, (N + 1)^3 of one component. `scale` keeps
// squares in range. REQUIRES: a cell of the node is no larger than the part. T: float, double, std::int32_t,
// std::int64_t, std::uint8_t.
template <class T>
void addBrickDeviation(const NodeKey& node, std::span<const double> node_samples, const NodeKey& part,
                       SampleCube<T> part_samples, BrickShape shape, double scale, DeviationPart& out);

// The region of node `part` (any level below `node`'s), where level 0 is `value` everywhere.
void addUniformDeviation(const NodeKey& node, std::span<const double> node_samples, const NodeKey& part,
                         double value, BrickShape shape, double scale, DeviationPart& out);

// Whether the samples of `node` over `part`, a node of any level below, are all `value`: where level 0 is
// that value too, nothing deviates.
bool hasOneValue(const NodeKey& node, SampleCube<double> samples, const NodeKey& part, double value,
                 BrickShape shape);

// Level 0 less the field of a brick above it, summed up per cell of that brick, so that a level further up
// can be measured without visiting level 0 again: over the level-0 samples of a cell (half-open), with r =
// level 0 - brick's field and w_q the trilinear weight of corner q, `moments[q]` = sum of w_q r, `squares` =
// sum of r^2; `largest` = max |r| (closed). All in units of `scale`.
struct CellResidual {
    std::array<double, 8> moments{};
    double squares = 0;
    double largest = 0;
};

// The residual of the cells of `node` that lie over the level-0 brick `part`, against the exact samples of
// `node`. `out` has the node's N^3 cells, x fastest. REQUIRES: as addBrickDeviation.
template <class T>
void addBrickResidual(const NodeKey& node, SampleCube<double> node_samples, const NodeKey& part,
                      SampleCube<T> part_samples, BrickShape shape, double scale,
                      std::span<CellResidual> out);

// What a node of a higher level is measured against: the samples of a brick of level `part.level`, exact, and
// its residual (empty: none, as where level 0 is one value everywhere, and then the samples are that value).
struct MeasuredBrick {
    NodeKey key;
    SampleCube<double> samples;
    std::span<const CellResidual> residual;
};
// Squares are as exact as a visit of level 0; the largest deviation is bounded by that between the two levels
// plus the residual's. REQUIRES: a cell of the node is no larger than the part.
void addMeasuredDeviation(const NodeKey& node, std::span<const double> node_samples,
                          const MeasuredBrick& part, BrickShape shape, double scale, DeviationPart& out);
void addMeasuredResidual(const NodeKey& node, SampleCube<double> node_samples, const MeasuredBrick& part,
                         BrickShape shape, double scale, std::span<CellResidual> out);
// The same where the part, of any level below the node's, is `value` everywhere.
void addUniformResidual(const NodeKey& node, SampleCube<double> node_samples, const NodeKey& part,
                        double value, BrickShape shape, double scale, std::span<CellResidual> out);

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

// How much of a directional light reaches a node of the octree: optical depths on a regular lattice over the
// node's tight box, interpolated in between (depths, not transmittances: those fall like exponentials, and
// would come out too bright). One lattice serves every view ray that meets the node, so a shadow costs a few
// rays per brick instead of one per step. Spacing follows from the error asked for: from four voxels on, a
// lattice is doubled until it agrees with its own half, or has a point per voxel or sixteen cells.
// docs/error-bounds.md, section "Shadows".
#pragma once

#include <memory>
#include <mutex>
#include <unordered_map>
#include <vector>

#include "client/cpu/channel_ray.h"
#include "client/cpu/render_plan.h"
#include "client/cpu/resident_tree.h"

namespace brickyard {

struct LightLattice {
    int points[3] = {};        // per axis
    int box_begin[3] = {};     // of the node's cells
    float per_cell[3] = {};    // lattice cells per cell of the node
    std::vector<float> quads;  // optical depths as CornerQuads has samples, points[0] * points[1] to a slice
    // Standard deviations of what is interpolated: from levels and drafts on the way to the light, which
    // neighbours share; and from the lattice's spacing, which changes sign from cell to cell.
    float deviation = 0, spacing_deviation = 0;
    // At a position in cells of the node.
    double transmittance(double x, double y, double z) const;
};

// The lattices of a picture, made when a ray first asks for one. Any thread may call.
class LightField {
public:
    // `deviation` of a shadow that is allowed (of its interpolation: twice that); 0: exact levels, and
    // kReferenceDeviation of interpolation.
    // REQUIRES: plan.scene.light. `plan` must outlive the field.
    // With `resident`: what can be told from the pages that are there; no lattice waits.
    LightField(const RenderPlan& plan, double deviation, const ResidentTree* resident = nullptr);
    ~LightField();
    static constexpr double kReferenceDeviation = 1e-4;

    // The node's lattice, or nullptr while pages are missing; those are wanted. Valid as long as the field.
    const LightLattice* of(const WalkedNode& node, double worth, const RayContext& context);
    std::uint64_t bytes() const;

private:
    struct Entry;
    Entry& entryOf(const NodeRef& node);
    const RenderPlan& plan_;
    double deviation_;
    const ResidentTree* resident_;
    mutable std::mutex mutex_;
    std::unordered_map<std::uint64_t, std::unique_ptr<Entry>> entries_;
};

}  // namespace brickyard

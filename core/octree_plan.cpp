#include "core/octree_plan.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <tuple>

#include "core/finite_field.h"

namespace brickyard {

int chunkSteps(BrickShape shape) {
    // 128 voxels an edge: with its halo a chunk of floats takes some 15 MB.
    return std::min(3, 7 - std::countr_zero(unsigned(shape.edge_cells)));
}

IndexBox closedRegion(const NodeKey& key, BrickShape shape) {
    const std::int64_t edge = std::int64_t(shape.edge_cells) << key.level;
    IndexBox box;
    box.begin = {key.x * edge, key.y * edge, key.z * edge};
    for (std::size_t a = 0; a < 3; ++a) box.end[a] = box.begin[a] + edge + 1;
    return box;
}

namespace {

class Planner {
public:
    Planner(const FieldSource& field, BrickShape shape)
        : field_(field), shape_(shape), lowest_(chunkSteps(shape)) {}

    Result<void> plan(const NodeKey& key) {
        const std::optional<UniformRegion> region = field_.uniformOver(closedRegion(key, shape_));
        if (region) {
            if (!region->active && region->value == field_.info().background) return {};
            for (ValueBits bits : region->value)
                if (!std::isfinite(toDouble(field_.info().type, bits)))
                    return refuseNonFinite(field_.info(), closedRegion(key, shape_).begin);
            uniform.emplace_back(key, *region);
        } else if (key.level == lowest_) {
            chunks.push_back(key);
        } else {
            for (int octant = 0; octant < 8; ++octant)
                if (Result<void> planned = plan(key.child(octant)); !planned) return planned;
        }
        return {};
    }

    std::vector<NodeKey> chunks;
    std::vector<std::pair<NodeKey, UniformRegion>> uniform;

private:
    const FieldSource& field_;
    BrickShape shape_;
    int lowest_;
};

}  // namespace

Result<OctreePlan> OctreePlan::make(const FieldSource& field, BrickShape shape) {
    // Two nodes per axis at this level hold every cell that touches an int32 position, the one below INT_MIN
    // included.
    const int top = 32 - std::countr_zero(unsigned(shape.edge_cells));
    Planner planner(field, shape);
    for (int octant = 0; octant < 8; ++octant)
        if (Result<void> planned =
                planner.plan({top, (octant & 1) - 1, (octant >> 1 & 1) - 1, (octant >> 2 & 1) - 1});
            !planned)
            return tl::unexpected(planned.error());

    OctreePlan plan;
    plan.chunks_ = std::move(planner.chunks);
    plan.uniform_ = std::move(planner.uniform);
    if (field.prefersRows())
        std::sort(plan.chunks_.begin(), plan.chunks_.end(), [](const NodeKey& a, const NodeKey& b) {
            return std::tie(a.z, a.y, a.x) < std::tie(b.z, b.y, b.x);
        });
    else
        std::sort(plan.chunks_.begin(), plan.chunks_.end(), mortonLess);
    for (std::size_t i = 0; i < plan.uniform_.size(); ++i) {
        plan.index_.emplace(plan.uniform_[i].first, std::uint32_t(i));
        plan.highest_uniform_ = std::max(plan.highest_uniform_, plan.uniform_[i].first.level);
    }
    return plan;
}

const UniformRegion* OctreePlan::uniformAt(NodeKey key) const {
    for (; key.level <= highest_uniform_; key = key.parent())
        if (const auto found = index_.find(key); found != index_.end())
            return &uniform_[found->second].second;
    return nullptr;
}

}  // namespace brickyard

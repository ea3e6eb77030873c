#include "core/octree_plan.h"

#include <algorithm>
#include <bit>

namespace brickyard {

namespace {

class Planner {
public:
    Planner(const FieldSource& field, BrickShape shape) : field_(field), shape_(shape) {}

    // Adds `key` and what is below it; false where the region is inactive background.
    bool plan(const NodeKey& key) {
        const std::optional<UniformRegion> uniform = field_.uniformOver(closedRegion(key, shape_));
        if (uniform && !uniform->active && uniform->value == field_.info().background) return false;

        PlannedNode node;
        node.key = key;
        if (uniform) {
            node.kind = PlannedKind::kUniform;
            node.uniform = *uniform;
        } else if (key.level == 0) {
            node.kind = PlannedKind::kBrick;
        } else {
            for (int octant = 0; octant < 8; ++octant)
                if (plan(key.child(octant))) node.valid_mask = std::uint8_t(node.valid_mask | 1 << octant);
        }
        const std::size_t level = std::size_t(key.level);
        if (levels.size() <= level) levels.resize(level + 1);
        levels[level].push_back(std::move(node));
        return true;
    }

    std::vector<std::vector<PlannedNode>> levels;

private:
    const FieldSource& field_;
    BrickShape shape_;
};

bool meetsOrigin(const std::vector<PlannedNode>& nodes) {
    return std::all_of(nodes.begin(), nodes.end(), [](const PlannedNode& node) {
        auto near = [](std::int32_t c) { return c == 0 || c == -1; };
        return near(node.key.x) && near(node.key.y) && near(node.key.z);
    });
}

bool allInner(const std::vector<PlannedNode>& nodes) {
    return std::all_of(nodes.begin(), nodes.end(),
                       [](const PlannedNode& n) { return n.kind == PlannedKind::kInner; });
}

}  // namespace

IndexBox closedRegion(const NodeKey& key, BrickShape shape) {
    const std::int64_t edge = std::int64_t(shape.edge_cells) << key.level;
    IndexBox box;
    box.begin = {key.x * edge, key.y * edge, key.z * edge};
    for (std::size_t a = 0; a < 3; ++a) box.end[a] = box.begin[a] + edge + 1;
    return box;
}

OctreePlan OctreePlan::make(const FieldSource& field, BrickShape shape) {
    // Two nodes per axis at this level hold every cell that touches an int32 position, the one below INT_MIN
    // included.
    const int top = 32 - std::countr_zero(unsigned(shape.edge_cells));
    Planner planner(field, shape);
    for (int octant = 0; octant < 8; ++octant)
        planner.plan({top, (octant & 1) - 1, (octant >> 1 & 1) - 1, (octant >> 2 & 1) - 1});

    // Levels above the lowest that still has one root, or roots that meet at the origin, say nothing new.
    std::vector<std::vector<PlannedNode>>& levels = planner.levels;
    while (levels.size() > 1 && allInner(levels.back())) {
        const std::vector<PlannedNode>& below = levels[levels.size() - 2];
        if (below.size() != 1 && !meetsOrigin(below)) break;
        levels.pop_back();
    }

    OctreePlan plan;
    plan.levels_ = std::move(levels);
    for (std::vector<PlannedNode>& level : plan.levels_) {
        std::sort(level.begin(), level.end(),
                  [](const PlannedNode& a, const PlannedNode& b) { return mortonLess(a.key, b.key); });
        auto& index = plan.index_.emplace_back();
        index.reserve(level.size());
        for (std::size_t i = 0; i < level.size(); ++i) index.emplace(level[i].key, std::uint32_t(i));
    }
    return plan;
}

const PlannedNode* OctreePlan::find(const NodeKey& key) const {
    if (std::size_t(key.level) >= levels_.size()) return nullptr;
    const auto& index = index_[std::size_t(key.level)];
    const auto found = index.find(key);
    return found == index.end() ? nullptr : &levels_[std::size_t(key.level)][found->second];
}

std::size_t OctreePlan::indexOf(const NodeKey& key) const { return index_[std::size_t(key.level)].at(key); }

const PlannedNode* OctreePlan::findOrAbove(NodeKey key) const {
    for (; std::size_t(key.level) < levels_.size(); key = key.parent())
        if (const PlannedNode* node = find(key)) return node;
    return nullptr;
}

}  // namespace brickyard

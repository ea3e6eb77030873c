// Which resident page draws each node of a walk from the roots down: its own, or that of the nearest ancestor
// that has one (resident_tree.h). For depth-first walks, one at a time.
#pragma once

#include <array>

#include "client/cpu/resident_tree.h"

namespace brickyard {

class DrawnNodes {
public:
    explicit DrawnNodes(const ResidentTree& tree) : tree_(&tree) {}

    // The node whose page draws `node`; nullptr where not even a root's is there. Valid until the walk meets
    // another node of that level. REQUIRES: called for a node only after its ancestors.
    const WalkedNode* at(const WalkedNode& node) {
        const std::size_t level = std::size_t(node.key.level);
        if (node.block && tree_->at(node.ref) != Residency::kNone) {
            nodes_[level] = node;
            nodes_[level].status = WalkStatus::kNode;
            has_[level] = true;
        } else {
            has_[level] = has_[level + 1];
            if (has_[level]) nodes_[level] = nodes_[level + 1];
        }
        return has_[level] ? &nodes_[level] : nullptr;
    }
    // Whether anything below the node is drawn finer. REQUIRES: at(node) was called.
    bool finerBelow(const WalkedNode& node) const { return tree_->below(node.ref); }

private:
    static constexpr std::size_t kLevels = 40;  // int32 indices have no more, and one above the roots
    const ResidentTree* tree_;
    std::array<WalkedNode, kLevels> nodes_;
    std::array<bool, kLevels> has_{};
};

}  // namespace brickyard

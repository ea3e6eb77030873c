// The nodes below a chunk's root, put away until their tree block is written: a tree larger than memory
// passes through here. Payload offsets above level 0 are relative to their level's first payload, which is
// known only at the end.
#pragma once

#include <memory>
#include <vector>

#include "core/scratch_file.h"
#include "core/tree_block_encoder.h"

namespace brickyard {

class SubtreeStore {
public:
    explicit SubtreeStore(ScratchFile& scratch) : scratch_(&scratch) {}

    // Gives a stub for `root` (the node itself where nothing is below it). Errors: kIo.
    Result<std::unique_ptr<TreeNode>> put(std::unique_ptr<TreeNode> root);
    // Fills in a stub. Errors: kIo.
    Result<void> load(TreeNode& stub) const;

private:
    ScratchFile* scratch_;
};

}  // namespace brickyard

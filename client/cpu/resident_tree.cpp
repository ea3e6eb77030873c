#include "client/cpu/resident_tree.h"

namespace brickyard {

ResidentTree::ResidentTree(const PagedChannel& channel, const Resident& resident)
    : nodes_(channel.blockCount()) {
    for (std::uint32_t b = 0; b < channel.blockCount(); ++b) {
        const TreeBlock* block = channel.block(b);
        if (!block) continue;
        nodes_[b].resize(block->nodeCount());
        for (std::uint32_t n = 0; n < block->nodeCount(); ++n) {
            const NodeRecord& record = block->record(n);
            const PageAddress page{channel.index(), b, n, false};
            if (!record.hasBrick() || resident(page))
                nodes_[b][n] = std::uint8_t(Residency::kWhole);
            else if (record.hasDraft() && resident({page.channel, b, n, true}))
                nodes_[b][n] = std::uint8_t(Residency::kDraft);
        }
    }
    // Children stand behind their parents, and their blocks behind the parents' blocks: backwards, every
    // child is known before its parent.
    for (std::uint32_t b = channel.blockCount(); b-- > 0;) {
        const TreeBlock* block = channel.block(b);
        if (!block) continue;
        for (std::uint32_t n = block->nodeCount(); n-- > 0;) {
            if (block->isLeaf(n)) continue;
            const ChildrenRef first = block->children(n);
            const TreeBlock* home = channel.block(first.block);
            if (!home) continue;
            const auto count = std::uint32_t(__builtin_popcount(block->validMask(n)));
            for (std::uint32_t c = first.first; c < first.first + count && c < home->nodeCount(); ++c)
                // A leaf of one value is exact without a page, but no page below.
                if ((nodes_[first.block][c] & kBelow) ||
                    (home->record(c).hasBrick() && (nodes_[first.block][c] & 3u)))
                    nodes_[b][n] |= kBelow;
        }
    }
}

}  // namespace brickyard

#include "tools/level_summary.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/printable_name.h"

namespace brickyard {

Result<std::vector<LevelSummary>> summarizeLevels(const FieldReader& reader) {
    std::vector<LevelSummary> levels(reader.channel().levels());
    auto roots = reader.roots();
    if (!roots) return tl::unexpected(roots.error());
    std::vector<FieldNode> waiting = std::move(*roots);
    // A sound tree has fewer nodes than its blocks can hold; a damaged one may refer to nodes again and
    // again.
    std::uint64_t left = 0;
    for (const BlockRef& block : reader.channel().blocks()) left += block.raw_bytes();
    while (!waiting.empty()) {
        if (left-- == 0)
            return fail(ErrorCode::kCorrupt,
                        fmt::format("{}: the tree of channel '{}' refers to nodes twice; run verify",
                                    reader.store().path().string(), printableName(reader.channel().name())));
        const FieldNode node = std::move(waiting.back());
        waiting.pop_back();
        LevelSummary& level = levels[std::size_t(node.key.level)];
        const NodeRecord& record = node.record();
        ++level.nodes;
        if (record.hasBrick()) {
            ++level.bricks;
            level.payload_bytes += record.payload_bytes;
            level.rms += double(record.rms) * double(record.rms);
            level.bound = std::max(level.bound, double(record.bound));
        }
        for (int octant = 0; octant < 8; ++octant) {
            if (!(node.validMask() >> octant & 1)) continue;
            auto child = reader.child(node, octant);
            if (!child) return tl::unexpected(child.error());
            waiting.push_back(std::move(*child));
        }
    }
    for (LevelSummary& level : levels)
        if (level.bricks > 0) level.rms = std::sqrt(level.rms / double(level.bricks));
    return levels;
}

}  // namespace brickyard

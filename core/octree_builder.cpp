#include "core/octree_builder.h"

#include <cassert>

#include "core/channel_builder.h"

namespace brickyard {

Result<FrameFooter> buildFrame(std::span<const FieldSource* const> channels,
                               std::span<const BuildOptions> options, FrameWriter& writer) {
    assert(channels.size() == options.size());
    std::vector<std::unique_ptr<ChannelBuilder>> builders;
    std::size_t total = 0, done = 0;
    int levels = 0;
    for (std::size_t c = 0; c < channels.size(); ++c) {
        Result<std::unique_ptr<ChannelBuilder>> builder = ChannelBuilder::create(*channels[c], options[c]);
        if (!builder) return tl::unexpected(builder.error());
        if (Result<void> built = (*builder)->buildLevels(); !built) return tl::unexpected(built.error());
        total += (*builder)->brickCount();
        levels = std::max(levels, (*builder)->levelCount());
        builders.push_back(std::move(*builder));
    }

    // Finest first: whatever a cold reader wants soon stands together at the end of the file.
    for (const auto& builder : builders)
        if (Result<void> written = builder->writeFinest(writer, done, total); !written)
            return tl::unexpected(written.error());
    FrameFooter footer;
    footer.set_coarse_begin(writer.position());
    for (int level = 1; level < levels; ++level)
        for (const auto& builder : builders)
            if (Result<void> written = builder->writeLevel(writer, level); !written)
                return tl::unexpected(written.error());
    for (const auto& builder : builders) {
        Result<ChannelFooter> channel = builder->writeTree(writer);
        if (!channel) return tl::unexpected(channel.error());
        *footer.add_channels() = std::move(*channel);
    }
    if (!options.empty()) footer.set_brick_edge(std::uint32_t(options[0].shape.edge_cells));
    return footer;
}

}  // namespace brickyard

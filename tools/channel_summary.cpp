#include "tools/channel_summary.h"

namespace brickyard {

ChannelSummary summarizeChannel(const ChannelFooter& channel) {
    ChannelSummary summary;
    summary.set_name(channel.name());
    summary.set_sample_type(channel.sample_type());
    summary.set_components(channel.components());
    *summary.mutable_index_to_world() = channel.index_to_world();
    *summary.mutable_active_min() = channel.active_min();
    *summary.mutable_active_max() = channel.active_max();
    summary.set_active_voxels(channel.active_voxels());
    summary.set_bricks(channel.bricks());
    summary.set_levels(channel.levels());
    summary.set_value_min(channel.value_min());
    summary.set_value_max(channel.value_max());
    summary.set_error_bound(channel.error_bound());
    summary.set_error_made(channel.error_made());
    summary.set_payload_bytes(channel.payload_bytes());
    summary.set_saved_as_half(channel.saved_as_half());
    return summary;
}

}  // namespace brickyard

#include "core/default_density.h"

namespace brickyard {

std::optional<std::uint32_t> defaultDensity(const FrameFooter& frame) {
    std::optional<std::uint32_t> scalar;
    bool several = false;
    for (int i = 0; i < frame.channels_size(); ++i) {
        const ChannelFooter& channel = frame.channels(i);
        if (channel.name() == "density") return std::uint32_t(i);
        if (channel.components() != 1) continue;
        several = scalar.has_value();
        scalar = std::uint32_t(i);
    }
    return several ? std::nullopt : scalar;
}

}  // namespace brickyard

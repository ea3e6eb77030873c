#include "core/default_density.h"

#include <algorithm>

namespace brickyard {

namespace {

// "light.0", "light.1" ... of `brickyard bake`: never what is meant.
bool isBakedLight(const std::string& name) {
    constexpr std::size_t kPrefix = 6;
    return name.size() > kPrefix && name.starts_with("light.") &&
           std::all_of(name.begin() + kPrefix, name.end(), [](char c) { return c >= '0' && c <= '9'; });
}

}  // namespace

std::optional<std::uint32_t> defaultDensity(const FrameFooter& frame) {
    std::optional<std::uint32_t> scalar;
    bool several = false;
    for (int i = 0; i < frame.channels_size(); ++i) {
        const ChannelFooter& channel = frame.channels(i);
        if (channel.name() == "density") return std::uint32_t(i);
        if (channel.components() != 1 || isBakedLight(channel.name())) continue;
        several = scalar.has_value();
        scalar = std::uint32_t(i);
    }
    return several ? std::nullopt : scalar;
}

}  // namespace brickyard

#include "client/scene_entry.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <vector>

#include "core/default_density.h"
#include "core/printable_name.h"

namespace brickyard {

namespace {

std::string channelNames(const FrameFooter& frame) {
    std::vector<std::string> names;
    for (const ChannelFooter& channel : frame.channels()) names.push_back(printableName(channel.name()));
    return names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", "));
}

}  // namespace

tl::unexpected<Error> refuseEntry(const std::string& entry, const std::string& what, ErrorCode code) {
    return fail(code, fmt::format("scene: {}: {}", entry, what));
}

Result<double> scaleEntry(double value, double otherwise, const std::string& entry) {
    if (value == 0) return otherwise;
    // Products of a few of them stay finite.
    constexpr double kMost = 1e100;
    if (!(value >= 0 && value <= kMost))
        return refuseEntry(entry, fmt::format("is {}; it wants a number above 0, at most 1e100", value));
    return value;
}

Result<std::uint32_t> channelEntry(const FrameFooter& frame, const std::string& name, unsigned components,
                                   const std::string& entry, const std::string& place) {
    for (int i = 0; i < frame.channels_size(); ++i) {
        const ChannelFooter& channel = frame.channels(i);
        if (channel.name() != name) continue;
        if (components == 0 || channel.components() == components) return std::uint32_t(i);
        return refuseEntry(entry, fmt::format("channel '{}' holds {}; this wants {}", printableName(name),
                                              channel.components() == 1 ? "one number a voxel" : "vectors",
                                              components == 1 ? "one number a voxel" : "three components"));
    }
    return refuseEntry(
        entry,
        fmt::format("no channel '{}'{}; there are: {}", printableName(name), place, channelNames(frame)),
        ErrorCode::kNotFound);
}

Result<std::uint32_t> densityEntry(const FrameFooter& frame, const std::string& entry,
                                   const std::string& place) {
    if (const std::optional<std::uint32_t> channel = defaultDensity(frame)) return *channel;
    return refuseEntry(entry,
                       fmt::format("no channel 'density'{}, and not just one scalar; name one; there are: {}",
                                   place, channelNames(frame)),
                       ErrorCode::kNotFound);
}

void moveSamples(const glm::dvec3& offset, FrameFooter& frame) {
    if (offset == glm::dvec3(0)) return;
    for (ChannelFooter& channel : *frame.mutable_channels()) {
        auto& columns = *channel.mutable_index_to_world();
        if (columns.size() != 16) continue;
        for (int row = 0; row < 3; ++row)
            for (int axis = 0; axis < 3; ++axis) columns[12 + row] += columns[4 * axis + row] * offset[axis];
    }
}

void moveWorld(const glm::dmat4& to_world, FrameFooter& frame) {
    if (to_world == glm::dmat4(1.0)) return;
    for (ChannelFooter& channel : *frame.mutable_channels()) {
        auto& columns = *channel.mutable_index_to_world();
        if (columns.size() != 16) continue;
        glm::dmat4 before(1.0);
        for (int i = 0; i < 16; ++i) before[i / 4][i % 4] = columns[i];
        const glm::dmat4 after = to_world * before;
        for (int i = 0; i < 16; ++i) columns[i] = after[i / 4][i % 4];
    }
}

}  // namespace brickyard

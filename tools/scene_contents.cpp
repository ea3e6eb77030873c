#include "tools/scene_contents.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <limits>
#include <span>
#include <string>
#include <string_view>

namespace brickyard {

namespace {

// As solvers and modellers name them, most telling first; in small letters.
constexpr std::string_view kDensity[] = {"density", "smoke", "soot", "fog", "cloud"};
constexpr std::string_view kFlame[] = {"flame", "flames", "fire", "fuel", "heat", "burn"};
constexpr std::string_view kTemperature[] = {"temperature", "temp"};
constexpr std::string_view kVelocity[] = {"velocity", "vel", "v", "motion"};
constexpr std::string_view kColor[] = {"color", "colour", "cd", "albedo"};
constexpr std::string_view kSurface[] = {"surface", "phi", "sdf", "liquid", "fluid"};
// Level sets that a solver keeps for itself.
constexpr std::string_view kHelpers[] = {"obstacle", "inflow", "outflow", "out", "previous", "particles"};

std::string lowered(std::string name) {
    std::transform(name.begin(), name.end(), name.begin(),
                   [](unsigned char c) { return char(std::tolower(c)); });
    return name;
}

bool isConstant(const ChannelFooter& channel) { return channel.value_min() == channel.value_max(); }

bool isDense(const ChannelFooter& channel) {
    double voxels = 1;
    for (int a = 0; a < 3; ++a) voxels *= double(channel.active_max(a)) - double(channel.active_min(a)) + 1;
    // 0 is air, and some converters leave it inactive.
    return double(channel.active_voxels()) > 0.9 * voxels && voxels > 8;
}

bool isLevelSet(const ChannelFooter& channel) {
    return channel.grid_class() == "level set" && channel.value_min() < 0 && channel.value_max() > 0;
}

// Of the channels `fits` accepts: the first name that one of them has, whatever its case.
template <class Fits>
std::optional<std::uint32_t> named(const FrameFooter& frame, std::span<const std::string_view> names,
                                   Fits fits) {
    for (const std::string_view name : names)
        for (int i = 0; i < frame.channels_size(); ++i) {
            const ChannelFooter& channel = frame.channels(i);
            if (fits(channel) && lowered(channel.name()) == name) return std::uint32_t(i);
        }
    return std::nullopt;
}

template <class Fits>
std::optional<std::uint32_t> firstOf(const FrameFooter& frame, Fits fits) {
    for (int i = 0; i < frame.channels_size(); ++i)
        if (fits(frame.channels(i))) return std::uint32_t(i);
    return std::nullopt;
}

std::optional<std::uint32_t> levelSetOf(const FrameFooter& frame) {
    const auto usable = [](const ChannelFooter& channel) {
        return channel.components() == 1 && channel.active_voxels() > 0 && isLevelSet(channel);
    };
    if (const auto found = named(frame, kSurface, usable)) return found;
    const auto own = [&](const ChannelFooter& channel) {
        const std::string name = lowered(channel.name());
        return usable(channel) && std::none_of(std::begin(kHelpers), std::end(kHelpers), [&](auto helper) {
                   return name.find(helper) != std::string::npos;
               });
    };
    if (const auto found = firstOf(frame, own)) return found;
    return firstOf(frame, usable);
}

}  // namespace

SceneContents sceneContents(const FrameFooter& frame) {
    SceneContents contents;
    const auto drawn = [](const ChannelFooter& channel) {
        // Values beyond the float range are stored, but not drawn.
        constexpr double kMost = std::numeric_limits<float>::max();
        return channel.components() == 1 && channel.active_voxels() > 0 && channel.active_min_size() == 3 &&
               std::abs(channel.value_min()) <= kMost && std::abs(channel.value_max()) <= kMost;
    };
    const auto vectors = [](const ChannelFooter& channel) {
        return channel.components() == 3 && channel.active_voxels() > 0;
    };
    contents.level_set = levelSetOf(frame);
    contents.velocity = named(frame, kVelocity, vectors);
    contents.color = named(frame, kColor, vectors);

    const auto glows = [&](const ChannelFooter& channel) {
        return drawn(channel) && channel.value_max() > 0 && !isLevelSet(channel);
    };
    contents.flame = named(frame, kFlame, glows);
    contents.temperature = named(frame, kTemperature, glows);
    contents.burned_out = !contents.flame && named(frame, kFlame, [](const ChannelFooter& channel) {
        return channel.components() == 1;
    });

    // Measured values have no class, and every voxel has one.
    const auto scanned = [&](const ChannelFooter& channel) {
        return drawn(channel) && !isConstant(channel) && channel.grid_class() != "fog volume" &&
               channel.grid_class() != "level set" && isDense(channel) && lowered(channel.name()) != "flags";
    };
    const auto fog = [&](const ChannelFooter& channel) {
        return drawn(channel) && channel.value_max() > 0 && !isLevelSet(channel) && !scanned(channel);
    };
    contents.density = named(frame, kDensity, fog);
    if (contents.density) return contents;
    contents.scan = firstOf(frame, scanned);
    if (contents.scan || contents.level_set) return contents;
    const auto other = [&](const ChannelFooter& channel) {
        const std::string name = lowered(channel.name());
        return fog(channel) && name != "flags" && name != "shadow" &&
               std::find(std::begin(kTemperature), std::end(kTemperature), name) == std::end(kTemperature) &&
               std::find(std::begin(kFlame), std::end(kFlame), name) == std::end(kFlame);
    };
    contents.density = firstOf(frame, other);
    // A flame without smoke is its own smoke.
    if (!contents.density) contents.density = contents.flame ? contents.flame : contents.temperature;
    return contents;
}

}  // namespace brickyard

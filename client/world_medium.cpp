// Media of bindWorld(): what fills space, and what of it glows.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "client/world_binder.h"
#include "core/affine.h"
#include "core/printable_name.h"

namespace brickyard {

namespace {

// World length of the longest edge of the channel's active box, in whole voxels; 1 where it has none.
double longestEdge(const ChannelFooter& channel) {
    const std::vector<double> columns(channel.index_to_world().begin(), channel.index_to_world().end());
    const Result<Affine> transform = Affine::fromColumns(columns);
    double longest = 0;
    for (int a = 0; transform && channel.active_min_size() == 3 && a < 3; ++a) {
        glm::dvec3 edge(0);
        edge[a] = double(channel.active_max(a)) - double(channel.active_min(a)) + 1;
        longest = std::max(longest, glm::length(transform->vector(edge)));
    }
    return longest > 0 && std::isfinite(longest) ? longest : 1;
}

}  // namespace

void WorldBinder::scatter(const Medium& from, const std::string& where, MediumSettings& out) {
    out.density_scale = take(scaleEntry(from.density_scale(), 1, where + ".density_scale"));
    out.albedo = take(colorEntry(from.albedo(), out.albedo, where + ".albedo", 1));
    out.phase.anisotropy = from.anisotropy();
    if (!(std::abs(out.phase.anisotropy) < 1))
        refuse(where + ".anisotropy", "wants a number above -1 and below 1");
    if (from.phase() == "rayleigh") {
        out.phase.kind = PhaseFunction::Kind::kRayleigh;
        if (out.phase.anisotropy != 0)
            refuse(where + ".anisotropy", "is of phase henyey-greenstein; rayleigh has none");
    } else if (!from.phase().empty() && from.phase() != "henyey-greenstein") {
        refuse(where + ".phase",
               fmt::format("is '{}'; there are henyey-greenstein, rayleigh", printableName(from.phase())));
    }
    if (from.has_emission()) out.emission = emission(from.emission(), out.density.frame, where + ".emission");

    if (from.has_color_ramp() && from.color().empty())
        refuse(where + ".color", "is missing; color_ramp wants a channel to colour by");
    if (from.color().empty()) return;
    out.color = channel(out.density.frame, from.color(), 0, where + ".color");
    const ChannelFooter* const footer = footerOf(*out.color);
    const bool scalar = footer && footer->components() == 1;
    if (scalar && !from.has_color_ramp())
        refuse(where + ".color_ramp", fmt::format("is missing; '{}' holds one number a voxel, not a colour",
                                                  printableName(from.color())));
    if (!scalar && from.has_color_ramp())
        refuse(where + ".color_ramp",
               fmt::format("is of scalars; '{}' holds colours already", printableName(from.color())));
    if (from.has_color_ramp())
        out.color_ramp = share(ColorRamp::create(from.color_ramp(), where + ".color_ramp"));
}

void WorldBinder::transfer(const Medium& from, const std::string& where, MediumSettings& out) {
    const struct {
        const char* name;
        bool given;
    } others[] = {{"albedo", !from.albedo().empty()}, {"anisotropy", from.anisotropy() != 0},
                  {"emission", from.has_emission()},  {"phase", !from.phase().empty()},
                  {"color", !from.color().empty()},   {"color_ramp", from.has_color_ramp()}};
    for (const auto& other : others)
        if (other.given)
            refuse(fmt::format("{}.{}", where, other.name), "stands beside transfer; leave one out");
    out.transfer_shading = from.transfer().shading();
    if (!(out.transfer_shading >= 0 && out.transfer_shading <= 1))
        refuse(where + ".transfer.shading",
               fmt::format("is {}; it wants a number from 0 to 1", out.transfer_shading));
    const ChannelFooter* const footer = footerOf(out.density);
    if (!footer) return;
    out.density_scale =
        take(scaleEntry(from.density_scale(), 100 / longestEdge(*footer), where + ".density_scale"));
    out.transfer = share(TransferFunction::create(from.transfer(), footer->value_min(), footer->value_max(),
                                                  where + ".transfer"));
}

MediumEmission WorldBinder::emission(const Emission& from, std::uint32_t frame, const std::string& where) {
    MediumEmission out;
    if (from.channel().empty()) refuse(where + ".channel", "is missing; name what glows");
    out.channel = channel(frame, from.channel(), 1, where + ".channel");
    out.scale = take(scaleEntry(from.scale(), 1, where + ".scale"));
    out.color = take(colorEntry(from.color(), out.color, where + ".color"));
    if (from.has_ramp() && from.has_black_body())
        refuse(where + ".ramp", "stands beside black_body; leave one out");
    if (!from.color().empty() && (from.has_ramp() || from.has_black_body()))
        refuse(where + ".color",
               fmt::format("stands beside {}; leave one out", from.has_ramp() ? "ramp" : "black_body"));
    if (from.has_ramp()) out.ramp = share(ColorRamp::create(from.ramp(), where + ".ramp"));
    if (from.has_black_body()) {
        const BlackBodyEmission& body = from.black_body();
        out.kelvin_scale = take(scaleEntry(body.kelvin_scale(), 1, where + ".black_body.kelvin_scale"));
        out.kelvin_offset = body.kelvin_offset();
        if (!(std::abs(out.kelvin_offset) <= 1e30))
            refuse(where + ".black_body.kelvin_offset", "wants a finite number, at most 1e30");
        const double one = body.kelvin_at_one() == 0 ? 1500 : body.kelvin_at_one();
        // Below, a flame would be as many times brighter as there are no numbers for.
        if (!(one >= 500 && one <= 40000))
            refuse(where + ".black_body.kelvin_at_one", fmt::format("is {}; it wants 500 to 40000", one));
        else
            out.black_body = std::make_shared<const BlackBody>(one);
    }
    if (from.weight().empty()) return out;
    out.weight = channel(frame, from.weight(), 1, where + ".weight");
    if (!from.has_ramp() && !from.has_black_body())
        refuse(where + ".weight", "multiplies a ramp or a black_body, and there is neither");
    return out;
}

MediumSettings WorldBinder::medium(const Medium& from, const std::string& where) {
    MediumSettings out;
    const std::uint32_t frame = frameOf(from.dataset(), where + ".dataset");
    out.density = densityOf(frame, from.density(), where + ".density");
    if (offsets_[frame]) out.sample_offset = offsets_[frame]->value;
    out.filter = filter(from.filter(), where + ".filter");
    if (from.has_transfer())
        transfer(from, where, out);
    else
        scatter(from, where, out);
    if (!from.velocity().empty()) out.velocity = channel(frame, from.velocity(), 3, where + ".velocity");
    if (from.velocity().empty() && from.velocity_scale() != 0)
        refuse(where + ".velocity", "is missing; velocity_scale is of a channel");
    out.velocity_scale = take(scaleEntry(from.velocity_scale(), 1, where + ".velocity_scale"));
    return out;
}

}  // namespace brickyard

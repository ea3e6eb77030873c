// Lights of bindWorld().
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>

#include "client/world_binder.h"
#include "core/printable_name.h"

namespace brickyard {

namespace {

using Kind = WorldLight::Kind;

constexpr const char* kKindNames[] = {"directional", "point", "spot", "environment"};
// More directions than that are no faster than `--quality path`.
constexpr std::uint32_t kMostSamples = 4096;

constexpr unsigned of(Kind kind) { return 1u << unsigned(kind); }

struct LightEntry {
    const char* name;
    bool given;
    unsigned kinds;
};

std::array<LightEntry, 11> entriesOf(const Light& light) {
    constexpr unsigned kAimed = of(Kind::kDirectional) | of(Kind::kSpot),
                       kPlaced = of(Kind::kPoint) | of(Kind::kSpot);
    return {{{"direction", !light.direction().empty(), kAimed},
             {"irradiance", !light.irradiance().empty(), of(Kind::kDirectional)},
             {"position", !light.position().empty(), kPlaced},
             {"intensity", !light.intensity().empty(), kPlaced},
             {"cone_degrees", light.cone_degrees() != 0, of(Kind::kSpot)},
             {"cone_softness", light.cone_softness() != 0, of(Kind::kSpot)},
             {"radiance", !light.radiance().empty(), of(Kind::kEnvironment)},
             {"image", !light.image().empty(), of(Kind::kEnvironment)},
             {"up", !light.up().empty(), of(Kind::kEnvironment)},
             {"rotation_degrees", light.rotation_degrees() != 0, of(Kind::kEnvironment)},
             {"samples", light.samples() != 0, of(Kind::kEnvironment)}}};
}

// What the entries tell where nobody says; the first that only one kind has decides.
Kind inferredKind(const Light& light) {
    if (!light.irradiance().empty()) return Kind::kDirectional;
    if (light.cone_degrees() != 0 || light.cone_softness() != 0) return Kind::kSpot;
    if (!light.position().empty() || !light.intensity().empty())
        return light.direction().empty() ? Kind::kPoint : Kind::kSpot;
    if (!light.radiance().empty() || !light.image().empty() || light.visible()) return Kind::kEnvironment;
    return Kind::kDirectional;
}

}  // namespace

std::optional<ShadowMethod> shadowMethod(const std::string& name) {
    if (name == "exact") return ShadowMethod::kExact;
    if (name == "deep") return ShadowMethod::kDeepMap;
    if (name == "baked") return ShadowMethod::kBaked;
    if (name == "none") return ShadowMethod::kNone;
    return std::nullopt;
}

glm::dvec3 WorldBinder::unit(const google::protobuf::RepeatedField<double>& numbers,
                             const glm::dvec3& otherwise, const std::string& entry) {
    const glm::dvec3 v = take(vectorEntry(numbers, otherwise, entry));
    const double length = glm::length(v);
    if (length > 0 && std::isfinite(length)) return glm::normalize(v);
    refuse(entry, "has no length");
    return otherwise;
}

Kind WorldBinder::lightKind(const Light& from, const std::string& where) {
    Kind kind = inferredKind(from);
    if (!from.type().empty()) {
        const auto found = std::find(std::begin(kKindNames), std::end(kKindNames), from.type());
        if (found == std::end(kKindNames))
            refuse(where + ".type", fmt::format("is '{}'; there are directional, point, spot, environment",
                                                printableName(from.type())));
        else
            kind = Kind(found - std::begin(kKindNames));
    }
    const auto entries = entriesOf(from);
    std::string own;
    for (const LightEntry& entry : entries)
        if (entry.kinds & of(kind)) own += (own.empty() ? "" : ", ") + std::string(entry.name);
    for (const LightEntry& entry : entries)
        if (entry.given && !(entry.kinds & of(kind)))
            refuse(fmt::format("{}.{}", where, entry.name),
                   fmt::format("is not of a light of type {}; that has {}", kKindNames[unsigned(kind)], own));
    if (from.visible() && kind != Kind::kEnvironment)
        refuse(where + ".visible", fmt::format("is not of a light of type {}; only an environment is seen",
                                               kKindNames[unsigned(kind)]));
    return kind;
}

void WorldBinder::environment(const Light& from, const std::string& where, WorldLight& out) {
    const glm::dvec3 radiance = take(colorEntry(from.radiance(), glm::dvec3(1), where + ".radiance"));
    const glm::dvec3 up = unit(from.up(), {0, 0, 1}, where + ".up");
    if (!std::isfinite(from.rotation_degrees())) refuse(where + ".rotation_degrees", "is not finite");
    if (from.samples() > kMostSamples)
        refuse(where + ".samples", fmt::format("is {}; at most {}", from.samples(), kMostSamples));
    out.visible = from.visible();
    if (from.samples() != 0) out.samples = from.samples();
    if (from.image().empty()) {
        for (const char* part :
             {from.up().empty() ? "" : "up", from.rotation_degrees() == 0 ? "" : "rotation_degrees"})
            if (*part) refuse(fmt::format("{}.{}", where, part), "is of an image, and there is none");
        out.environment = std::make_shared<const EnvironmentMap>(radiance);
        return;
    }
    if (error_) return;  // no picture is read for nothing
    Result<EnvironmentMap> map =
        EnvironmentMap::read(folder_ / from.image(), radiance, up, from.rotation_degrees());
    if (map)
        out.environment = std::make_shared<const EnvironmentMap>(std::move(*map));
    else
        refuse(where + ".image", map.error().message, map.error().code);
}

void WorldBinder::shadows(const Light& from, const std::string& where, WorldLight& out) {
    if (!from.shadows().empty()) {
        if (const std::optional<ShadowMethod> method = shadowMethod(from.shadows()))
            out.shadows = *method;
        else
            refuse(where + ".shadows",
                   fmt::format("is '{}'; there are exact, deep, baked, none", printableName(from.shadows())));
    }
    if (from.baked().empty()) {
        if (out.shadows == ShadowMethod::kBaked)
            refuse(where + ".baked", "is missing; shadows baked want the channel that `brickyard bake` made");
        return;
    }
    if (out.shadows != ShadowMethod::kAuto && out.shadows != ShadowMethod::kBaked)
        refuse(where + ".baked", fmt::format("stands beside shadows {}; leave one out", from.shadows()));
    if (media_.empty())
        return refuse(where + ".baked", "is of the first medium's dataset, and there is no medium");
    const std::uint32_t frame = frameOf(media_[0].first->dataset(), media_[0].second + ".dataset");
    out.baked = channel(frame, from.baked(), 1, where + ".baked");
}

WorldLight WorldBinder::light(const Light& from, const std::string& where) {
    WorldLight out;
    out.kind = lightKind(from, where);
    const bool placed = out.kind == Kind::kPoint || out.kind == Kind::kSpot;
    if (out.kind == Kind::kEnvironment) environment(from, where, out);
    if (out.kind == Kind::kDirectional) {
        out.to_light = -unit(from.direction(), {0, -1, 0}, where + ".direction");
        out.power = take(colorEntry(from.irradiance(), out.power, where + ".irradiance"));
    }
    if (placed) {
        if (from.position().empty())
            refuse(where + ".position",
                   fmt::format("is missing; a {} light stands somewhere", kKindNames[unsigned(out.kind)]));
        out.position = take(vectorEntry(from.position(), out.position, where + ".position"));
        out.power = take(colorEntry(from.intensity(), out.power, where + ".intensity"));
    }
    if (out.kind == Kind::kSpot) {
        if (from.direction().empty())
            refuse(where + ".direction", "is missing; a spot light shines somewhere");
        out.to_light = -unit(from.direction(), {0, -1, 0}, where + ".direction");
        const double cone = from.cone_degrees() == 0 ? 45 : from.cone_degrees(),
                     softness = from.cone_softness();
        if (!(cone > 0 && cone < 180))
            refuse(where + ".cone_degrees",
                   fmt::format("is {}; it wants a number above 0 and below 180", cone));
        if (!(softness >= 0 && softness <= 1))
            refuse(where + ".cone_softness", fmt::format("is {}; it wants a number from 0 to 1", softness));
        const double half = cone * 0.5 * std::numbers::pi / 180;
        out.cos_outer = std::cos(half);
        out.cos_inner = std::cos(half * (1 - softness));
    }
    shadows(from, where, out);
    return out;
}

}  // namespace brickyard

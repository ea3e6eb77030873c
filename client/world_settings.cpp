#include "client/world_settings.h"

#include "client/world_binder.h"

namespace brickyard {

namespace {

struct FilterName {
    FieldFilter filter;
    const char* name;
};
constexpr FilterName kFilters[] = {
    {FieldFilter::kNearest, "nearest"},   {FieldFilter::kTrilinear, "trilinear"},
    {FieldFilter::kBSpline, "bspline"},   {FieldFilter::kCatmullRom, "catmull-rom"},
    {FieldFilter::kMitchell, "mitchell"}, {FieldFilter::kGaussian, "gaussian"},
};

}  // namespace

std::optional<FieldFilter> fieldFilter(const std::string& name) {
    for (const FilterName& entry : kFilters)
        if (name == entry.name) return entry.filter;
    return std::nullopt;
}

const char* toString(FieldFilter filter) {
    for (const FilterName& entry : kFilters)
        if (filter == entry.filter) return entry.name;
    return "unknown";
}

Result<WorldSettings> bindWorld(const Scene& scene, std::span<const BoundFrame> frames,
                                const std::filesystem::path& folder) {
    if (frames.empty()) return fail(ErrorCode::kInvalid, "scene: there is no frame to draw; name a dataset");
    return WorldBinder(scene, frames, folder).bind();
}

std::optional<SceneSettings> simpleScene(const WorldSettings& world) {
    if (world.media.size() != 1 || !world.surfaces.empty() || world.clip.any() || world.lights.size() > 1 ||
        world.shutter_open != 0 || world.shutter_close != 0)
        return std::nullopt;
    const MediumSettings& medium = world.media[0];
    if (medium.density.frame != 0 || medium.filter != FieldFilter::kTrilinear || medium.color ||
        medium.transfer || medium.velocity || medium.phase.kind != PhaseFunction::Kind::kHenyeyGreenstein)
        return std::nullopt;

    SceneSettings settings;
    settings.density_channel = medium.density.channel;
    settings.density_scale = medium.density_scale;
    settings.albedo = medium.albedo;
    settings.anisotropy = medium.phase.anisotropy;
    settings.background = world.background;
    if (medium.emission) {
        const MediumEmission& emission = *medium.emission;
        if (emission.channel.frame != 0 || emission.ramp || emission.black_body || emission.weight)
            return std::nullopt;
        settings.emission = EmissionSettings{emission.channel.channel, emission.scale, emission.color};
    }
    if (!world.lights.empty()) {
        const WorldLight& light = world.lights[0];
        if (light.kind != WorldLight::Kind::kDirectional || light.shadows != ShadowMethod::kAuto ||
            light.baked)
            return std::nullopt;
        settings.light = LightSettings{light.to_light, light.power};
    }
    return settings;
}

}  // namespace brickyard

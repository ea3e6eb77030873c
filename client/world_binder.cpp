#include "client/world_binder.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>

#include "client/default_scene.h"
#include "core/affine.h"
#include "core/printable_name.h"

namespace brickyard {

std::string WorldBinder::nameOf(std::uint32_t frame) const {
    // The command line's dataset stands in the place of the scene's first.
    if (frame == 0 && frames_[0].dataset.empty() && scene_.datasets_size() > 0)
        return scene_.datasets(0).name();
    return frames_[frame].dataset;
}

std::string WorldBinder::placeOf(std::uint32_t frame) const {
    const std::string name = nameOf(frame);
    return name.empty() ? "" : fmt::format(" in dataset '{}'", printableName(name));
}

std::uint32_t WorldBinder::frameOf(const std::string& dataset, const std::string& entry) {
    if (dataset.empty()) return 0;
    std::vector<std::string> names;
    for (std::uint32_t i = 0; i < frames_.size(); ++i) {
        const std::string name = nameOf(i);
        if (name == dataset) return i;
        if (!name.empty()) names.push_back(printableName(name));
    }
    refuse(
        entry,
        names.empty()
            ? fmt::format("no dataset '{}'; name it in the scene's datasets", printableName(dataset))
            : fmt::format("no dataset '{}'; there are: {}", printableName(dataset), fmt::join(names, ", ")),
        ErrorCode::kNotFound);
    return 0;
}

FieldBinding WorldBinder::channel(std::uint32_t frame, const std::string& name, unsigned components,
                                  const std::string& entry) {
    return {frame, take(channelEntry(footer(frame), name, components, entry, placeOf(frame)))};
}

FieldBinding WorldBinder::densityOf(std::uint32_t frame, const std::string& name, const std::string& entry) {
    if (!name.empty()) return channel(frame, name, 1, entry);
    return {frame, take(densityEntry(footer(frame), entry, placeOf(frame)))};
}

const ChannelFooter* WorldBinder::footerOf(const FieldBinding& binding) const {
    const FrameFooter& frame = footer(binding.frame);
    return binding.channel < std::uint32_t(frame.channels_size()) ? &frame.channels(int(binding.channel))
                                                                  : nullptr;
}

FieldFilter WorldBinder::filter(const std::string& name, const std::string& entry) {
    if (name.empty()) return FieldFilter::kTrilinear;
    if (const std::optional<FieldFilter> found = fieldFilter(name)) return *found;
    refuse(entry,
           fmt::format("is '{}'; there are nearest, trilinear, bspline, catmull-rom, mitchell, gaussian",
                       printableName(name)));
    return FieldFilter::kTrilinear;
}

// Who says nothing takes what others say of the dataset: its samples lie in one place.
template <class Entry>
void WorldBinder::noteOffset(const Entry& user, const std::string& where) {
    const std::uint32_t frame = frameOf(user.dataset(), where + ".dataset");
    if (user.sample_offset().empty()) return;
    const std::string entry = where + ".sample_offset";
    const glm::dvec3 value = take(vectorEntry(user.sample_offset(), glm::dvec3(0), entry));
    std::optional<Offset>& known = offsets_[frame];
    if (known && known->value != value)
        refuse(entry, fmt::format("differs from {}, and both are of the same dataset", known->entry));
    if (!known) known = Offset{entry, value};
}

// Transforms and sample offsets become part of the footers: here and nowhere else, so that it is once.
void WorldBinder::placeDatasets() {
    for (int i = 0; i < scene_.datasets_size(); ++i) {
        const SceneDataset& dataset = scene_.datasets(i);
        const std::string where = fmt::format("datasets[{}]", i);
        if (dataset.name().empty() && scene_.datasets_size() > 1)
            refuse(where + ".name", "is missing; several datasets are told apart by their names");
        for (int j = 0; j < i; ++j)
            if (scene_.datasets(j).name() == dataset.name())
                refuse(where + ".name", fmt::format("is '{}', as of datasets[{}]; give another",
                                                    printableName(dataset.name()), j));
        if (dataset.transform().empty()) continue;
        const std::vector<double> columns(dataset.transform().begin(), dataset.transform().end());
        if (columns.size() != 16) {
            refuse(where + ".transform", fmt::format("wants 16 numbers, and has {}", columns.size()));
            continue;
        }
        const Result<Affine> transform = Affine::fromColumns(columns);
        if (!transform) {
            refuse(where + ".transform",
                   "is no transform: 16 finite numbers, column-major, that can be inverted; the last row 0 0 "
                   "0 1");
            continue;
        }
        for (std::uint32_t f = 0; f < frames_.size() && !error_; ++f)
            if (nameOf(f) == dataset.name()) moveWorld(transform->matrix(), *frames_[f].footer);
    }
    for (std::size_t f = 0; f < frames_.size() && !error_; ++f)
        if (offsets_[f]) moveSamples(offsets_[f]->value, *frames_[f].footer);
}

SurfaceSettings WorldBinder::surface(const Surface& from, const std::string& where) {
    SurfaceSettings out;
    const std::uint32_t frame = frameOf(from.dataset(), where + ".dataset");
    const std::optional<std::uint32_t> level_set = onlyLevelSet(footer(frame));
    out.channel = from.channel().empty() && level_set ? FieldBinding{frame, *level_set}
                                                      : densityOf(frame, from.channel(), where + ".channel");
    const ChannelFooter* const channel = footerOf(out.channel);
    out.inside_below = channel && channel->grid_class() == "level set";
    out.iso = from.iso();
    if (!std::isfinite(out.iso)) refuse(where + ".iso", "is not finite");
    out.color = take(colorEntry(from.color(), out.color, where + ".color", 1));
    if (from.has_opacity()) out.opacity = from.opacity();
    if (!(out.opacity >= 0 && out.opacity <= 1))
        refuse(where + ".opacity", fmt::format("is {}; it wants a number from 0 to 1", out.opacity));
    out.specular = take(scaleEntry(from.specular(), 0, where + ".specular"));
    out.ambient_occlusion = take(scaleEntry(from.ambient_occlusion(), 0, where + ".ambient_occlusion"));
    out.normal_filter = filter(from.filter(), where + ".filter");
    if (out.normal_filter != FieldFilter::kTrilinear && out.normal_filter != FieldFilter::kBSpline)
        refuse(where + ".filter", fmt::format("is '{}'; a surface's normals have trilinear and bspline",
                                              toString(out.normal_filter)));
    return out;
}

void WorldBinder::clip(WorldClip& out) {
    const Clip& from = scene_.clip();
    if (from.low().empty() != from.high().empty())
        refuse(from.low().empty() ? "clip.low" : "clip.high", "is missing; a box has both");
    if (!from.low().empty()) {
        const glm::dvec3 low = take(vectorEntry(from.low(), glm::dvec3(0), "clip.low"));
        const glm::dvec3 high = take(vectorEntry(from.high(), glm::dvec3(0), "clip.high"));
        for (int a = 0; a < 3; ++a)
            if (!(low[a] < high[a]))
                refuse("clip.low",
                       fmt::format("is {} along {}, not below clip.high, {}", low[a], "xyz"[a], high[a]));
        out.box = {low, high};
    }
    for (int i = 0; i < from.planes_size(); ++i) {
        const std::string where = fmt::format("clip.planes[{}]", i);
        WorldClip::Plane plane;
        plane.point = take(vectorEntry(from.planes(i).point(), plane.point, where + ".point"));
        if (from.planes(i).normal().empty()) refuse(where + ".normal", "is missing");
        plane.normal = unit(from.planes(i).normal(), plane.normal, where + ".normal");
        out.planes.push_back(plane);
    }
}

void WorldBinder::shutter(WorldSettings& world) {
    world.shutter_open = scene_.shutter().open();
    world.shutter_close = scene_.shutter().close();
    if (!std::isfinite(world.shutter_open)) refuse("shutter.open", "is not finite");
    if (!std::isfinite(world.shutter_close)) refuse("shutter.close", "is not finite");
    if (world.shutter_close < world.shutter_open)
        refuse("shutter.close",
               fmt::format("is {}, before shutter.open, {}", world.shutter_close, world.shutter_open));
    if (world.shutter_open == 0 && world.shutter_close == 0) return;
    for (const MediumSettings& medium : world.media)
        if (medium.velocity) return;
    refuse("shutter", "nothing moves; name a medium's velocity channel");
}

Result<WorldSettings> WorldBinder::bind() {
    WorldSettings world;
    if (scene_.has_medium() && scene_.media_size() > 0)
        refuse("medium", "stands beside media; leave one out");
    if (scene_.has_frame() && !(std::isfinite(scene_.frame()) && scene_.frame() >= 0))
        refuse("frame", fmt::format("is {}; it wants a number of at least 0", scene_.frame()));

    // A scene that says nothing at all is a dataset drawn without one: as a medium, whatever it is.
    const bool open = !scene_.has_medium() && scene_.media().empty() && scene_.surfaces().empty();
    const Scene otherwise = open && scene_.ByteSizeLong() > 0 ? defaultScene(footer(0)) : Scene();
    const auto& surfaces = open ? otherwise.surfaces() : scene_.surfaces();
    const auto& lights = scene_.lights().empty() ? otherwise.lights() : scene_.lights();
    for (int i = 0; i < scene_.media_size(); ++i)
        media_.emplace_back(&scene_.media(i), fmt::format("media[{}]", i));
    if (scene_.has_medium() || (open && surfaces.empty())) media_.emplace_back(&scene_.medium(), "medium");

    for (const auto& [medium, where] : media_) noteOffset(*medium, where);
    for (int i = 0; i < surfaces.size(); ++i) noteOffset(surfaces[i], fmt::format("surfaces[{}]", i));
    placeDatasets();
    for (const auto& [from, where] : media_) world.media.push_back(medium(*from, where));
    for (int i = 0; i < lights.size(); ++i)
        world.lights.push_back(light(lights[i], fmt::format("lights[{}]", i)));
    for (int i = 0; i < surfaces.size(); ++i)
        world.surfaces.push_back(surface(surfaces[i], fmt::format("surfaces[{}]", i)));
    clip(world.clip);
    shutter(world);
    const glm::dvec3 grey(world.background[0], world.background[1], world.background[2]);
    const glm::dvec3 background = take(vectorEntry(scene_.background(), grey, "background"));
    for (int c = 0; c < 3; ++c) world.background[std::size_t(c)] = float(background[c]);
    if (error_) return tl::unexpected(*error_);
    return world;
}

}  // namespace brickyard

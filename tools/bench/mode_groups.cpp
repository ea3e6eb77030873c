#include "tools/bench/mode_groups.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>

#include "tools/quality_preset.h"

namespace brickyard {
namespace {

// Pixels a side: of pictures that are quick, of those whose truth is not, and of those that follow paths.
constexpr std::uint32_t kQuickEdge = 128, kSlowEdge = 64, kPathEdge = 40;
// Paths and rays a pixel of a picture that stands for the truth of those with few. Its own noise is taken
// into account.
constexpr std::uint32_t kTruePaths = 768, kTrueRays = 128, kQuickTruth = 16;
// Smaller pictures are a quick look, whose truth has kQuickTruth.
constexpr std::uint32_t kQuickLook = 32;
// Of an environment.
constexpr std::uint32_t kTrueDirections = 96;
// Along each edge of a pixel, where the rays of the truth lie on a grid.
constexpr std::uint32_t kTrueGrid = 8;
// Another sequence of random numbers than that of the pictures that are held to it.
constexpr std::uint64_t kTrueSeed = 7919;
// Voxels by which the fastest part of the medium moves while the shutter is open.
constexpr double kMotionVoxels = 8;
constexpr double kShutter = 0.5;
// Asked for where the error of something else is looked at.
constexpr double kKernelError = 0.01;
// Of the largest value: where the surface is.
constexpr double kIsoShare = 0.25;

const ChannelFooter* channelOf(const ModeSubject& subject,
                               const std::function<bool(const ChannelFooter&)>& is) {
    for (const ChannelFooter& channel : subject.footer.channels())
        if (channel.active_voxels() > 0 && is(channel)) return &channel;
    return nullptr;
}

double voxelOf(const ChannelFooter& channel) {
    const auto& m = channel.index_to_world();
    return std::cbrt(std::abs(m[0] * (m[5] * m[10] - m[9] * m[6]) - m[4] * (m[1] * m[10] - m[9] * m[2]) +
                              m[8] * (m[1] * m[6] - m[5] * m[2])));
}

void addSun(Scene& scene, const std::string& baked) {
    Light& light = *scene.add_lights();
    for (const double d : {-0.4, 0.3, -0.85}) light.add_direction(d);
    for (int c = 0; c < 3; ++c) light.add_irradiance(10);
    if (!baked.empty()) light.set_baked(baked);
}

void addEnvironment(Scene& scene, std::uint32_t samples) {
    Light& light = *scene.add_lights();
    light.set_type("environment");
    for (int c = 0; c < 3; ++c) light.add_radiance(1);
    light.set_samples(samples);
}

class GroupMaker {
public:
    GroupMaker(const ModeSubject& subject, std::uint32_t most_edge)
        : subject_(subject), most_edge_(most_edge) {
        if (most_edge < kQuickLook) true_paths_ = true_rays_ = kQuickTruth;
    }

    std::optional<ModeGroup> make(const std::string& name) {
        edge_ = std::min(most_edge_, kQuickEdge);
        if (name == "presets") return presets(name, /*lit=*/false);
        if (name == "kernels") return kernels();
        if (name == "supersampling") return supersampling();
        if (name == "transfer") return transfer();
        if (name == "surface") return surface();
        edge_ = std::min(most_edge_, kSlowEdge);
        if (name == "light") return presets(name, /*lit=*/true);
        if (name == "shadows") return shadows();
        if (name == "motion") return motion();
        edge_ = std::min(most_edge_, kPathEdge);
        return name == "path" ? path() : environment();
    }

private:
    // Drawn the general way: shadows that are asked for are none of the fast way's.
    RenderRequest base(const QualitySettings& quality, ShadowMethod shadows = ShadowMethod::kDeepMap) const {
        RenderRequest request;
        request.width = request.height = edge_;
        request.camera = subject_.camera;
        request.density_scale = subject_.density_scale;
        request.scene.mutable_medium()->set_density(subject_.density);
        request.quality = quality;
        request.shadows = shadows;
        return request;
    }
    RenderRequest lit(const QualitySettings& quality, ShadowMethod shadows = ShadowMethod::kDeepMap) const {
        RenderRequest request = base(quality, shadows);
        addSun(request.scene, shadows == ShadowMethod::kBaked ? subject_.baked : "");
        return request;
    }
    static RenderRequest fast(RenderRequest request) {
        request.shadows.reset();
        return request;
    }
    static QualitySettings reference() { return {.reference = true}; }
    static QualitySettings error(double most) { return {.max_error = most}; }
    static ModeTruth noisy(RenderRequest request, std::uint32_t samples) {
        request.samples = samples;
        request.seed = kTrueSeed;
        return {std::move(request)};
    }

    static void addPresets(ModeGroup& group,
                           const std::function<RenderRequest(const QualitySettings&)>& made) {
        for (const char* preset : {"draft", "preview", "final"})
            group.rows.push_back({preset, made(*qualityPreset(preset))});
    }
    static void addErrors(ModeGroup& group, const std::string& before,
                          const std::function<RenderRequest(const QualitySettings&)>& made) {
        for (const double most : {0.1, 0.01, 0.001})
            group.rows.push_back({fmt::format("{}max-error {}", before, most), made(error(most))});
    }

    ModeGroup presets(const std::string& name, bool lit_up) const {
        ModeGroup group{name,        lit_up ? "reference, exact shadows" : "the fast way's reference",
                        "reference", !lit_up,
                        {},          {}};
        const auto made = [&](const QualitySettings& quality) {
            const ShadowMethod shadows = quality.reference ? ShadowMethod::kExact : ShadowMethod::kDeepMap;
            return lit_up ? lit(quality, shadows) : base(quality, shadows);
        };
        const RenderRequest exact = made(reference());
        // The fast way's lattices of light have an error of their own, which exact shadows have not.
        group.truths.push_back({lit_up ? exact : fast(exact)});
        if (lit_up)
            group.rows.push_back({"reference", {}, 0, 0});
        else
            group.rows.push_back({"reference", exact});
        addPresets(group, made);
        addErrors(group, "", made);
        for (const char* preset : kQualityPresets)
            group.rows.push_back(
                {fmt::format("{}, the fast way", preset), fast(made(*qualityPreset(preset)))});
        return group;
    }

    ModeGroup shadows() const {
        ModeGroup group{"shadows", "reference, exact shadows", "exact, reference", false, {}, {}};
        group.truths.push_back({lit(reference(), ShadowMethod::kExact)});
        std::vector<std::pair<std::string, ShadowMethod>> methods{{"exact", ShadowMethod::kExact},
                                                                  {"deep", ShadowMethod::kDeepMap}};
        if (!subject_.baked.empty()) methods.emplace_back("baked", ShadowMethod::kBaked);
        for (const auto& [name, method] : methods) {
            if (method == ShadowMethod::kExact)
                group.rows.push_back({name + ", reference", {}, 0, 0});
            else
                group.rows.push_back({name + ", reference", lit(reference(), method)});
            addErrors(group, name + ", ",
                      [&, shadow = method](const QualitySettings& quality) { return lit(quality, shadow); });
        }
        return group;
    }

    ModeGroup kernels() const {
        ModeGroup group{"kernels", "reference of the same kernel, or trilinear", "trilinear", true, {}, {}};
        for (const char* name : {"trilinear", "nearest", "bspline", "catmull-rom", "mitchell", "gaussian"}) {
            RenderRequest request = base(error(kKernelError));
            request.filter = fieldFilter(name);
            const std::size_t truth = group.truths.size();
            group.rows.push_back({name, request, truth});
            request.quality = reference();
            group.truths.push_back({request});
            if (truth > 0)
                group.rows.push_back({fmt::format("{}, reference, against trilinear", name),
                                      {},
                                      0,
                                      truth,
                                      1,
                                      /*silent=*/true});
        }
        return group;
    }

    ModeGroup supersampling() const {
        ModeGroup group{"supersampling",
                        fmt::format("{} x {} rays a pixel of the fast way's reference", kTrueGrid, kTrueGrid),
                        "spp 4",
                        true,
                        {},
                        {}};
        RenderRequest truth = fast(base(reference()));
        truth.width = truth.height = edge_ * kTrueGrid;
        group.truths.push_back({truth, kTrueGrid});
        for (const bool whole : {false, true}) {
            const QualitySettings quality = whole ? reference() : *qualityPreset("final");
            const char* const suffix = whole ? ", reference" : "";
            for (const std::uint32_t samples : {1u, 4u, 16u}) {
                ModeRow row{fmt::format("spp {}{}", samples, suffix), base(quality)};
                row.request.samples = samples;
                row.silent = samples == 1;
                group.rows.push_back(row);
            }
            // `--samples 4`: a regular grid.
            for (const bool quick : {false, true}) {
                QualitySettings doubled = quality;
                doubled.pixels_per_voxel *= 2;
                ModeRow row{fmt::format("samples 4{}{}", suffix, quick ? ", the fast way" : ""),
                            quick ? fast(base(doubled)) : base(doubled)};
                row.request.width = row.request.height = 2 * edge_;
                row.grid_edge = 2;
                row.silent = true;
                group.rows.push_back(row);
            }
        }
        return group;
    }

    ModeGroup path() const {
        ModeGroup group{"path", fmt::format("{} other paths, finest level", true_paths_), "spp 16", false, {},
                        {}};
        const auto made = [&](std::uint32_t samples, const QualitySettings& quality) {
            RenderRequest request = lit(quality);
            addEnvironment(request.scene, /*samples=*/0);
            request.path = true;
            request.samples = samples;
            return request;
        };
        group.truths.push_back(noisy(made(0, reference()), true_paths_));
        // Levels of detail have an error of their own, which more paths do not remove.
        for (const bool whole : {false, true})
            for (const std::uint32_t samples : {4u, 16u, 64u})
                group.rows.push_back({fmt::format("spp {}{}", samples, whole ? ", finest level" : ""),
                                      made(samples, whole ? reference() : *qualityPreset("final"))});
        for (const double most : {0.3, 0.1})
            group.rows.push_back({fmt::format("max-error {}", most), made(0, error(most))});
        return group;
    }

    ModeGroup transfer() const {
        ModeGroup group{"transfer", "reference", "reference", false, {}, {}};
        const auto made = [&](const QualitySettings& quality) {
            RenderRequest request = base(quality);
            request.scene.mutable_medium()->mutable_transfer()->set_preset("viridis");
            return request;
        };
        group.truths.push_back({made(reference())});
        group.rows.push_back({"reference", {}, 0, 0});
        addPresets(group, made);
        addErrors(group, "", made);
        return group;
    }

    ModeGroup environment() const {
        ModeGroup group{"environment",
                        fmt::format("{} directions, reference", kTrueDirections),
                        "24 directions",
                        false,
                        {},
                        {}};
        const auto made = [&](std::uint32_t directions, const QualitySettings& quality) {
            RenderRequest request = base(quality);
            addEnvironment(request.scene, directions);
            return request;
        };
        group.truths.push_back({made(kTrueDirections, reference())});
        for (const std::uint32_t directions : {4u, 12u, 24u, 48u})
            group.rows.push_back({fmt::format("{} directions", directions), made(directions, reference())});
        group.rows.push_back({"24 directions, max-error 0.01", made(24, error(kKernelError))});
        return group;
    }

    std::optional<ModeGroup> surface() const {
        const ChannelFooter* channel =
            channelOf(subject_, [&](const ChannelFooter& one) { return one.name() == subject_.density; });
        if (!channel) return std::nullopt;
        ModeGroup group{"surface",   fmt::format("reference; of spp, {} rays a pixel", true_rays_),
                        "reference", false,
                        {},          {}};
        const auto made = [&](const QualitySettings& quality) {
            RenderRequest request = lit(quality);
            request.density_scale.reset();
            request.scene.clear_medium();
            Surface& surface = *request.scene.add_surfaces();
            surface.set_channel(subject_.density);
            surface.set_iso(kIsoShare * channel->value_max());
            return request;
        };
        group.truths.push_back({made(reference())});
        group.truths.push_back(noisy(made(reference()), true_rays_));
        group.rows.push_back({"reference", {}, 0, 0});
        addPresets(group, made);
        for (const std::uint32_t samples : {4u, 16u}) {
            RenderRequest request = made(reference());
            request.samples = samples;
            group.rows.push_back({fmt::format("spp {}, reference", samples), request, /*truth=*/1});
        }
        return group;
    }

    std::optional<ModeGroup> motion() const {
        const ChannelFooter* velocity =
            channelOf(subject_, [](const ChannelFooter& one) { return one.components() == 3; });
        if (!velocity) return std::nullopt;
        const double fastest = std::max(std::abs(velocity->value_min()), std::abs(velocity->value_max()));
        if (!(fastest > 0)) return std::nullopt;
        ModeGroup group{"motion", fmt::format("{} rays a pixel, reference", true_rays_), "spp 4", true, {},
                        {}};
        const auto made = [&](std::uint32_t samples, const QualitySettings& quality) {
            RenderRequest request = base(quality);
            request.samples = samples;
            Medium& medium = *request.scene.mutable_medium();
            medium.set_velocity(velocity->name());
            medium.set_velocity_scale(kMotionVoxels * voxelOf(*velocity) / (kShutter * fastest));
            request.scene.mutable_shutter()->set_close(kShutter);
            return request;
        };
        group.truths.push_back(noisy(made(1, reference()), true_rays_));
        for (const std::uint32_t samples : {1u, 4u, 16u})
            group.rows.push_back({fmt::format("spp {}, reference", samples), made(samples, reference())});
        for (const std::uint32_t samples : {4u, 16u})
            group.rows.push_back({fmt::format("spp {}", samples), made(samples, *qualityPreset("final"))});
        return group;
    }

    const ModeSubject& subject_;
    const std::uint32_t most_edge_;
    std::uint32_t true_paths_ = kTruePaths, true_rays_ = kTrueRays;
    std::uint32_t edge_ = 0;  // pixels a side, of the group that is being made
};

}  // namespace

Scene sunlitScene(const ModeSubject& subject) {
    Scene scene;
    scene.mutable_medium()->set_density(subject.density);
    scene.mutable_medium()->set_density_scale(subject.density_scale);
    addSun(scene, "");
    return scene;
}

std::vector<ModeGroup> modeGroups(const ModeSubject& subject, std::uint32_t most_edge,
                                  const std::vector<std::string>& names) {
    std::vector<ModeGroup> groups;
    GroupMaker maker(subject, most_edge);
    for (const char* name : kModeGroups) {
        if (!names.empty() && std::find(names.begin(), names.end(), name) == names.end()) continue;
        if (std::optional<ModeGroup> group = maker.make(name)) groups.push_back(std::move(*group));
    }
    return groups;
}

}  // namespace brickyard

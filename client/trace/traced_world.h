// A scene with its channels opened: what every tracer of a picture shares. Made by one thread, in steps, as
// topology arrives; immutable while rays are traced: any thread.
//
// All is relative to an origin of its own, near what is drawn, so that a world at 1e12 has digits left.
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "client/cpu/channel_ray.h"
#include "client/cpu/render_plan.h"
#include "client/paged_channel.h"
#include "client/trace/channel_reader.h"
#include "client/trace/majorant_grid.h"
#include "client/world_settings.h"

namespace brickyard {

// An opened channel of one of the picture's frames.
struct TracedChannel {
    std::uint32_t frame = 0;  // index of the stream whose cache holds it
    const PagedChannel* channel = nullptr;
    explicit operator bool() const { return channel != nullptr; }
};

// A medium's channels in one frame.
struct MediumChannels {
    TracedChannel density, emission, weight, color, velocity;
};

struct TracedMedium {
    const MediumSettings* settings = nullptr;
    MediumChannels now, next;              // next.density: only between two frames
    bool both_signs = false;               // densities may be below 0 in one place and above in another
    double between = 0;                    // weight of `next`
    bool advects = false;                  // between frames
    double time_open = 0, time_close = 0;  // of the shutter, frames
    ReadAccuracy density_accuracy, other_accuracy;
    // Index units that coarse levels, which shadow maps are made of, spread what there is into empty cells.
    double shadow_spread = 0;
    double pixels_per_voxel = 0;         // as QualitySettings
    glm::dvec3 box_low{0}, box_high{0};  // index space of `now`'s density
    MajorantGrid majorants;
    bool glows() const { return settings->emission.has_value(); }
    const Affine& transform() const { return now.density.channel->transform(); }
    bool moves() const { return bool(now.velocity) && (time_close > time_open || (next.density && advects)); }
};

struct TracedSurface {
    const SurfaceSettings* settings = nullptr;
    TracedChannel channel;
    int level = 0;  // one for the whole picture: no cracks
};

// A light as single scattering uses it: an environment has become many distant ones.
struct TracedLight {
    WorldLight light;
    ShadowMethod shadows = ShadowMethod::kAuto;
    std::size_t baked = SIZE_MAX;  // index in TracedWorld::baked
    bool of_environment = false;
};

struct TracedWorld {
    WorldSettings settings;
    QualitySettings quality;
    const PinholeCamera* camera = nullptr;  // relative to the origin
    std::vector<TracedMedium> media;
    std::vector<TracedSurface> surfaces;
    std::vector<TracedLight> lights;
    bool has_environment = false;
    double level_deviation = 0;          // of the optical depth through all, that levels were chosen for
    std::vector<TracedChannel> baked;    // by light of the settings; none where it is not
    glm::dvec3 box_low{0}, box_high{0};  // world, of everything

    // Level of detail at a point: levels whose voxels, seen from the camera, are below so many pixels.
    double lodAt(const TracedMedium& medium, const glm::dvec3& point) const;
    // What of a ray is inside the clip.
    RaySpan clipped(const WorldRay& ray, RaySpan span) const;
};

// Fills in `medium.majorants`, for levels of detail up to `coarsest`. False where tree blocks are missing
// (they are wanted). `contexts`: one a frame.
bool makeMajorants(TracedMedium& medium, int coarsest, std::span<const RayContext> contexts);

// Extinction per world unit of a density (or of a value that a transfer function maps).
inline double extinctionOf(const MediumSettings& medium, double value) {
    if (medium.transfer) return medium.density_scale * medium.transfer->at(value).opacity;
    return value > 0 ? medium.density_scale * value : 0;
}

}  // namespace brickyard

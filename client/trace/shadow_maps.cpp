#include "client/trace/shadow_maps.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "client/trace/light_reach.h"

namespace brickyard {

namespace {

// Pixels along the longest edge of a map: as fine as the medium, within reason. A part of an environment is
// one of many, and its neighbours blur it.
constexpr double kLeastEdge = 64, kMostEdge = 512, kMostPartEdge = 64;
// Of the error that a picture may have, what the compression of a map may make.
constexpr double kErrorShare = 0.2;
constexpr double kLeastError = 1e-4;
constexpr std::uint32_t kBlockPixels = 64;

// What maps have to tell apart: the finest voxels that are seen, and how many of them there are.
struct Scale {
    explicit Scale(const TracedWorld& world) {
        const glm::dvec3 size = world.box_high - world.box_low;
        const glm::dvec3 nearest = glm::clamp(world.camera->eye(), world.box_low, world.box_high);
        longest = std::max({size.x, size.y, size.z});
        for (const TracedMedium& medium : world.media) {
            const double seen = world.lodAt(medium, nearest);
            lod = std::min(lod, seen);
            voxel = std::min(voxel, medium.transform().voxelSize() * std::exp2(seen));
        }
        for (const TracedSurface& surface : world.surfaces)
            voxel =
                std::min(voxel, surface.channel.channel->transform().voxelSize() * std::exp2(surface.level));
        if (!std::isfinite(lod)) lod = 0;
    }
    bool empty() const { return !(longest > 0) || !std::isfinite(voxel); }

    double longest = 0;  // edge of all, world
    double voxel = std::numeric_limits<double>::infinity();
    double lod = std::numeric_limits<double>::infinity();
};

}  // namespace

double ShadowMaps::coarserBy(const TracedWorld& world) {
    const bool maps = std::any_of(world.lights.begin(), world.lights.end(), [](const TracedLight& light) {
        return light.shadows == ShadowMethod::kDeepMap;
    });
    const Scale scale(world);
    if (!maps || world.quality.reference || scale.empty()) return 0;
    return std::max(
        0.0, std::log2(scale.longest / scale.voxel / (world.has_environment ? kMostPartEdge : kMostEdge)));
}

ShadowMaps::ShadowMaps(const TracedWorld& world) : world_(world), maps_(world.lights.size()) {
    const WorldBox box{world.box_low, world.box_high};
    const Scale scale(world);
    if (scale.empty()) return;
    const double longest = scale.longest, voxel = scale.voxel, lod = scale.lod;
    const double error = std::max(kLeastError, kErrorShare * world.quality.max_error);
    for (std::size_t l = 0; l < world.lights.size(); ++l) {
        const TracedLight& light = world.lights[l];
        if (light.shadows != ShadowMethod::kDeepMap) continue;
        const double edge =
            std::clamp(longest / voxel, kLeastEdge, light.of_environment ? kMostPartEdge : kMostEdge);
        const auto pixels = std::uint32_t(edge);
        const WorldLight& is = light.light;
        const LightProjection projection =
            is.kind == WorldLight::Kind::kPoint ? LightProjection::point(is.position, box, pixels)
            : is.kind == WorldLight::Kind::kSpot
                ? LightProjection::spot(is.position, is.to_light, is.cos_outer, box, pixels)
                : LightProjection::directional(is.to_light, box, pixels);
        maps_[l] = std::make_unique<DeepShadowMap>(projection, error);
        for (std::uint32_t begin = 0; begin < projection.pixelCount(); begin += kBlockPixels)
            // Detail below a pixel of the map is filtered, as it is for the camera.
            blocks_.push_back(
                {l, begin, std::min(begin + kBlockPixels, projection.pixelCount()),
                 world.quality.reference ? lod : lod + std::max(0.0, std::log2(longest / voxel / edge))});
    }
}

std::uint32_t ShadowMaps::fill(std::size_t index, bool stop_at_miss, WorldReader& reader,
                               SurfaceHits* surfaces) {
    Block& block = blocks_[index];
    std::uint32_t done = 0;
    bool missed = false;
    for (std::uint32_t pixel = block.next; pixel < block.end && !(missed && stop_at_miss); ++pixel) {
        fillPixel(block, pixel, reader, surfaces);
        missed |= reader.takeMissed();
        if (surfaces) missed |= surfaces->takeMissed();
        if (missed) continue;
        ++block.next;
        ++done;
    }
    return done;
}

void ShadowMaps::fillPixel(const Block& block, std::uint32_t pixel, WorldReader& reader,
                           SurfaceHits* surfaces) {
    // Behind this depth nothing is seen of what is lit.
    constexpr double kDark = 24;
    DeepShadowMap& map = *maps_[block.light];
    WorldRay ray = map.projection().ray(pixel);
    const RaySpan whole = map.projection().span(pixel);
    if (whole.empty()) return;
    // From where it meets the box: a light may be far.
    ray.origin += whole.begin * ray.direction;
    const RaySpan span{0, whole.end - whole.begin};
    const double moment = 0.5 * (world_.settings.shutter_open + world_.settings.shutter_close);
    std::vector<ShadowVertex> curve;
    double depth = 0;
    auto media = [&](RaySpan part) {
        MediaWalk walk(reader, ray, part, moment, block.lod);
        for (RaySpan stretch; depth < kDark && walk.next(stretch);) {
            double own = 0;
            for (std::size_t m = 0; m < walk.mediumCount(); ++m)
                if (walk.active(m) && walk.majorant(m).extinction > 0)
                    own += stretchDepth(reader.media[m], walk, m, stretch, moment);
            if (own == 0) continue;
            if (curve.empty() || curve.back().distance < stretch.begin)
                curve.push_back({stretch.begin, depth});
            depth += own;
            curve.push_back({stretch.end, depth});
        }
    };
    double from = span.begin;
    if (surfaces)
        for (const PlacedHit& hit : surfaces->along(ray, span)) {
            const double at = std::clamp(hit.hit.t, from, span.end);
            media({from, at});
            curve.push_back({at, depth});
            depth -= std::log1p(-std::min(world_.surfaces[hit.surface].settings->opacity, 1.0));
            curve.push_back({at, depth});
            from = at;
        }
    media({from, span.end});
    for (ShadowVertex& vertex : curve) vertex.distance += whole.begin;
    map.set(pixel, curve);
}

void ShadowMaps::calibrate() {
    for (const std::unique_ptr<DeepShadowMap>& map : maps_)
        if (map) map->calibrate();
}

std::optional<Reach> ShadowMaps::at(std::size_t light, const glm::dvec3& point) const {
    if (!maps_[light]) return std::nullopt;
    Reach reach;
    reach.transmittance = maps_[light]->transmittance(point, &reach.deviation);
    return reach;
}

std::uint64_t ShadowMaps::bytes() const {
    std::uint64_t sum = 0;
    for (const std::unique_ptr<DeepShadowMap>& map : maps_)
        if (map) sum += map->bytes();
    return sum;
}

}  // namespace brickyard

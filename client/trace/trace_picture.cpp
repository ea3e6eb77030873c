// Opening a scene: frames, channels, lights, accuracy.

#include "client/trace/trace_picture.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <thread>

#include "core/camera_framing.h"

namespace brickyard {

namespace {

// Of a pixel's standard deviation, what levels of detail of the density may make.
constexpr double kLevelShare = 0.5;
// Errors below which a map of shadows would have to be finer than it can be.
constexpr double kExactBelow = 5e-4;

bool simpleLight(const Light& light) {
    return light.type().empty() || light.type() == "directional"
               ? !light.direction().empty() && light.shadows().empty() && light.baked().empty()
               : false;
}

bool simpleMedium(const Medium& medium) {
    const Emission& emission = medium.emission();
    return medium.dataset().empty() && (medium.phase().empty() || medium.phase() == "henyey-greenstein") &&
           medium.color().empty() && !medium.has_transfer() &&
           (medium.filter().empty() || medium.filter() == "trilinear") && !emission.has_ramp() &&
           !emission.has_black_body() && emission.weight().empty();
}

}  // namespace

bool drawnByBeams(const RenderRequest& request) {
    const Scene& scene = request.scene;
    const bool placed = std::any_of(scene.datasets().begin(), scene.datasets().end(),
                                    [](const SceneDataset& dataset) { return !dataset.transform().empty(); });
    return !request.path && request.samples == 1 && request.between == 0 && request.others.empty() &&
           (!request.filter || *request.filter == FieldFilter::kTrilinear) &&
           (!request.shadows || *request.shadows == ShadowMethod::kAuto) && !request.behind && !placed &&
           scene.media().empty() && scene.surfaces().empty() && !scene.has_clip() && !scene.has_shutter() &&
           scene.lights_size() <= 1 &&
           std::all_of(scene.lights().begin(), scene.lights().end(), simpleLight) &&
           simpleMedium(scene.medium());
}

TracePicture::TracePicture(BrickSource& source, const RenderRequest& request) : request_(request) {
    streams_.emplace_back(source, request.kept);
    frames_.push_back(request.frame);
    names_.push_back(request.dataset);
    for (const RenderInput& other : request.others) {
        streams_.emplace_back(*other.source, other.kept);
        frames_.push_back(other.frame);
        names_.push_back(other.dataset);
    }
    bound_count_ = streams_.size();
    if (request.between > 0)
        for (const RenderInput& next : request.next) {
            streams_.emplace_back(*next.source, next.kept);
            frames_.push_back(next.frame);
            names_.push_back(next.dataset);
        }
}

Result<void> TracePicture::openFrames() {
    for (std::size_t i = 0; i < streams_.size(); ++i) {
        Result<FrameFooter> footer = streams_[i].open(frames_[i], deadline());
        if (!footer) return tl::unexpected(footer.error());
        footers_.push_back(std::move(*footer));
    }
    std::vector<BoundFrame> now, next;
    for (std::size_t i = 0; i < bound_count_; ++i) now.push_back({names_[i], &footers_[i]});
    Result<WorldSettings> settings = bindWorld(request_.scene, now, request_.folder);
    if (!settings) return tl::unexpected(settings.error());
    world_.settings = std::move(*settings);
    if (streams_.size() > bound_count_) {
        for (std::size_t i = 0; i < bound_count_; ++i) {
            // Datasets without a frame after stand still.
            std::size_t at = bound_count_;
            while (at < streams_.size() && names_[at] != names_[i]) ++at;
            next.push_back({names_[i], at < streams_.size() ? &footers_[at] : &footers_[i]});
        }
        Result<WorldSettings> after = bindWorld(request_.scene, next, request_.folder);
        if (!after) return tl::unexpected(after.error());
        next_settings_ = std::move(*after);
    }
    for (WorldLight& light : world_.settings.lights)
        if (light.shadows == ShadowMethod::kAuto && request_.shadows) light.shadows = *request_.shadows;
    for (WorldSettings* bound : {&world_.settings, &next_settings_})
        for (MediumSettings& medium : bound->media) {
            if (request_.filter) medium.filter = *request_.filter;
            if (request_.density_scale) medium.density_scale = *request_.density_scale;
        }
    return {};
}

// All positions become small: relative to the middle of what is drawn.
void TracePicture::moveToOrigin() {
    const FieldBinding first = !world_.settings.media.empty()      ? world_.settings.media[0].density
                               : !world_.settings.surfaces.empty() ? world_.settings.surfaces[0].channel
                                                                   : FieldBinding{};
    const ChannelFooter& channel = footers_[first.frame].channels(int(first.channel));
    const auto& m = channel.index_to_world();
    if (m.size() == 16) {
        glm::dvec3 middle(0);
        if (channel.active_min_size() == 3 && channel.active_max_size() == 3)
            for (int a = 0; a < 3; ++a)
                middle[a] = 0.5 * (double(channel.active_min(a)) + double(channel.active_max(a)));
        for (int row = 0; row < 3; ++row)
            origin_[row] = m[12 + row] + m[row] * middle.x + m[4 + row] * middle.y + m[8 + row] * middle.z;
    }
    for (FrameFooter& footer : footers_)
        for (ChannelFooter& moved : *footer.mutable_channels())
            if (moved.index_to_world_size() == 16)
                for (int row = 0; row < 3; ++row)
                    moved.set_index_to_world(12 + row, moved.index_to_world(12 + row) - origin_[row]);
    for (WorldLight& light : world_.settings.lights) light.position -= origin_;
    WorldClip& clip = world_.settings.clip;
    if (clip.box)
        for (glm::dvec3& corner : *clip.box) corner -= origin_;
    for (WorldClip::Plane& plane : clip.planes) plane.point -= origin_;
}

Result<void> TracePicture::openChannels() {
    // Vectors need larger pages.
    const bool moves = world_.settings.shutter_close > world_.settings.shutter_open ||
                       (request_.between > 0 && request_.between_by == BetweenFrames::kAdvect);
    std::vector<int> components(streams_.size(), 1);
    auto count = [&](const FieldBinding& binding, std::size_t frame) {
        components[frame] =
            std::max(components[frame], int(footers_[frame].channels(int(binding.channel)).components()));
    };
    auto nextOf = [&](std::uint32_t frame) -> std::size_t {
        for (std::size_t at = bound_count_; at < streams_.size(); ++at)
            if (names_[at] == names_[frame]) return at;
        return frame;
    };
    for (const MediumSettings& medium : world_.settings.media) {
        if (medium.color) count(*medium.color, medium.color->frame);
        if (moves && medium.velocity) count(*medium.velocity, medium.velocity->frame);
    }
    for (const MediumSettings& medium : next_settings_.media)
        if (moves && medium.velocity) count(*medium.velocity, nextOf(medium.velocity->frame));
    for (std::size_t i = 0; i < streams_.size(); ++i)
        if (Result<void> begun =
                streams_[i].begin(footers_[i], request_.cache_bytes / streams_.size(), components[i]);
            !begun)
            return begun;

    Result<void> result;
    auto openAt = [&](const FieldBinding& binding, std::size_t frame) -> TracedChannel {
        Result<PagedChannel*> channel = streams_[frame].channel(binding.channel);
        if (!channel) {
            if (result) result = tl::unexpected(channel.error());
            return {};
        }
        return {std::uint32_t(frame), *channel};
    };
    auto openMedium = [&](const MediumSettings& medium, bool next) {
        auto frameOf = [&](const FieldBinding& binding) -> std::size_t {
            return next ? nextOf(binding.frame) : binding.frame;
        };
        MediumChannels channels;
        channels.density = openAt(medium.density, frameOf(medium.density));
        if (medium.emission) {
            channels.emission = openAt(medium.emission->channel, frameOf(medium.emission->channel));
            if (medium.emission->weight)
                channels.weight = openAt(*medium.emission->weight, frameOf(*medium.emission->weight));
        }
        if (medium.color) channels.color = openAt(*medium.color, frameOf(*medium.color));
        if (moves && medium.velocity) channels.velocity = openAt(*medium.velocity, frameOf(*medium.velocity));
        return channels;
    };
    world_.media.reserve(world_.settings.media.size());
    for (std::size_t m = 0; m < world_.settings.media.size(); ++m) {
        TracedMedium medium;
        medium.settings = &world_.settings.media[m];
        medium.now = openMedium(*medium.settings, false);
        if (!result) return result;
        if (m < next_settings_.media.size() &&
            nextOf(medium.settings->density.frame) != medium.settings->density.frame) {
            medium.next = openMedium(next_settings_.media[m], true);
            if (!result) return result;
            medium.between = request_.between;
            medium.advects =
                request_.between_by == BetweenFrames::kAdvect && medium.now.velocity && medium.next.velocity;
        }
        const PagedChannel& density = *medium.now.density.channel;
        medium.both_signs = density.valueMin() < 0 || density.background() < 0;
        medium.time_open = world_.settings.shutter_open;
        medium.time_close = world_.settings.shutter_close;
        // Nothing to draw: it is left out.
        if (!medium.now.density.channel->empty()) world_.media.push_back(std::move(medium));
    }
    for (const SurfaceSettings& surface : world_.settings.surfaces) {
        TracedSurface traced{&surface, openAt(surface.channel, surface.channel.frame), 0};
        if (!result) return result;
        if (!traced.channel.channel->empty()) world_.surfaces.push_back(traced);
    }
    for (const WorldLight& light : world_.settings.lights)
        world_.baked.push_back(light.baked ? openAt(*light.baked, light.baked->frame) : TracedChannel{});
    return result;
}

void TracePicture::makeLights() {
    for (std::size_t l = 0; l < world_.settings.lights.size(); ++l) {
        const WorldLight& light = world_.settings.lights[l];
        ShadowMethod shadows = light.shadows;
        if (shadows == ShadowMethod::kAuto) shadows = request_.shadows.value_or(ShadowMethod::kAuto);
        // Left to us: what was baked is there, exact where the picture is a reference, else maps.
        if (shadows == ShadowMethod::kAuto)
            shadows = request_.quality.reference || request_.quality.max_error < kExactBelow
                          ? ShadowMethod::kExact
                      : world_.baked[l] ? ShadowMethod::kBaked
                                        : ShadowMethod::kDeepMap;
        if (shadows == ShadowMethod::kBaked && !world_.baked[l]) shadows = ShadowMethod::kDeepMap;
        if (light.kind != WorldLight::Kind::kEnvironment) {
            world_.lights.push_back({light, shadows, l, false});
            continue;
        }
        world_.has_environment = true;
        for (const EnvironmentMap::DistantLight& part : light.environment->distantLights(light.samples)) {
            WorldLight distant;
            distant.to_light = part.to_light;
            distant.power = part.irradiance;
            world_.lights.push_back({distant, shadows, l, true});
        }
    }
}

void TracePicture::setAccuracy() {
    const QualitySettings& quality = request_.quality;
    world_.quality = quality;
    world_.box_low = glm::dvec3(std::numeric_limits<double>::infinity());
    world_.box_high = -world_.box_low;
    auto add = [&](const PagedChannel& channel) {
        for (int corner = 0; corner < 8; ++corner) {
            const glm::dvec3 &low = channel.clipLow(), &high = channel.clipHigh();
            const glm::dvec3 at(corner & 1 ? high.x : low.x, corner & 2 ? high.y : low.y,
                                corner & 4 ? high.z : low.z);
            world_.box_low = glm::min(world_.box_low, channel.transform().point(at));
            world_.box_high = glm::max(world_.box_high, channel.transform().point(at));
        }
    };
    for (const TracedMedium& medium : world_.media) add(*medium.now.density.channel);
    for (const TracedSurface& surface : world_.surfaces) add(*surface.channel.channel);
    const double diagonal = glm::length(world_.box_high - world_.box_low);
    const bool limited = request_.deadline || request_.max_stream_bytes != UINT64_MAX;
    for (TracedMedium& medium : world_.media) {
        medium.density_accuracy.coarse_first = medium.other_accuracy.coarse_first = limited;
        if (quality.reference) continue;
        // A path is unbiased on the finest level; coarser ones are for who asks for an error.
        if (request_.path && quality.pixels_per_voxel > 0) continue;
        medium.pixels_per_voxel = quality.pixels_per_voxel;
        // A transfer function may make much of a small difference.
        if (medium.settings->transfer) continue;
        const double deviation = kLevelShare * quality.max_error / 3;
        world_.level_deviation = deviation;
        const double scale = std::max(medium.settings->density_scale, 1e-300);
        medium.density_accuracy.square_budget =
            deviation * deviation /
            (scale * scale * medium.transform().voxelSize() * std::max(diagonal, 1e-300));
    }
    // Surfaces: the finest level whose voxels are a pixel where they are nearest.
    if (quality.reference || !(quality.pixels_per_voxel > 0)) return;
    for (TracedSurface& surface : world_.surfaces) {
        const glm::dvec3 nearest = glm::clamp(camera_->eye(), world_.box_low, world_.box_high);
        const double pixel =
            glm::length(nearest - camera_->eye()) * camera_->pixelEdge() * quality.pixels_per_voxel;
        const double voxel = surface.channel.channel->transform().voxelSize();
        surface.level = std::clamp(int(std::floor(std::log2(std::max(pixel / voxel, 1.0)))), 0, kMaxLevel);
    }
}

Result<void> TracePicture::open() {
    threads_ = request_.threads ? request_.threads : std::max(1u, std::thread::hardware_concurrency());
    if (request_.quality.strict)
        return fail(
            ErrorCode::kUnsupported,
            "--strict: only pictures of one medium, lit by at most one directional light, have a guaranteed "
            "bound (docs/error-bounds.md); leave it out, or simplify the scene");
    if (Result<void> opened = openFrames(); !opened) return opened;
    const double aspect = double(request_.width) / double(request_.height);
    if (request_.camera)
        outcome_.camera = *request_.camera;
    else if (request_.scene.has_camera())
        outcome_.camera = request_.scene.camera();
    else {
        const FieldBinding framed = !world_.settings.media.empty()      ? world_.settings.media[0].density
                                    : !world_.settings.surfaces.empty() ? world_.settings.surfaces[0].channel
                                                                        : FieldBinding{};
        outcome_.camera = frameChannel(footers_[framed.frame].channels(int(framed.channel)), aspect);
    }
    // Errors of the camera as it was given; then the one that is near the origin.
    Result<PinholeCamera> given = PinholeCamera::create(outcome_.camera, request_.width, request_.height);
    if (!given) return tl::unexpected(given.error());
    moveToOrigin();
    camera_ = given->moved(-origin_);
    world_.camera = &*camera_;
    if (Result<void> opened = openChannels(); !opened) return opened;
    makeLights();
    setAccuracy();

    samples_ = request_.samples;
    most_samples_ = samples_ ? samples_ : 4096;
    outcome_.picture = Picture(request_.width, request_.height);
    outcome_.background = world_.settings.background;
    if (request_.explain) outcome_.why.resize(outcome_.picture.pixels.size());
    wants_.resize(streams_.size());
    makeTiles();
    return {};
}

void TracePicture::makeTiles() {
    constexpr std::uint32_t kTileEdge = 16;
    tiles_.clear();
    sums_.assign(outcome_.picture.pixels.size(), {});
    rounds_ = 0;
    for (std::uint32_t y = 0; y < request_.height; y += kTileEdge)
        for (std::uint32_t x = 0; x < request_.width; x += kTileEdge) {
            Tile tile;
            tile.x0 = x;
            tile.y0 = y;
            tile.x1 = std::min(x + kTileEdge, request_.width);
            tile.y1 = std::min(y + kTileEdge, request_.height);
            tiles_.push_back(std::move(tile));
        }
}

}  // namespace brickyard

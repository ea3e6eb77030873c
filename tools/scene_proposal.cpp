#include "tools/scene_proposal.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <glm/geometric.hpp>

#include "client/default_scene.h"
#include "core/camera_framing.h"
#include "tools/scene_contents.h"
#include "tools/scene_emission.h"
#include "tools/scene_exposure.h"
#include "tools/scene_window.h"
#include "tools/velocity_fit.h"

namespace brickyard {

namespace {

constexpr std::uint64_t kMostSamples = 1u << 21;
// What a picture of 640 x 480 has.
constexpr double kAspect = 4.0 / 3;
// Optical depth of the median column: a smoke with a body, and one that a fire shows through.
constexpr double kSmokeDepth = 3.5, kFireDepth = 2.5;
constexpr double kBrightest = 4;
// Below that a fit is chance, and the channel is taken for world units a second at 24 frames a second.
constexpr double kLeastExplained = 0.3;

// Positions to a ten-thousandth of how far the camera stands.
void roundCamera(Camera& camera) {
    const auto vectorOf = [](const auto& v) { return glm::dvec3(v[0], v[1], v[2]); };
    const double distance = glm::length(vectorOf(camera.eye()) - vectorOf(camera.target()));
    if (!(distance > 0) || !std::isfinite(distance)) return;
    const int decimals = std::clamp(4 - int(std::floor(std::log10(distance))), 0, 18);
    for (auto* vector : {camera.mutable_eye(), camera.mutable_target()})
        for (double& number : *vector)
            number = std::strtod(fmt::format("{:.{}f}", number, decimals).c_str(), nullptr) + 0.0;
}

// Patients stand along Z, and face -Y.
void standUp(Camera& camera) {
    const auto& target = camera.target();
    const double distance = glm::length(
        glm::dvec3(camera.eye(0) - target[0], camera.eye(1) - target[1], camera.eye(2) - target[2]));
    const glm::dvec3 from = distance * glm::normalize(glm::dvec3(0.45, -1, 0.25));
    for (int a = 0; a < 3; ++a) {
        camera.set_eye(a, target[a] + from[a]);
        camera.set_up(a, a == 2 ? 1 : 0);
    }
}

void setColor(google::protobuf::RepeatedField<float>& to, std::initializer_list<double> color) {
    to.Clear();
    for (const double part : color) to.Add(float(part));
}

class Proposal {
public:
    Proposal(const Dataset& dataset, std::uint32_t frame, std::shared_ptr<const BrickStore> store)
        : dataset_(dataset),
          frame_(frame),
          store_(std::move(store)),
          contents_(sceneContents(store_->footer())) {}

    Result<SceneProposal> make() {
        const auto main = contents_.density ? contents_.density
                          : contents_.scan  ? contents_.scan
                                            : contents_.level_set;
        if (!main)
            return fail(
                ErrorCode::kNotFound,
                fmt::format("{}: frame {} has no channel that could be drawn: no smoke, fire, level set or "
                            "scan; see `brickyard info`",
                            dataset_.folder().string(), frame_));
        Scene& scene = out_.scene;
        *scene.mutable_camera() = frameChannel(overAllFrames(channel(*main)), kAspect);
        if (main == contents_.scan) standUp(*scene.mutable_camera());
        roundCamera(*scene.mutable_camera());
        setColor(*scene.mutable_background(), {0.05, 0.06, 0.08});
        Result<void> made;
        if (contents_.density) made = addSmoke(*contents_.density);
        if (made && !contents_.density && contents_.scan) made = addScan(*contents_.scan);
        if (made && contents_.level_set) addSurface(*contents_.level_set);
        if (!made) return tl::unexpected(made.error());
        addLights();
        return std::move(out_);
    }

private:
    const ChannelFooter& channel(std::uint32_t index) const { return store_->footer().channels(int(index)); }
    static Result<SampledField> sampled(const std::shared_ptr<const BrickStore>& store, std::uint32_t index,
                                        std::uint64_t most = kMostSamples, int finest = 0) {
        return SampledField::read(FieldReader(store, index), most, finest);
    }

    // The channel with a box that holds it in every frame, where they lie on one lattice: what rises is then
    // seen from its first frame to its last, and which way is up does not hang on when one looks.
    ChannelFooter overAllFrames(ChannelFooter channel) const {
        for (const FrameEntry& entry : dataset_.manifest().frames())
            for (const ChannelSummary& other : entry.channels()) {
                if (other.name() != channel.name() || other.active_min_size() != 3 ||
                    !std::equal(other.index_to_world().begin(), other.index_to_world().end(),
                                channel.index_to_world().begin(), channel.index_to_world().end()))
                    continue;
                for (int a = 0; a < 3; ++a) {
                    channel.set_active_min(a, std::min(channel.active_min(a), other.active_min(a)));
                    channel.set_active_max(a, std::max(channel.active_max(a), other.active_max(a)));
                }
            }
        return channel;
    }

    // The index axis that is up in the picture.
    int upAxis(std::uint32_t index) const {
        const auto& up = out_.scene.camera().up();
        const auto& m = channel(index).index_to_world();
        int best = 2;
        double most = -1;
        for (int a = 0; a < 3 && m.size() == 16; ++a) {
            const glm::dvec3 axis(m[4 * a], m[4 * a + 1], m[4 * a + 2]);
            const double along =
                std::abs(glm::dot(axis, glm::dvec3(up[0], up[1], up[2]))) / glm::length(axis);
            if (along > most) most = along, best = a;
        }
        return best;
    }

    Result<void> addSmoke(std::uint32_t index) {
        const Result<SampledField> density = sampled(store_, index);
        if (!density) return tl::unexpected(density.error());
        Medium& medium = *out_.scene.mutable_medium();
        medium.set_density(channel(index).name());
        burns_ = contents_.flame || (contents_.temperature && !contents_.burned_out);
        const double column = medianColumn(*density, upAxis(index));
        const double scale = column > 0 ? rounded((burns_ ? kFireDepth : kSmokeDepth) / column) : 1;
        if (scale > 0 && std::isfinite(scale)) medium.set_density_scale(scale);
        if (burns_)
            setColor(*medium.mutable_albedo(), {0.7, 0.68, 0.66});
        else
            setColor(*medium.mutable_albedo(), {0.92, 0.92, 0.92});
        if (contents_.color) medium.set_color(channel(*contents_.color).name());
        if (burns_)
            if (Result<void> added = addFire(*density, medium); !added) return added;
        return contents_.velocity ? addVelocity(index, medium) : Result<void>();
    }

    Result<void> addFire(const SampledField& density, Medium& medium) {
        FireFields fields{{}, {}, contents_.flame.has_value(), contents_.temperature.has_value()};
        if (fields.has_flame)
            if (Result<void> read = readAlong(density, *contents_.flame, fields.flame); !read) return read;
        if (fields.has_heat)
            if (Result<void> read = readAlong(density, *contents_.temperature, fields.heat); !read)
                return read;
        FireProposal fire = proposeEmission(fields, density.count());
        fire.emission.set_channel(
            channel(*(fields.has_heat ? contents_.temperature : contents_.flame)).name());
        if (fields.has_heat && fields.has_flame) fire.emission.set_weight(channel(*contents_.flame).name());
        const double seen = brightestColumns(
            density, medium.density_scale() == 0 ? 1 : medium.density_scale(),
            [&](std::int64_t i) { return fire.glow[std::size_t(i)]; }, upAxis(*contents_.density));
        const double scale = seen > 0 ? rounded(kBrightest / seen) : 0;
        if (scale > 0 && std::isfinite(scale)) fire.emission.set_scale(scale);
        *medium.mutable_emission() = std::move(fire.emission);
        return {};
    }

    // max(0, value) of a channel where the density's samples are.
    Result<void> readAlong(const SampledField& density, std::uint32_t index,
                           std::vector<double>& values) const {
        const Result<SampledField> field = sampled(store_, index);
        if (!field) return tl::unexpected(field.error());
        for (std::int64_t i = 0; i < density.count(); ++i)
            values.push_back(field->empty() ? 0 : std::max(0.0, field->at(density.world(i))));
        return {};
    }

    Result<void> addVelocity(std::uint32_t density, Medium& medium) {
        const std::string& name = channel(*contents_.velocity).name();
        medium.set_velocity(name);
        medium.set_velocity_scale(rounded(1.0 / 24));
        std::uint32_t from = frame_;
        if (!dataset_.findFrame(from + 1)) {
            if (from == 0 || !dataset_.findFrame(from - 1)) return {};
            from = from - 1;
        }
        const auto first =
            from == frame_ ? Result<std::shared_ptr<const BrickStore>>(store_) : dataset_.openFrame(from);
        if (!first) return tl::unexpected(first.error());
        const auto second =
            from == frame_ ? dataset_.openFrame(from + 1) : Result<std::shared_ptr<const BrickStore>>(store_);
        if (!second) return tl::unexpected(second.error());
        // Coarse: what is smaller has changed its shape from frame to frame.
        const auto coarse = [&](const std::shared_ptr<const BrickStore>& store,
                                const std::string& channel_name) {
            const auto found = findChannel(*store, channel_name);
            if (!found) return Result<SampledField>(SampledField());
            return sampled(store, *found, kMostSamples / 8, 1);
        };
        const auto d = coarse(*first, channel(density).name()), v = coarse(*first, name),
                   next_d = coarse(*second, channel(density).name()), next_v = coarse(*second, name);
        for (const auto* field : {&d, &v, &next_d, &next_v})
            if (!*field) return tl::unexpected(field->error());
        const VelocityFit fit = fitVelocityScale({*d, *v}, {*next_d, *next_v});
        out_.velocity_explained = fit.explained;
        if (fit.explained >= kLeastExplained) medium.set_velocity_scale(rounded(fit.scale));
        return {};
    }

    Result<void> addScan(std::uint32_t index) {
        const Result<SampledField> field = sampled(store_, index);
        if (!field) return tl::unexpected(field.error());
        Medium& medium = *out_.scene.mutable_medium();
        medium.set_density(channel(index).name());
        *medium.mutable_transfer() = proposeTransfer(*field, channel(index).value_min());
        return {};
    }

    void addSurface(std::uint32_t index) {
        Surface& surface = *out_.scene.add_surfaces();
        surface = defaultSurface(channel(index));
        surface.set_ambient_occlusion(rounded(surface.ambient_occlusion()));
    }

    void addLights() {
        Scene& scene = out_.scene;
        if (burns_) {
            setColor(*scene.mutable_background(), {0.008, 0.01, 0.014});
            return addStudioLights(scene.camera(), 2.5, 0.05, scene);
        }
        // A medium shows a twelfth of what falls on it, a surface a third.
        if (contents_.density) return addStudioLights(scene.camera(), 12, 0.3, scene);
        addStudioLights(scene.camera(), 3, 0.25, scene);
    }

    const Dataset& dataset_;
    std::uint32_t frame_;
    std::shared_ptr<const BrickStore> store_;
    SceneContents contents_;
    bool burns_ = false;
    SceneProposal out_;
};

}  // namespace

Result<SceneProposal> proposeScene(const Dataset& dataset, std::uint32_t frame) {
    auto store = dataset.openFrame(frame);
    if (!store) return tl::unexpected(store.error());
    return Proposal(dataset, frame, std::move(*store)).make();
}

}  // namespace brickyard

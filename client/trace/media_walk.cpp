#include "client/trace/media_walk.h"

#include <algorithm>
#include <cmath>

#include "client/cpu/cell_walk.h"

namespace brickyard {

WorldReader::WorldReader(const TracedWorld& traced, std::span<const RayContext> contexts) : world(traced) {
    media.reserve(traced.media.size());
    for (const TracedMedium& medium : traced.media) media.emplace_back(medium, contexts);
    baked.resize(traced.baked.size());
    for (std::size_t i = 0; i < baked.size(); ++i)
        if (const TracedChannel& channel = traced.baked[i])
            baked[i].emplace(*channel.channel, FieldFilter::kTrilinear, ReadAccuracy{},
                             contexts[channel.frame]);
}

bool WorldReader::takeMissed() {
    bool missed = false;
    for (MediumReader& medium : media) missed |= medium.takeMissed();
    for (std::optional<ChannelReader>& channel : baked)
        if (channel) missed |= channel->takeMissed();
    return missed;
}

RaySpan boxSpan(const TracedMedium& medium, const IndexRay& ray, RaySpan span) {
    return ray.clip(medium.box_low, medium.box_high, span);
}

MediaWalk::MediaWalk(WorldReader& reader, const WorldRay& ray, RaySpan span, double time, double fixed_lod,
                     Steps steps)
    : reader_(reader),
      ray_(ray),
      span_(reader.world.clipped(ray, span)),
      time_(time),
      fixed_lod_(fixed_lod),
      steps_(steps),
      media_(reader.media.size()) {
    for (std::size_t m = 0; m < media_.size(); ++m) {
        const TracedMedium& medium = reader.media[m].medium();
        media_[m].ray = IndexRay(ray, medium.transform());
        media_[m].span = boxSpan(medium, media_[m].ray, span_);
    }
}

bool MediaWalk::next(RaySpan& stretch) {
    while (span_.begin < span_.end) {
        const double t = span_.begin;
        double end = span_.end;
        bool any = false;
        for (std::size_t m = 0; m < media_.size(); ++m) {
            Medium& medium = media_[m];
            medium.active = false;
            if (medium.span.empty() || t >= medium.span.end) continue;
            if (t < medium.span.begin) {
                end = std::min(end, medium.span.begin);
                continue;
            }
            const TracedMedium& traced = reader_.media[m].medium();
            if (!(t < medium.place.exit)) medium.place = traced.majorants.at(medium.ray, t);
            end = std::min({end, medium.place.exit, medium.span.end});
            medium.active = !medium.place.cell.empty();
            any |= medium.active;
        }
        if (any) {
            for (std::size_t m = 0; m < media_.size(); ++m) {
                Medium& medium = media_[m];
                if (!medium.active || steps_ == Steps::kMajorants) continue;
                const TracedMedium& traced = reader_.media[m].medium();
                const glm::dvec3 at = ray_.origin + t * ray_.direction;
                medium.lod = fixed_lod_ >= 0 ? fixed_lod_ : reader_.world.lodAt(traced, at);
                // A hair further: the cell that begins here, not the one that ends.
                const double hair = 1e-6 * medium.ray.unitLength();
                const double edge = reader_.media[m].smoothEdge(at + hair * ray_.direction, medium.lod, time_,
                                                                medium.place.cell);
                const bool nearest = traced.settings->filter == FieldFilter::kNearest;
                // The nearest sample changes in the middle between two, on both levels of a blend.
                const bool blends = nearest && medium.lod != std::floor(medium.lod);
                end = std::min(end, nextLatticePlane(medium.ray, t, blends ? 0.5 * edge : edge,
                                                     nearest && !blends ? 0.5 : 0));
            }
            stretch = {t, end};
        }
        // Where distances have no digits left for a step, the ray ends.
        if (!(end > t)) end = span_.end;
        span_.begin = end;
        if (any) return true;
    }
    return false;
}

void stretchValues(MediumReader& reader, const MediaWalk& walk, std::size_t m, RaySpan stretch, double time,
                   std::span<double> values) {
    // Not on the borders themselves, where the next cell may be background; but what is thinner than what is
    // left out must not be lost.
    constexpr double kInside = 0.001;
    const double length = stretch.end - stretch.begin, step = 1 / double(values.size() - 1);
    for (std::size_t i = 0; i < values.size(); ++i) {
        const double place = std::clamp(step * double(i), kInside, 1 - kInside);
        values[i] = reader.density(walk.at(stretch.begin + length * place), walk.lod(m), time);
    }
    const double more = kInside / (step - kInside), second = values[1],
                 last_but_one = values[values.size() - 2];
    values.front() += more * (values.front() - second);
    values.back() += more * (values.back() - last_but_one);
}

double stretchDepth(MediumReader& reader, const MediaWalk& walk, std::size_t m, RaySpan stretch,
                    double time) {
    const double length = stretch.end - stretch.begin;
    const MediumSettings& settings = *reader.medium().settings;
    if (settings.transfer) {
        double values[3];
        stretchValues(reader, walk, m, stretch, time, values);
        return settings.density_scale * length * 0.5 *
               (settings.transfer->mean(values[0], values[1]).opacity +
                settings.transfer->mean(values[1], values[2]).opacity);
    }
    if (reader.medium().both_signs) {
        // What is below 0 counts as 0: the cubic is split at its roots.
        constexpr double kPlaces[] = {1e-9, 1.0 / 3, 2.0 / 3, 1 - 1e-9};
        double values[4];
        for (std::size_t i = 0; i < 4; ++i)
            values[i] = reader.density(walk.at(stretch.begin + kPlaces[i] * length), walk.lod(m), time);
        return settings.density_scale * length *
               integratePositiveCubic(values[0], values[1], values[2], values[3]);
    }
    const double a = reader.extinction(walk.at(stretch.begin + kGaussPoint * length), walk.lod(m), time);
    const double b = reader.extinction(walk.at(stretch.end - kGaussPoint * length), walk.lod(m), time);
    return 0.5 * (a + b) * length;
}

double opticalDepth(WorldReader& reader, const WorldRay& ray, RaySpan span, double lod, double time,
                    double enough, double* variance) {
    MediaWalk walk(reader, ray, span, time, lod);
    double depth = 0;
    for (RaySpan stretch; depth < enough && walk.next(stretch);)
        for (std::size_t m = 0; m < walk.mediumCount(); ++m) {
            if (!walk.active(m) || walk.majorant(m).extinction == 0) continue;
            depth += stretchDepth(reader.media[m], walk, m, stretch, time);
            if (variance)
                *variance += (stretch.end - stretch.begin) *
                             reader.media[m].depthVariance(walk.at(0.5 * (stretch.begin + stretch.end)),
                                                           walk.lod(m), walk.indexRay(m).unitLength());
        }
    return depth;
}

}  // namespace brickyard

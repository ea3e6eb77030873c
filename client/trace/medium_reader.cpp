#include "client/trace/medium_reader.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace brickyard {

MediumReader::MediumReader(const TracedMedium& medium, std::span<const RayContext> contexts)
    : medium_(&medium) {
    open(now_, medium.now, medium, contexts);
    if (medium.next.density) open(next_, medium.next, medium, contexts);
}

void MediumReader::open(Frame& frame, const MediumChannels& channels, const TracedMedium& medium,
                        std::span<const RayContext> contexts) {
    const FieldFilter filter = medium.settings->filter;
    auto reader = [&](const TracedChannel& channel, FieldFilter with, const ReadAccuracy& accuracy,
                      std::optional<ChannelReader>& out) {
        if (channel) out.emplace(*channel.channel, with, accuracy, contexts[channel.frame]);
    };
    reader(channels.density, filter, medium.density_accuracy, frame.density);
    reader(channels.emission, filter, medium.other_accuracy, frame.emission);
    reader(channels.weight, filter, medium.other_accuracy, frame.weight);
    reader(channels.color, filter, medium.other_accuracy, frame.color);
    reader(channels.velocity, FieldFilter::kTrilinear, medium.other_accuracy, frame.velocity);
}

glm::dvec3 MediumReader::origin(Frame& frame, const glm::dvec3& point, double time, double frame_time) {
    const double elapsed = time - frame_time;
    if (!frame.velocity || elapsed == 0) return point;
    // Back along the flow, by the midpoint rule.
    const Affine& transform = frame.velocity->channel().transform();
    const double scale = medium_->settings->velocity_scale * elapsed;
    auto velocity = [&](const glm::dvec3& at) {
        return frame.velocity->vector(transform.inversePoint(at), 0) * scale;
    };
    const glm::dvec3 step = velocity(point);
    // Within a voxel the flow hardly changes.
    if (glm::length(step) < 0.5 * transform.voxelSize()) return point - step;
    return point - velocity(point - 0.5 * step);
}

double MediumReader::densityIn(Frame& frame, const glm::dvec3& point, double lod, double time,
                               double frame_time, bool* inside) {
    const glm::dvec3 at = origin(frame, point, time, frame_time);
    const PagedChannel& channel = frame.density->channel();
    const glm::dvec3 index = channel.transform().inversePoint(at);
    for (int a = 0; a < 3; ++a)
        if (index[a] < channel.clipLow()[a] || index[a] > channel.clipHigh()[a]) return 0;
    if (inside) *inside = true;
    return frame.density->value(index, lod);
}

double MediumReader::density(const glm::dvec3& point, double lod, double time, bool* inside) {
    if (!isBetween()) return densityIn(now_, point, lod, time, 0, inside);
    const double share = std::clamp(medium_->between + time, 0.0, 1.0);
    // Blended frames stand still; advected ones move towards each other.
    const double now = timeNow(time), next = medium_->advects ? now : 1;
    const double a = share < 1 ? densityIn(now_, point, lod, now, 0, inside) : 0;
    const double b = share > 0 ? densityIn(next_, point, lod, next, 1, inside) : 0;
    return a + share * (b - a);
}

glm::dvec3 MediumReader::emissionIn(Frame& frame, const glm::dvec3& point, double lod, double time,
                                    double frame_time) {
    const MediumEmission& emission = *medium_->settings->emission;
    const glm::dvec3 at = origin(frame, point, time, frame_time);
    const PagedChannel& channel = frame.emission->channel();
    if (channel.empty()) return glm::dvec3(0);
    const glm::dvec3 index = channel.transform().inversePoint(at);
    for (int a = 0; a < 3; ++a)
        if (index[a] < channel.clipLow()[a] || index[a] > channel.clipHigh()[a]) return glm::dvec3(0);
    double weight = emission.scale;
    if (frame.weight) {
        const PagedChannel& weights = frame.weight->channel();
        if (weights.empty()) return glm::dvec3(0);
        weight *= std::max(0.0, frame.weight->value(weights.transform().inversePoint(at), lod));
        if (weight == 0) return glm::dvec3(0);
    }
    const double value = frame.emission->value(index, lod);
    if (emission.black_body)
        return weight * emission.black_body->radiance(emission.kelvin_offset + emission.kelvin_scale * value);
    if (emission.ramp) return weight * emission.ramp->at(value);
    return weight * std::max(0.0, value) * emission.color;
}

glm::dvec3 MediumReader::emission(const glm::dvec3& point, double lod, double time) {
    if (!medium_->glows()) return glm::dvec3(0);
    if (!isBetween()) return emissionIn(now_, point, lod, time, 0);
    const double share = std::clamp(medium_->between + time, 0.0, 1.0);
    const double now = timeNow(time), next = medium_->advects ? now : 1;
    const glm::dvec3 a = share < 1 ? emissionIn(now_, point, lod, now, 0) : glm::dvec3(0);
    const glm::dvec3 b = share > 0 ? emissionIn(next_, point, lod, next, 1) : glm::dvec3(0);
    return a + share * (b - a);
}

glm::dvec3 MediumReader::albedo(const glm::dvec3& point, double lod, double time) {
    const MediumSettings& settings = *medium_->settings;
    if (!now_.color) return settings.albedo;
    const glm::dvec3 at = origin(now_, point, timeNow(time), 0);
    const PagedChannel& channel = now_.color->channel();
    const glm::dvec3 index = channel.transform().inversePoint(at);
    const glm::dvec3 color = settings.color_ramp ? settings.color_ramp->at(now_.color->value(index, lod))
                                                 : now_.color->vector(index, lod);
    return glm::clamp(settings.albedo * color, 0.0, 1.0);
}

glm::dvec3 MediumReader::gradient(const glm::dvec3& point, double lod, double time) {
    const Affine& transform = medium_->transform();
    const glm::dvec3 index = transform.inversePoint(origin(now_, point, timeNow(time), 0));
    const glm::dvec3 slope = now_.density->gradient(index, lod);
    // d/dworld = (d index / d world)^T d/dindex, a column at a time.
    glm::dvec3 out;
    for (int a = 0; a < 3; ++a) {
        glm::dvec3 axis(0);
        axis[a] = 1;
        out[a] = glm::dot(transform.inverseVector(axis), slope);
    }
    return out;
}

double MediumReader::cellEdge(const glm::dvec3& point, double lod) {
    return now_.density->cellEdgeAt(medium_->transform().inversePoint(point), lod);
}

double MediumReader::smoothEdge(const glm::dvec3& point, double lod, double time,
                                const MajorantCell& within) {
    const Affine& transform = medium_->transform();
    double edge = std::numeric_limits<double>::infinity();
    auto add = [&](std::optional<ChannelReader>& reader, const glm::dvec3& at) {
        if (!reader) return;
        const Affine& own = reader->channel().transform();
        const double scale = own == transform ? 1 : own.voxelSize() / transform.voxelSize();
        edge = std::min(edge, scale * reader->cellEdgeAt(own.inversePoint(at), lod));
    };
    for (const bool next : {false, true}) {
        if (next && !isBetween()) break;
        Frame& frame = next ? next_ : now_;
        const glm::dvec3 at = origin(frame, point, next && !medium_->advects ? 1 : timeNow(time), next);
        if (within.extinction > 0) add(frame.density, at);
        if (within.emission > 0) {
            add(frame.emission, at);
            add(frame.weight, at);
        }
    }
    return edge;
}

double MediumReader::depthVariance(const glm::dvec3& point, double lod, double unit_length) {
    const MediumSettings& settings = *medium_->settings;
    const glm::dvec3 index = medium_->transform().inversePoint(point);
    double square = now_.density->squareAt(index, lod);
    if (square == 0) return 0;
    if (settings.transfer) {
        // What the deviation makes of the opacity there.
        const double edge = now_.density->cellEdgeAt(index, lod);
        const double deviation = std::sqrt(square / edge), value = now_.density->value(index, lod);
        const double slope = settings.transfer->mean(value, value + deviation).opacity -
                             settings.transfer->mean(value - deviation, value).opacity;
        square = slope * slope * edge;
    }
    // Per index unit of length, in index units squared: twice to world units, of which the caller's length is
    // one.
    return square * settings.density_scale * settings.density_scale * unit_length;
}

bool MediumReader::takeMissed() {
    bool missed = false;
    for (Frame* frame : {&now_, &next_})
        for (std::optional<ChannelReader>* reader :
             {&frame->density, &frame->emission, &frame->weight, &frame->color, &frame->velocity})
            if (*reader) missed |= (*reader)->takeMissed();
    return missed;
}

}  // namespace brickyard

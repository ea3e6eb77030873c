// A medium at any point and moment: extinction, albedo, emission. One reader belongs to one thread and one
// pass.
#pragma once

#include <optional>

#include "client/trace/channel_reader.h"
#include "client/trace/traced_world.h"

namespace brickyard {

class MediumReader {
public:
    // All of it outlives the reader. `contexts`: one a frame.
    MediumReader(const TracedMedium& medium, std::span<const RayContext> contexts);

    const TracedMedium& medium() const { return *medium_; }
    // The density there; 0 outside the medium's box. World positions; `time` in frames from the picture's.
    // `inside`: whether there is a medium, of either frame.
    double density(const glm::dvec3& point, double lod, double time, bool* inside = nullptr);
    double extinction(const glm::dvec3& point, double lod, double time) {
        // Outside there is nothing, whatever a transfer function makes of 0.
        bool inside = false;
        const double value = density(point, lod, time, &inside);
        return inside ? extinctionOf(*medium_->settings, value) : 0;
    }
    // Emitted radiance per world unit, but that of a transfer function.
    glm::dvec3 emission(const glm::dvec3& point, double lod, double time);
    glm::dvec3 albedo(const glm::dvec3& point, double lod, double time);
    // Of the density, per world unit.
    glm::dvec3 gradient(const glm::dvec3& point, double lod, double time);
    // As ChannelReader: of the density, in index units; and its variance as optical depth, per world unit of
    // a ray in the direction of which an index unit has `unit_length`.
    double cellEdge(const glm::dvec3& point, double lod);
    // The same of all that is read there, where it is then: of the density where `within` has extinction, of
    // what glows where it has emission.
    double smoothEdge(const glm::dvec3& point, double lod, double time, const MajorantCell& within);
    double depthVariance(const glm::dvec3& point, double lod, double unit_length);

    bool takeMissed();

private:
    struct Frame {
        std::optional<ChannelReader> density, emission, weight, color, velocity;
    };
    static void open(Frame& frame, const MediumChannels& channels, const TracedMedium& medium,
                     std::span<const RayContext> contexts);
    // Where what is at `point` at `time` was when the frame (at `frame_time`) was taken.
    glm::dvec3 origin(Frame& frame, const glm::dvec3& point, double time, double frame_time);
    double densityIn(Frame& frame, const glm::dvec3& point, double lod, double time, double frame_time,
                     bool* inside);
    glm::dvec3 emissionIn(Frame& frame, const glm::dvec3& point, double lod, double time, double frame_time);
    // Moment of the picture's own frame to look at.
    double timeNow(double time) const {
        if (!isBetween()) return time;
        return medium_->advects ? medium_->between + time : 0;
    }
    bool isBetween() const { return bool(medium_->next.density); }

    const TracedMedium* medium_;
    Frame now_, next_;
};

}  // namespace brickyard

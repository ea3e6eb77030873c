// The media along a ray, in stretches on which each of them is smooth: no stretch crosses a cell of a field,
// and what is empty is passed over. One thread.
#pragma once

#include <limits>
#include <span>
#include <vector>

#include "client/trace/medium_reader.h"
#include "client/trace/traced_world.h"

namespace brickyard {

// The readers of one thread for one pass.
struct WorldReader {
    WorldReader(const TracedWorld& traced, std::span<const RayContext> contexts);
    bool takeMissed();

    const TracedWorld& world;
    std::vector<MediumReader> media;
    std::vector<std::optional<ChannelReader>> baked;  // by light
};

class MediaWalk {
public:
    // Stretches end at cells of the fields, or only at those of the majorant grids.
    enum class Steps : std::uint8_t { kCells, kMajorants };
    // `fixed_lod`: of the whole ray, or negative: as the camera sees each point. `time`: what moves has its
    // cells where it then is.
    MediaWalk(WorldReader& reader, const WorldRay& ray, RaySpan span, double time, double fixed_lod = -1,
              Steps steps = Steps::kCells);

    // The next stretch in which a medium is not known to be empty. False at the end.
    bool next(RaySpan& stretch);
    // Of the stretch that next() gave last.
    std::size_t mediumCount() const { return media_.size(); }
    bool active(std::size_t medium) const { return media_[medium].active; }
    double lod(std::size_t medium) const { return media_[medium].lod; }
    const MajorantCell& majorant(std::size_t medium) const { return media_[medium].place.cell; }
    const IndexRay& indexRay(std::size_t medium) const { return media_[medium].ray; }
    glm::dvec3 at(double t) const { return ray_.origin + t * ray_.direction; }

private:
    struct Medium {
        IndexRay ray;
        RaySpan span;
        MajorantGrid::Place place{{}, -std::numeric_limits<double>::infinity()};
        double lod = 0;
        bool active = false;
    };
    WorldReader& reader_;
    WorldRay ray_;
    RaySpan span_;
    double time_, fixed_lod_;
    Steps steps_;
    std::vector<Medium> media_;
};

// Where a ray meets a medium's box, within `span`.
RaySpan boxSpan(const TracedMedium& medium, const IndexRay& ray, RaySpan span);

// Gauss points of a stretch: a cubic is integrated exactly.
inline constexpr double kGaussPoint = 0.21132486540518711775;  // (1 - 1/sqrt(3)) / 2

// Optical depth of all media along a stretch of a ray; its variance is added to `variance`. Stops behind
// `enough`.
double opticalDepth(WorldReader& reader, const WorldRay& ray, RaySpan span, double lod, double time,
                    double enough, double* variance);
// The density at equal distances from where a stretch begins to where it ends, as seen from within.
// REQUIRES: at least 2 values.
void stretchValues(MediumReader& medium, const MediaWalk& walk, std::size_t index, RaySpan stretch,
                   double time, std::span<double> values);
// Of one stretch that a walk gave, of one medium.
double stretchDepth(MediumReader& medium, const MediaWalk& walk, std::size_t index, RaySpan stretch,
                    double time);

}  // namespace brickyard

// Where a ray meets an iso-value of one channel's trilinear field, what the surface's normal is there, and
// what can be seen from there. Immutable: any thread, each with a RayContext of its own.
//
// The whole picture uses one level (and the leaves above it), so borders of levels make no cracks but where
// the stored field itself jumps; a jump across the value is a crossing like any other. A ray keeps the side
// it is on, from node ranges where they tell it and from cells where they do not, and a crossing is a change
// of side: none can be lost or doubled at a border of cells, bricks or levels, and a ray that begins and ends
// outside crosses an even number of times. Beyond the medium's box the field is the background.
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <vector>

#include "client/cpu/channel_ray.h"
#include "client/trace/node_fields.h"
#include "client/world_settings.h"

namespace brickyard {

struct SurfaceHit {
    double t = 0;           // world distance along the ray, as in RaySpan
    glm::dvec3 index{0};    // where, in index space
    bool entering = true;   // the ray goes inside here; else it comes out
    bool failed = false;    // known only from what stands in for a page that cannot be had
    bool has_node = false;  // false: between two values that fill their nodes
    NodeRef node;           // the brick that the crossing is in, or that begins or ends there
    NodeKey key;            // of `node`
    glm::ivec3 cell{0};     // of the brick
    glm::dvec3 inside{0};   // position in the cell, [0, 1]
};

class SurfaceTracer {
public:
    // Inside is where the field is above `iso`; with `inside_below`, where it is below. `channel` outlives
    // this. REQUIRES: 0 <= level.
    SurfaceTracer(const PagedChannel& channel, double iso, bool inside_below, int level);
    SurfaceTracer(const PagedChannel& channel, const SurfaceSettings& settings, int level)
        : SurfaceTracer(channel, settings.iso, settings.inside_below, level) {}

    enum class Found : std::uint8_t {
        kNothing,
        kHit,
        kMissing,  // pages must come first; they are wanted
    };

    // Where a call takes `failed`, it becomes true if a page that cannot be had has a part in the answer;
    // else it stays as it is.
    //
    // The first crossing in `span`; where the span begins, the ray is on the side it is on. `failed` of `hit`
    // is set whatever is found. `worth` is that of a page this ray waits for; of those behind it, less and
    // less. What is behind a missing page is wanted as long as it can matter and there is room.
    Found first(const IndexRay& ray, RaySpan span, const RayContext& context, SurfaceHit& hit,
                double worth = 1) const;
    // The same for the first `most` crossings. kMissing: `hits` are those in front of the first missing page.
    Found crossings(const IndexRay& ray, RaySpan span, const RayContext& context, std::size_t most,
                    std::vector<SurfaceHit>& hits, double worth = 1, bool* failed = nullptr) const;
    // For a picture that must be shown now: resident ancestors stand in, nothing is wanted; never kMissing.
    Found firstResident(const IndexRay& ray, RaySpan span, const RayContext& context, SurfaceHit& hit) const;

    // Unit, world space, pointing outside: the gradient of lattice samples by central differences, between
    // them by `filter` (trilinear, nearest: central differences interpolated; the others: the derivative of
    // the kernel). Where it vanishes, that of the trilinear cell, and where that does too, against
    // `direction`, the ray's, world. kHit; or kMissing, where bricks beside the hit's must come first: they
    // are wanted, and `normal` is that of the trilinear cell alone.
    Found normal(const SurfaceHit& hit, const glm::dvec3& direction, FieldFilter filter,
                 const RayContext& context, glm::dvec3& normal, double worth = 1,
                 bool* failed = nullptr) const;

    // Whether anything of the surface is in `span`: the ray begins inside, or crosses. kHit: it is occluded.
    Found occluded(const IndexRay& ray, RaySpan span, const RayContext& context, double worth = 1,
                   bool* failed = nullptr) const;
    // From a hit towards unit `direction`, world, at most `reach` far. The surface is seen from the side that
    // the ray came from, so a hit from inside (a clipped solid) is not dark for that alone.
    Found occludedFrom(const SurfaceHit& hit, const glm::dvec3& direction, double reach,
                       const RayContext& context, double worth = 1, bool* failed = nullptr) const;

    // The share of directions about unit `normal` (which points to the side that the ray came from), weighted
    // with the cosine, in which nothing is within `reach`, from `rays` directions: Hammersley's points, moved
    // by `seed`. kHit: `share` and `deviation` (of its expected error) are set; kMissing: all rays were sent,
    // so that their pages come at once, and `share` is that of those that are known.
    struct Openness {
        double share = 1;
        double deviation = 0;
    };
    Found openness(const SurfaceHit& hit, const glm::dvec3& normal, double reach, std::uint32_t rays,
                   std::uint64_t seed, const RayContext& context, Openness& out, double worth = 1,
                   bool* failed = nullptr) const;

    // A ray from the hit, its parameter world distance from there: nothing is lost on the way through world
    // space.
    IndexRay rayFrom(const SurfaceHit& hit, const glm::dvec3& direction) const;
    // World length along a ray below which a crossing is taken for the one that it begins at: a 32nd of a
    // voxel of the level, which is more than what the faces of quantised bricks differ by.
    double hair(const IndexRay& ray) const { return 0.03125 * cellEdge(level_) * ray.unitLength(); }

    const PagedChannel& channel() const { return channel_; }
    int level() const { return level_; }
    bool isInside(double value) const { return inside_below_ ? value < iso_ : value > iso_; }

private:
    class Trace;
    Found occludedOn(bool inside, const IndexRay& ray, RaySpan span, const RayContext& context, double worth,
                     bool* failed) const;
    // Unit, outwards, from a gradient in index space; false where it has no direction.
    bool outwards(const glm::dvec3& gradient, glm::dvec3& normal) const;

    const PagedChannel& channel_;
    double iso_;
    bool inside_below_;
    int level_;
};

}  // namespace brickyard

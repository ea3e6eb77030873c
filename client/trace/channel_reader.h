// A channel of a frame at any point of index space, on any level of detail, through any kernel: finds the
// bricks that are resident, and wants those that are not.
//
// Level l of detail is the field of that level; between two levels the fields are blended, so that what is
// seen changes smoothly with the distance. Where a node stands for what is below it (a leaf, or a deviation
// that does not matter), its own field is taken: stored data alone decides, never what happens to be
// resident. A kernel reaches over brick borders into the neighbours.
//
// One reader belongs to one thread and one pass (pages move between passes).
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>

#include "client/cpu/channel_ray.h"
#include "client/paged_channel.h"
#include "client/world_settings.h"

namespace brickyard {

struct ReadAccuracy {
    // A node is not descended from where its mean square deviation from level 0, times its cell edge in index
    // units, is at most this: the variance of an integral of the field per index unit of a ray.
    double square_budget = 0;
    // Coarse bricks are wanted before fine ones: for a picture that limits may end at any time. Else only
    // those that the finished picture is made of.
    bool coarse_first = false;
};

class ChannelReader {
public:
    // All of it outlives the reader.
    ChannelReader(const PagedChannel& channel, FieldFilter filter, ReadAccuracy accuracy,
                  const RayContext& context);

    const PagedChannel& channel() const { return *channel_; }
    const RayContext& context() const { return *context_; }

    // At a position in index space. `lod` >= 0.
    double value(const glm::dvec3& position, double lod);
    // Of a channel with three components; a staggered one is put back in its place.
    glm::dvec3 vector(const glm::dvec3& position, double lod);
    // Per index unit: central differences over one cell of the level.
    glm::dvec3 gradient(const glm::dvec3& position, double lod);
    // Edge, in index units, of the cells in which value() is smooth about the position: of the finer of the
    // two levels that are blended there, or of the node that stands for it.
    double cellEdgeAt(const glm::dvec3& position, double lod);
    // Variance per index unit of a ray that value() may be off by there.
    double squareAt(const glm::dvec3& position, double lod);
    // Greatest less least of the eight samples about the position: interpolation between them is off by a
    // part of it.
    double spreadAt(const glm::dvec3& position, double lod);

    // Something that was read since the last call was not resident: results were stand-ins.
    bool takeMissed() {
        const bool missed = missed_;
        missed_ = false;
        return missed;
    }

private:
    // A node's region and what stands for it.
    struct Entry {
        NodeKey key{-1, 0, 0, 0};        // as asked for; level -1: empty
        glm::dvec3 low{0};               // of the node that is drawn
        double per_cell = 1;             // cells per index unit
        const float* samples = nullptr;  // nullptr: constant
        float constant[3] = {};
        double region = 0;                // edge of what has one value, index units; 0: not one value
        double edge = 1;                  // of its cells, index units
        double square = 0;                // variance per index unit, where there is no grid
        const ErrorGrid* grid = nullptr;  // of sub-boxes, relative to `bound`
        double bound = 0;
        double speck = 1;  // as speckFactor()
        // Floats would lose digits between values so small, or of both signs.
        bool careful = false;
        bool missing = false;
    };
    const Entry& entryAt(int level, const glm::dvec3& position);
    double squareIn(const Entry& entry, const glm::dvec3& position) const;
    void find(const NodeKey& key, const glm::dvec3& position, Entry& out);
    void takeNode(const NodeRef& ref, const NodeKey& key, Entry& out) const;
    double onLevel(int level, const glm::dvec3& position, int component);
    double trilinear(const Entry& entry, const glm::dvec3& position, int component) const;
    double filtered(int level, const glm::dvec3& position, int component);
    double blended(const glm::dvec3& position, double lod, int component);
    int clampLevel(double lod) const;
    void want(const WantedPage& page, std::uint32_t bytes);

    const PagedChannel* channel_;
    const RayContext* context_;
    FieldFilter filter_;
    ReadAccuracy accuracy_;
    int edge_cells_;
    int top_level_ = 0;
    bool missed_ = false;
    // By octant of the brick coordinates and parity of the level: neighbours do not drive each other out.
    Entry entries_[16];
};

}  // namespace brickyard

// The field by place instead of along a ray: which node holds a cell of some level, and what is known of the
// field in it. Where a page cannot be had, a coarser ancestor's brick stands in. Reads only: any thread, with
// a context of its own.
#pragma once

#include <array>
#include <cstdint>

#include "client/cpu/channel_ray.h"

namespace brickyard {

struct PlacedNode {
    NodeRef ref;
    NodeKey key;
    const TreeBlock* block = nullptr;  // of `ref`
    const NodeRecord& record() const { return block->record(ref.node); }
};

// What to do about pages that are not there.
enum class MissingPages : std::uint8_t {
    kWant,     // the page is wanted, and the answer is that it is missing: the same answer whatever is cached
    kStandIn,  // the nearest ancestor that is resident stands in, and nothing is wanted
};

// One channel's field, for as long as a pass lasts.
class NodeFields {
public:
    // `worth` is that of every page it wants.
    NodeFields(const PagedChannel& channel, const RayContext& context, double worth, MissingPages missing)
        : channel_(channel), context_(context), worth_(worth), missing_(missing) {}
    const PagedChannel& channel() const { return channel_; }

    enum class Place : std::uint8_t { kNode, kBackground, kMissing };
    // The node `key`, or the last above it: a leaf, or one whose children's block cannot be had (`failed`).
    // kBackground: nothing is stored there. kMissing: a tree block is (it is wanted; `failed`: in vain).
    Place place(const NodeKey& key, PlacedNode& out, bool& failed) const;

    enum class State : std::uint8_t {
        kValue,    // `value` everywhere
        kBrick,    // trilinear in `samples`, the brick of `node`
        kMissing,  // not there yet
        kUnknown,  // nothing can be had; or, standing in, nothing is there
    };
    struct NodeField {
        State state = State::kUnknown;
        bool failed = false;  // not what it should be: a page cannot be had
        double value = 0;
        PlacedNode node;                 // of the value or the brick: the one asked for, or an ancestor
        const float* samples = nullptr;  // valid as long as PageCache::find() says
    };
    NodeField read(const PlacedNode& node) const;
    // As the children of `node` cannot be had, or have not come, while nothing may be wanted.
    bool childrenBarred(const PlacedNode& node) const;
    void wantBlock(std::uint32_t block) const;
    // Another worth for what is wanted from here on.
    void setWorth(double worth) { worth_ = worth; }

    // The field of `level`, or of the leaf above it, at a position of the lattice of `level`, in cells of
    // that level. kValue, kMissing or kUnknown. Costs a descent, unless the last call was in the same node.
    NodeField sample(int level, const std::array<std::int64_t, 3>& position);

private:
    const PagedChannel& channel_;
    const RayContext& context_;
    double worth_;
    MissingPages missing_;
    NodeKey last_key_{-1, 0, 0, 0};
    NodeField last_;
};

// The node's field, a position in its own cells, each coordinate in [0, N].
double valueInBrick(const float* samples, BrickShape shape, const glm::dvec3& position);

}  // namespace brickyard

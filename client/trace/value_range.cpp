#include "client/trace/value_range.h"

#include "client/cpu/node_error.h"
#include "client/cpu/octree_walk.h"

namespace brickyard {

namespace {

struct Query {
    const PagedChannel& channel;
    glm::dvec3 low, high;
    int level;
    double square_budget;
    const RayContext& context;
    ValueRange& out;
    bool complete = true;

    bool meets(const NodeKey& key) const {
        const glm::dvec3 a = nodeLow(key, channel.shape());
        const double edge = nodeEdge(key, channel.shape());
        for (int axis = 0; axis < 3; ++axis)
            if (a[axis] > high[axis] || a[axis] + edge < low[axis]) return false;
        return true;
    }
    void visit(const NodeRef& ref, const NodeKey& key) {
        const TreeBlock* block = channel.block(ref.block);
        if (!block) {
            const WantedPage page{true, {channel.index(), ref.block, 0, false}};
            if (context.failed && context.failed->contains(page)) {
                out.add(channel.valueMin());
                out.add(channel.valueMax());
                return;
            }
            complete = false;
            if (context.wants)
                context.wants->add(page, std::uint32_t(channel.blockBytes(ref.block)), 1, context.tile);
            return;
        }
        if (ref.node >= block->nodeCount()) return;
        const NodeRecord& record = block->record(ref.node);
        if (double(record.value_min) >= out.low && double(record.value_max) <= out.high) return;
        if (key.level <= level || key.level == 0 || block->isLeaf(ref.node) ||
            squareOfNode(channel, key, record) * cellEdge(key.level) <= square_budget) {
            out.add(double(record.value_min));
            out.add(double(record.value_max));
            return;
        }
        const unsigned valid = block->validMask(ref.node);
        const ChildrenRef first = block->children(ref.node);
        std::uint32_t child = first.first;
        for (int octant = 0; octant < 8; ++octant) {
            if (!(valid >> octant & 1)) continue;
            if (meets(key.child(octant))) visit({first.block, child}, key.child(octant));
            ++child;
        }
    }
};

}  // namespace

bool rangeOver(const PagedChannel& channel, const glm::dvec3& low, const glm::dvec3& high, int level,
               double square_budget, const RayContext& context, ValueRange& out) {
    // What is nowhere stored is the background.
    out.add(double(channel.background()));
    Query query{channel, low, high, level, square_budget, context, out};
    for (std::size_t i = 0; i < channel.roots().size(); ++i)
        if (query.meets(channel.roots()[i])) query.visit({0, std::uint32_t(i)}, channel.roots()[i]);
    return query.complete;
}

}  // namespace brickyard

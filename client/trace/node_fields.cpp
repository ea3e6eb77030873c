#include "client/trace/node_fields.h"

#include <bit>

#include "client/cpu/cell_walk.h"

namespace brickyard {

namespace {

// That of `key` which has this level. REQUIRES: key.level <= level <= kMaxLevel.
NodeKey ancestorAt(const NodeKey& key, int level) {
    const int up = level - key.level;
    return {level, key.x >> up, key.y >> up, key.z >> up};
}

}  // namespace

void NodeFields::wantBlock(std::uint32_t block) const {
    if (missing_ == MissingPages::kWant)
        context_.wants->add({true, {channel_.index(), block, 0}}, std::uint32_t(channel_.blockBytes(block)),
                            worth_, context_.tile);
}

bool NodeFields::childrenBarred(const PlacedNode& node) const {
    const std::uint32_t block = node.block->children(node.ref.node).block;
    if (context_.failed->contains({true, {channel_.index(), block, 0}})) return true;
    return missing_ == MissingPages::kStandIn && !channel_.block(block);
}

NodeFields::Place NodeFields::place(const NodeKey& key, PlacedNode& out, bool& failed) const {
    auto missingBlock = [&](std::uint32_t block) {
        failed = context_.failed->contains({true, {channel_.index(), block, 0}});
        if (!failed) wantBlock(block);
        return Place::kMissing;
    };
    failed = false;
    const std::vector<NodeKey>& roots = channel_.roots();
    std::size_t root = 0;
    while (root < roots.size() &&
           !(key.level <= roots[root].level && ancestorAt(key, roots[root].level) == roots[root]))
        ++root;
    if (root == roots.size()) return Place::kBackground;
    out = {{0, std::uint32_t(root)}, roots[root], channel_.block(0)};
    if (!out.block) return missingBlock(0);
    while (out.key.level > key.level && !out.block->isLeaf(out.ref.node)) {
        if (childrenBarred(out)) {
            failed = true;
            break;
        }
        const NodeKey below = ancestorAt(key, out.key.level - 1);
        const unsigned valid = out.block->validMask(out.ref.node);
        if (!(valid >> below.octant() & 1)) return Place::kBackground;
        const ChildrenRef first = out.block->children(out.ref.node);
        const TreeBlock* block = channel_.block(first.block);
        if (!block) return missingBlock(first.block);
        const auto before = std::uint32_t(std::popcount(valid & ((1u << below.octant()) - 1)));
        // A block that lies about its head: nothing there.
        if (first.first + before >= block->nodeCount()) return Place::kBackground;
        out = {{first.block, first.first + before}, below, block};
    }
    return Place::kNode;
}

NodeFields::NodeField NodeFields::read(const PlacedNode& node) const {
    NodeField field;
    field.node = node;
    for (;;) {
        const NodeRecord& record = field.node.record();
        if (!record.hasBrick()) {
            field.state = State::kValue;
            field.value =
                double(toFloat(channel_.type(), field.node.block->constant(field.node.ref.node)[0]));
            return field;
        }
        PageAddress page{channel_.index(), field.node.ref.block, field.node.ref.node, false};
        field.state = State::kBrick;
        if ((field.samples = context_.cache->find(page))) return field;
        if (missing_ == MissingPages::kWant && !context_.failed->contains({false, page})) {
            context_.wants->add({false, page}, record.payload_bytes, worth_, context_.tile);
            field.state = State::kMissing;
            return field;
        }
        field.failed = true;
        page.draft = true;
        if (record.hasDraft() && (field.samples = context_.cache->find(page))) return field;
        // Its parent is on the way that led here, so only the roots end it.
        if (field.node.key.level >= channel_.roots()[0].level) break;
        PlacedNode parent;
        bool barred = false;
        if (place(field.node.key.parent(), parent, barred) != Place::kNode) break;
        field.node = parent;
    }
    field.state = State::kUnknown;
    return field;
}

NodeFields::NodeField NodeFields::sample(int level, const std::array<std::int64_t, 3>& position) {
    const int edge = channel_.shape().edge_cells;
    const int shift = std::countr_zero(unsigned(edge));
    const NodeKey key{level, std::int32_t(position[0] >> shift), std::int32_t(position[1] >> shift),
                      std::int32_t(position[2] >> shift)};
    if (!(key == last_key_)) {
        last_key_ = key;
        last_ = {};
        PlacedNode node;
        bool failed = false;
        switch (place(key, node, failed)) {
            case Place::kNode:
                last_ = read(node);
                last_.failed = last_.failed || failed;
                break;
            case Place::kBackground:
                last_.state = State::kValue;
                last_.value = double(channel_.background());
                break;
            case Place::kMissing:
                last_.state = failed ? State::kUnknown : State::kMissing;
                last_.failed = failed;
                break;
        }
    }
    NodeField out = last_;
    if (out.state != State::kBrick) return out;
    // Exact: lattices nest, so a cell of a coarser leaf is a power of two of these.
    const double cells = cellEdge(out.node.key.level - level);
    glm::dvec3 place_in_brick;
    const std::int32_t corner[3] = {out.node.key.x, out.node.key.y, out.node.key.z};
    for (int a = 0; a < 3; ++a)
        place_in_brick[a] = double(position[std::size_t(a)]) / cells - double(corner[a]) * edge;
    out.state = State::kValue;
    out.value = valueInBrick(out.samples, channel_.shape(), place_in_brick);
    return out;
}

double valueInBrick(const float* samples, BrickShape shape, const glm::dvec3& position) {
    int cell[3];
    glm::dvec3 inside;
    for (int a = 0; a < 3; ++a) {
        cell[a] = int(std::clamp(std::floor(position[a]), 0.0, double(shape.edge_cells - 1)));
        inside[a] = std::clamp(position[a] - cell[a], 0.0, 1.0);
    }
    const std::size_t sy = std::size_t(shape.edgeSamples()), sz = sy * sy;
    const float* c = samples + shape.sampleAt(cell[0], cell[1], cell[2]);
    return Cell{{c[0], c[1], c[sy], c[sy + 1], c[sz], c[sz + 1], c[sz + sy], c[sz + sy + 1]}}.at(inside);
}

}  // namespace brickyard

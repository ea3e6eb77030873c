#include "client/cpu/plan_scope.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "client/cpu/node_error.h"

namespace brickyard {

namespace {

// Levels below what is drawn that a plan can reach, step by step. Each costs twice the time of the one before
// along a ray.
constexpr int kLookAhead = 4;

// Along a ray the error of a level changes sign from voxel to voxel; that of a draft, which is quantised,
// keeps it longer where the field is smooth. In voxels, measured: docs/decisions/0004-page-order.md.
constexpr double kDraftRun = 3;

// Pixels of a cell of the picture that one ray stands for.
struct PixelCell {
    std::uint32_t x0, y0, x1, y1;
    std::uint32_t x, y;  // the one that is cast
};

class ScopeBuilder {
public:
    ScopeBuilder(PlanScope& scope, const PagedChannel& channel, const PinholeCamera& camera,
                 const ResidentTree& tree, const PlanRequest& request)
        : scope_(scope), channel_(channel), camera_(camera), tree_(tree), request_(request) {
        index_.resize(channel.blockCount());
    }

    void castAll() {
        std::uint32_t stride = request_.stride;
        if (stride == 0) {
            stride = 1;
            auto rays = [&](std::uint64_t s) {
                return ((camera_.width() + s - 1) / s) * ((camera_.height() + s - 1) / s);
            };
            while (rays(stride) > kMostPlanRays) ++stride;
        }
        for (std::uint32_t y = 0; y < camera_.height(); y += stride)
            for (std::uint32_t x = 0; x < camera_.width(); x += stride) {
                PixelCell cell{
                    x, y, std::min(x + stride, camera_.width()), std::min(y + stride, camera_.height()),
                    0, 0};
                // Scattered, so that bricks smaller than a cell are met alike; the same in every plan.
                const std::uint32_t hash = (x * 0x9e3779b9u ^ y * 0x85ebca6bu) * 0xc2b2ae35u;
                cell.x = x + (hash >> 8) % (cell.x1 - cell.x0);
                cell.y = y + (hash >> 20) % (cell.y1 - cell.y0);
                cast(cell);
            }
    }

    // Units of a subtree become neighbours: counted from below, placed from above.
    void arrangeUnits() {
        std::vector<PlanNode>& nodes = scope_.nodes;
        std::vector<std::uint32_t> own(nodes.size(), 0), all(nodes.size(), 0);
        for (const PlanUnit& unit : found_) ++own[unit.node];
        for (std::size_t i = nodes.size(); i-- > 0;) {
            all[i] += own[i];
            if (nodes[i].parent != PlanNode::kNone) all[nodes[i].parent] += all[i];
        }
        std::vector<std::uint32_t> next(nodes.size());
        std::uint32_t total = 0;
        for (std::size_t i = 0; i < nodes.size(); ++i) {
            std::uint32_t& place = nodes[i].parent == PlanNode::kNone ? total : next[nodes[i].parent];
            nodes[i].begin = place;
            next[i] = place + own[i];
            nodes[i].end = place += all[i];
        }
        for (std::size_t i = 0; i < nodes.size(); ++i) next[i] = nodes[i].begin;
        scope_.units.resize(found_.size());
        for (PlanUnit& unit : found_) {
            unit.drawn_square = planSquare(nodes[unit.drawn], unit.drawn_draft, unit.region);
            scope_.units[next[unit.node]++] = unit;
        }
    }

private:
    // Mean over the cell of the squared transmittance, times its pixels.
    double weight(const PixelCell& cell) const {
        if (request_.transmittance.empty()) return double(cell.x1 - cell.x0) * double(cell.y1 - cell.y0);
        double sum = 0;
        for (std::uint32_t y = cell.y0; y < cell.y1; ++y)
            for (std::uint32_t x = cell.x0; x < cell.x1; ++x) {
                const double t = double(request_.transmittance[std::size_t(y) * camera_.width() + x]);
                sum += t * t;
            }
        return sum;
    }

    void cast(const PixelCell& cell) {
        const double seen = weight(cell);
        if (request_.order == PageOrder::kErrorPerByte && !(seen > 0)) return;
        RaySpan span{0, std::numeric_limits<double>::infinity()};
        if (request_.order == PageOrder::kProjectedSize && !request_.opaque_distance.empty())
            span.end = double(request_.opaque_distance[std::size_t(cell.y) * camera_.width() + cell.x]);
        const IndexRay ray(camera_.ray(cell.x, cell.y), channel_.transform());
        span = ray.clip(channel_.clipLow(), channel_.clipHigh(), span);
        if (span.empty()) return;
        ray_ = &ray;
        // The other orders count what is met, however dark.
        per_length_ = std::max(seen, 1e-30) * request_.scale * request_.scale * ray.unitLength();
        walkOctree(
            channel_, ray, span, [](const WalkedNode&) { return false; },
            [&](const WalkedNode& root) {
                if (root.status == WalkStatus::kNode && root.record().hasBrick())
                    visit(root, PlanNode::kNone, PlanNode::kNone, 0);
                return true;
            });
    }

    std::uint32_t place(const WalkedNode& node, std::uint32_t parent) {
        std::vector<std::uint32_t>& places = index_[node.ref.block];
        if (places.empty()) places.assign(node.block->nodeCount(), PlanNode::kNone);
        std::uint32_t& at = places[node.ref.node];
        if (at == PlanNode::kNone) {
            at = std::uint32_t(scope_.nodes.size());
            PlanNode& added = scope_.nodes.emplace_back();
            added.ref = node.ref;
            added.key = node.key;
            added.block = node.block;
            added.parent = parent;
            added.residency = tree_.at(node.ref);
            if (parent != PlanNode::kNone) {
                added.next_sibling = scope_.nodes[parent].first_child;
                scope_.nodes[parent].first_child = at;
            }
            units_of_.emplace_back().fill(PlanNode::kNone);
        }
        return at;
    }

    // `drawn`: the node above that is drawn, `depth` levels up. A root that is not there is planned as if it
    // were: it comes first anyway. REQUIRES: the node has a brick.
    void visit(const WalkedNode& node, std::uint32_t parent, std::uint32_t drawn, int depth) {
        const std::uint32_t at = place(node, parent);
        if (drawn == PlanNode::kNone || scope_.nodes[at].residency != Residency::kNone) drawn = at, depth = 0;
        if (!canDescend(node) || !(depth < kLookAhead || tree_.below(node.ref))) {
            measure(at, drawn, node.span);
            return;
        }
        walkChildren(channel_, *ray_, node, [&](const WalkedNode& child) {
            if (child.status == WalkStatus::kMissingBlock) {
                scope_.nodes[at].missing_block = child.missing_block;
                measure(at, drawn, node.span);
            } else if (child.status == WalkStatus::kNode && child.record().hasBrick()) {
                visit(child, at, drawn, depth + 1);
            }
            return true;
        });
    }

    // Adds a stretch in a node to the node's units, octant by octant.
    void measure(std::uint32_t node, std::uint32_t drawn, RaySpan span) {
        const NodeKey key = scope_.nodes[node].key;
        const glm::dvec3 middle = nodeLow(key, channel_.shape()) + 0.5 * nodeEdge(key, channel_.shape());
        double cuts[5] = {span.begin};
        int count = 1;
        for (int a = 0; a < 3; ++a) {
            if (ray_->parallel[a]) continue;
            const double t = ray_->planeAt(a, middle[a]);
            if (t > span.begin && t < span.end) cuts[count++] = t;
        }
        cuts[count++] = span.end;
        std::sort(cuts, cuts + count);
        for (int i = 0; i + 1 < count; ++i) {
            const double t = 0.5 * (cuts[i] + cuts[i + 1]);
            int octant = 0;
            for (int a = 0; a < 3; ++a)
                if (ray_->origin[a] + t * ray_->direction[a] >= middle[a]) octant |= 1 << a;
            unitOf(node, octant, drawn).measure += per_length_ * (cuts[i + 1] - cuts[i]);
        }
    }

    PlanUnit& unitOf(std::uint32_t node, int octant, std::uint32_t drawn) {
        std::uint32_t& at = units_of_[node][std::size_t(octant)];
        if (at == PlanNode::kNone) {
            at = std::uint32_t(found_.size());
            PlanUnit& unit = found_.emplace_back();
            unit.node = node;
            unit.region = scope_.nodes[node].key.child(octant);
            unit.drawn = drawn;
            unit.drawn_draft = scope_.nodes[drawn].residency == Residency::kDraft;
        }
        return found_[at];
    }

    PlanScope& scope_;
    const PagedChannel& channel_;
    const PinholeCamera& camera_;
    const ResidentTree& tree_;
    const PlanRequest& request_;
    std::vector<std::vector<std::uint32_t>> index_;       // by block, by node: place in scope_.nodes
    std::vector<std::array<std::uint32_t, 8>> units_of_;  // beside nodes, by octant: place in found_
    std::vector<PlanUnit> found_;
    const IndexRay* ray_ = nullptr;
    double per_length_ = 0;
};

}  // namespace

PlanScope::PlanScope(const PagedChannel& channel, const PinholeCamera& camera, const ResidentTree& tree,
                     const PlanRequest& request) {
    ScopeBuilder builder(*this, channel, camera, tree, request);
    builder.castAll();
    builder.arrangeUnits();
}

double planSquare(const PlanNode& node, bool draft, const NodeKey& region) {
    const NodeRecord& record = node.record();
    const double edge = cellEdge(node.key.level);
    if (draft)
        return effectiveSquare(double(record.draft_rms), double(record.draft_bound)) * edge * kDraftRun;
    const ErrorGrid* grid = node.block->errorGrid(node.ref.node);
    if (record.bound == 0 || !grid) return effectiveSquare(double(record.rms), double(record.bound)) * edge;

    // Sub-boxes are the regions of the nodes two levels below; `region` lies in one, or is of some.
    const int up = std::max(0, node.key.level - 2 - region.level);
    const int across = 1 << std::max(0, 2 - (node.key.level - region.level));
    const std::int32_t at[3] = {region.x, region.y, region.z};
    int first[3];
    for (int a = 0; a < 3; ++a) first[a] = across > 1 ? (at[a] * across) & 3 : (at[a] >> up) & 3;
    double sum = 0;
    for (int z = first[2]; z < first[2] + across; ++z)
        for (int y = first[1]; y < first[1] + across; ++y)
            for (int x = first[0]; x < first[0] + across; ++x) {
                const auto box = std::size_t(x + kErrorGridEdge * (y + kErrorGridEdge * z));
                sum += effectiveSquareOfCodes(grid->rms[box], grid->bound[box]);
            }
    const double unit = double(record.bound) * double(record.bound);
    return sum / (across * across * across) * unit * edge;
}

}  // namespace brickyard

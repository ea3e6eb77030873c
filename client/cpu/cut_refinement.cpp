#include "client/cpu/cut_refinement.h"

#include <algorithm>
#include <array>
#include <queue>

#include "client/cpu/node_error.h"

namespace brickyard {

namespace {

constexpr int kLanes = RayPacket::kRays;

bool hasLane(std::uint16_t mask, int lane) { return mask >> lane & 1; }

// A node of the cut while it is refined, with the error that each ray gets from it: a variance of the pixel,
// or with a strict bound its half-width.
struct Item {
    WalkedNode node;
    bool draft = false;
    double rank =
        0;  // what a split does for all rays: the node's squared error over its volume; 0: none can help
    std::vector<std::uint16_t> packets;
    std::vector<std::array<float, kLanes>> error;
};

class Refinement {
public:
    Refinement(const RenderPlan& plan, const FrontToBack& order, std::vector<CutRays>& rays,
               const RayContext& context, TileCut& cut)
        : plan_(plan), channel_(*plan.density), order_(order), rays_(rays), context_(context), cut_(cut) {
        const double error = plan.quality.max_error;
        target_ = plan.quality.strict ? error : error / 3 * error / 3;
        for (const CutRays& asks : rays) packets_.push_back(asks.packet);
        sums_.resize(rays.size());
    }
    bool run();

private:
    Item describe(const WalkedNode& node, PacketList list) const;
    void take(const WalkedNode& node, PacketList list);
    bool split(Item item);
    bool needed(const Item& item) const;
    void account(const Item& item, double sign) {
        for (std::size_t k = 0; k < item.packets.size(); ++k)
            for (std::size_t lane = 0; lane < kLanes; ++lane)
                sums_[item.packets[k]][lane] += sign * double(item.error[k][lane]);
    }
    void wantBlock(std::uint32_t block, std::size_t rays) {
        const WantedPage page{true, {channel_.index(), block, 0}};
        if (context_.failed->contains(page)) return;
        missing_ = true;
        context_.wants->add(page, std::uint32_t(channel_.blockBytes(block)), double(rays), context_.tile);
    }

    const RenderPlan& plan_;
    const PagedChannel& channel_;
    const FrontToBack& order_;
    std::vector<CutRays>& rays_;
    const RayContext& context_;
    TileCut& cut_;
    double target_ = 0;
    std::vector<RayPacket> packets_;
    std::vector<std::array<double, kLanes>> sums_;
    std::vector<Item> items_;
    struct Ranked {
        double rank;
        std::size_t item;
        bool operator<(const Ranked& other) const {
            return rank != other.rank ? rank < other.rank : item > other.item;
        }
    };
    std::priority_queue<Ranked> queue_;
    bool missing_ = false;
};

Item Refinement::describe(const WalkedNode& node, PacketList list) const {
    Item item;
    item.node = node;
    const NodeRecord& record = node.record();
    item.draft = record.hasBrick() && cut_.usesDraft(node);
    const NodeErrors errors =
        item.draft ? errorsOfDraft(record) : errorsOfNode(record, node.block->errorGrid(node.ref.node));
    if (errors.exact()) return item;
    const glm::dvec3 low = nodeLow(node.key, channel_.shape());
    const double edge = nodeEdge(node.key, channel_.shape());
    const glm::dvec3 high = low + edge;
    const double cell = cellEdge(node.key.level);
    const bool strict = plan_.quality.strict;
    double nearest = std::numeric_limits<double>::infinity();
    item.packets.assign(list.begin(), list.end());
    item.error.resize(list.count);
    for (std::size_t k = 0; k < list.count; ++k) {
        const CutRays& rays = rays_[list.places[k]];
        PacketSpans spans;
        clipPacket(packets_[list.places[k]], &low[0], &high[0], spans);
        alignas(64) double bound[kLanes] = {}, square[kLanes] = {};
        if (!errors.uniform)
            integrateGrid(packets_[list.places[k]], &low[0], edge, spans, errors.bound, errors.square, bound,
                          square);
        for (int lane = 0; lane < kLanes; ++lane) {
            const double length = spans.end[lane] - spans.begin[lane];
            if (!(length > 0)) continue;
            if (errors.uniform) bound[lane] = square[lane] = length;
            const double effect = rays.effect[lane];
            const double error =
                strict ? bound[lane] * errors.bound_scale * effect
                       : square[lane] * errors.square_scale * rays.unit[lane] * cell * effect * effect;
            item.error[k][std::size_t(lane)] = float(std::min(error, 1e30));
            const double pixel = plan_.camera->pixelEdge() * 0.5 * (spans.begin[lane] + spans.end[lane]);
            nearest = std::min(nearest, pixel / rays.unit[lane]);
        }
    }
    if (!item.draft && !canDescend(node)) return item;
    if (plan_.quality.pixels_per_voxel > 0 && cell <= plan_.quality.pixels_per_voxel * nearest) return item;
    const double deviation = strict ? double(item.draft ? record.draft_bound : record.bound)
                                    : double(item.draft ? record.draft_rms : record.rms);
    item.rank = deviation * deviation * cell * cell * cell;
    return item;
}

void Refinement::take(const WalkedNode& node, PacketList list) {
    if (node.status == WalkStatus::kMissingBlock) return wantBlock(node.missing_block, list.count);
    items_.push_back(describe(node, list));
    account(items_.back(), 1);
    if (items_.back().rank > 0) queue_.push({items_.back().rank, items_.size() - 1});
}

// Whether a ray that meets it has too much error still, or has not been helped at all: its own sum may rest
// on a transmittance that was better than the truth.
bool Refinement::needed(const Item& item) const {
    for (std::size_t k = 0; k < item.packets.size(); ++k)
        for (int lane = 0; lane < kLanes; ++lane)
            if (item.error[k][std::size_t(lane)] > 0 &&
                (sums_[item.packets[k]][std::size_t(lane)] > target_ ||
                 !hasLane(rays_[item.packets[k]].touched, lane)))
                return true;
    return false;
}

// False where the children's block is missing.
bool Refinement::split(Item item) {
    const PacketList list{item.packets.data(), item.packets.size()};
    if (!item.draft) {
        const ChildrenRef children = item.node.block->children(item.node.ref.node);
        if (!channel_.block(children.block)) {
            wantBlock(children.block, list.count);
            return false;
        }
    }
    for (std::size_t k = 0; k < item.packets.size(); ++k)
        for (int lane = 0; lane < kLanes; ++lane)
            if (item.error[k][std::size_t(lane)] > 0)
                rays_[item.packets[k]].touched = std::uint16_t(rays_[item.packets[k]].touched | 1u << lane);
    account(item, -1);
    if (item.draft) {
        cut_.whole.insert(TileCut::keyOf(item.node.ref));
        take(item.node, list);
        return true;
    }
    cut_.split.insert(TileCut::keyOf(item.node.ref));
    auto stay = [](const WalkedNode&) { return false; };
    auto emit = [&](const WalkedNode& node, PacketList met) { take(node, met); };
    PacketWalk<decltype(stay), decltype(emit)>(channel_, packets_, order_, stay, emit)
        .children(item.node, list);
    return true;
}

bool Refinement::run() {
    const TileCut before = cut_;
    walkPackets(
        channel_, packets_, order_, [&](const WalkedNode& node) { return cut_.descends(node); },
        [&](const WalkedNode& node, PacketList list) { take(node, list); });
    while (!queue_.empty()) {
        const std::size_t at = queue_.top().item;
        queue_.pop();
        if (needed(items_[at])) split(std::move(items_[at]));
    }
    if (!missing_) return true;
    cut_ = before;
    for (CutRays& rays : rays_) rays.touched = 0;
    return false;
}

}  // namespace

bool refineCut(const RenderPlan& plan, const FrontToBack& order, std::vector<CutRays>& rays,
               const RayContext& context, TileCut& cut) {
    return Refinement(plan, order, rays, context, cut).run();
}

}  // namespace brickyard

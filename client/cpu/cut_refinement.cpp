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
               const LitEffect& lit, const RayContext& context, TileCut& cut)
        : plan_(plan),
          channel_(*plan.density),
          order_(order),
          rays_(rays),
          lit_(lit),
          context_(context),
          cut_(cut) {
        const double error = plan.quality.max_error;
        target_ = plan.quality.strict ? error : error / 3 * error / 3;
        for (const CutRays& asks : rays) packets_.push_back(asks.packet);
        sums_.resize(rays.size());
    }
    bool run();

private:
    Item describe(const WalkedNode& node, bool draft, PacketList list) const;
    void take(const WalkedNode& node, PacketList list);
    void take(const WalkedNode& node, bool draft, PacketList list);
    // The packets of the item that ask for its split; they leave it.
    std::vector<std::uint16_t> takeNeedy(Item& item);
    void split(const WalkedNode& node, bool draft, PacketList list);
    bool needed(const Item& item, std::size_t k) const;
    void account(const Item& item, std::size_t k, double sign) {
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
    const LitEffect& lit_;
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

Item Refinement::describe(const WalkedNode& node, bool draft, PacketList list) const {
    Item item;
    item.node = node;
    const NodeRecord& record = node.record();
    item.draft = draft;
    NodeErrors errors =
        item.draft ? errorsOfDraft(record) : errorsOfNode(record, node.block->errorGrid(node.ref.node));
    errors.square_scale *= speckFactor(channel_, node.key);
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
            double effect = rays.effect[lane];
            if (lit_) effect = std::max(effect, lit_(list.places[k], lane, spans.begin[lane]));
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
    const PacketMask drafts = node.record().hasBrick() ? cut_.usesDraft(node) : 0;
    std::uint16_t draft[kMostTilePackets], whole[kMostTilePackets];
    std::size_t draft_count = 0, whole_count = 0;
    for (std::uint16_t place : list)
        (drafts & maskOf(place) ? draft[draft_count++] : whole[whole_count++]) = place;
    if (draft_count > 0) take(node, true, {draft, draft_count});
    if (whole_count > 0) take(node, false, {whole, whole_count});
}

void Refinement::take(const WalkedNode& node, bool draft, PacketList list) {
    items_.push_back(describe(node, draft, list));
    const Item& item = items_.back();
    for (std::size_t k = 0; k < item.packets.size(); ++k) account(item, k, 1);
    if (item.rank > 0) queue_.push({item.rank, items_.size() - 1});
}

// Whether a ray of the item's packet k has too much error still, or has not been helped at all: its own sum
// may rest on a transmittance that was better than the truth.
bool Refinement::needed(const Item& item, std::size_t k) const {
    const std::uint16_t place = item.packets[k];
    for (int lane = 0; lane < kLanes; ++lane)
        if (item.error[k][std::size_t(lane)] > 0 &&
            (sums_[place][std::size_t(lane)] > target_ || !hasLane(rays_[place].touched, lane)))
            return true;
    return false;
}

std::vector<std::uint16_t> Refinement::takeNeedy(Item& item) {
    std::vector<std::uint16_t> needy;
    for (std::size_t k = 0; k < item.packets.size(); ++k) {
        if (!needed(item, k)) continue;
        const std::uint16_t place = item.packets[k];
        for (int lane = 0; lane < kLanes; ++lane)
            if (item.error[k][std::size_t(lane)] > 0)
                rays_[place].touched = std::uint16_t(rays_[place].touched | 1u << lane);
        account(item, k, -1);
        needy.push_back(place);
    }
    return needy;
}

void Refinement::split(const WalkedNode& node, bool draft, PacketList list) {
    PacketMask mask = 0;
    for (std::uint16_t place : list) mask |= maskOf(place);
    if (draft) {
        cut_.useWhole(node.ref, mask);
        return take(node, false, list);
    }
    cut_.split(node.ref, mask);
    auto stay = [](const WalkedNode&) { return PacketMask(0); };
    auto emit = [&](const WalkedNode& child, PacketList met) { take(child, met); };
    PacketWalk<decltype(stay), decltype(emit)>(channel_, packets_, order_, stay, emit).children(node, list);
}

bool Refinement::run() {
    const TileCut before = cut_;
    walkPackets(
        channel_, packets_, order_, [&](const WalkedNode& node) { return cut_.descends(node); },
        [&](const WalkedNode& node, PacketList list) { take(node, list); });
    while (!queue_.empty()) {
        const std::size_t at = queue_.top().item;
        queue_.pop();
        const WalkedNode node = items_[at].node;
        const bool draft = items_[at].draft;
        if (!draft) {
            const ChildrenRef children = node.block->children(node.ref.node);
            if (!channel_.block(children.block)) {
                // Only if somebody asks for it.
                for (std::size_t k = 0; k < items_[at].packets.size(); ++k)
                    if (needed(items_[at], k)) {
                        wantBlock(children.block, items_[at].packets.size());
                        break;
                    }
                continue;
            }
        }
        const std::vector<std::uint16_t> needy = takeNeedy(items_[at]);
        if (!needy.empty()) split(node, draft, {needy.data(), needy.size()});
    }
    if (!missing_) return true;
    cut_ = before;
    for (CutRays& rays : rays_) rays.touched = 0;
    return false;
}

}  // namespace

bool refineCut(const RenderPlan& plan, const FrontToBack& order, std::vector<CutRays>& rays,
               const LitEffect& lit, const RayContext& context, TileCut& cut) {
    return Refinement(plan, order, rays, lit, context, cut).run();
}

}  // namespace brickyard

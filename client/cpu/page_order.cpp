#include "client/cpu/page_order.h"

#include <algorithm>
#include <cmath>
#include <queue>
#include <tuple>

#include "client/cpu/plan_scope.h"

namespace brickyard {

namespace {

// Of the error below a node whose children's block is missing, the part that the block is expected to lead
// to; and the bytes of bricks that this takes beside the block, in bricks like the node's own.
constexpr double kBlockShare = 0.75;
constexpr double kBricksBehindBlock = 8;
// Levels that a page may be below what is drawn. With 1 no level is jumped over; what sub-boxes tell reaches
// two levels down, and guesses about those below do harm (docs/decisions/0004-page-order.md).
constexpr int kFarthestJump = 2;
// Pages that do not fit are passed over for smaller ones this many times.
constexpr int kMostPassedOver = 64;

struct Candidate {
    double rate = 0;  // what the order ranks by; larger is sooner
    double worth = 0;
    std::uint32_t node = 0;
    bool draft = false;
    bool block = false;
};

class Planner {
public:
    Planner(const PagedChannel& channel, const PinholeCamera& camera, const ResidentTree& tree,
            const PlanRequest& request)
        : channel_(channel), camera_(camera), request_(request), scope_(channel, camera, tree, request) {}

    PagePlan plan() {
        plan_.error_before = error();
        planRoots();
        if (request_.order == PageOrder::kErrorPerByte)
            planByWorth();
        else
            planByRank();
        plan_.error_after = error();
        return std::move(plan_);
    }

private:
    double error() const {
        double sum = 0;
        for (const PlanUnit& unit : scope_.units) sum += unit.error();
        return sum;
    }
    bool full() const { return plan_.bytes >= request_.batch_bytes || passed_over_ >= kMostPassedOver; }

    std::uint32_t bytesOf(const Candidate& c) const {
        const PlanNode& node = scope_.nodes[c.node];
        if (c.block) return std::uint32_t(channel_.blockBytes(node.missing_block));
        return c.draft ? node.record().draft_bytes : node.record().payload_bytes;
    }
    WantedPage pageOf(const Candidate& c) const {
        const PlanNode& node = scope_.nodes[c.node];
        if (c.block) return {true, {channel_.index(), node.missing_block, 0}};
        return {false, {channel_.index(), node.ref.block, node.ref.node, c.draft}};
    }

    // Adds the page where it fits, and draws it.
    bool take(const Candidate& c) {
        const std::uint32_t bytes = bytesOf(c);
        if (bytes > request_.max_bytes - plan_.bytes) {
            plan_.over_budget = true;
            ++passed_over_;
            return false;
        }
        plan_.pages.push_back({pageOf(c), bytes, c.worth});
        plan_.bytes += bytes;
        if (c.block) return true;
        const PlanNode& node = scope_.nodes[c.node];
        const int rank = planRank(node.key, c.draft);
        for (std::uint32_t u = node.begin; u < node.end; ++u) {
            PlanUnit& unit = scope_.units[u];
            if (planRank(scope_.nodes[unit.drawn].key, unit.drawn_draft) <= rank) continue;
            unit.drawn = c.node;
            unit.drawn_draft = c.draft;
            unit.drawn_square = planSquare(node, c.draft, unit.region);
        }
        return true;
    }

    void planRoots() {
        for (std::uint32_t i = 0; i < scope_.nodes.size(); ++i) {
            const PlanNode& node = scope_.nodes[i];
            if (node.parent != PlanNode::kNone || node.residency != Residency::kNone) continue;
            Candidate root{0, plan_.error_before, i, node.record().hasDraft(), false};
            if (!isFailed(root)) take(root);
        }
    }

    bool isFailed(const Candidate& c) const { return request_.failed && request_.failed(pageOf(c)); }

    template <class Add>
    void forEachCandidate(Add add) const {
        for (std::uint32_t i = 0; i < scope_.nodes.size(); ++i) forEachCandidateOf(i, add);
    }
    template <class Add>
    void forEachCandidateOf(std::uint32_t i, Add add) const {
        const PlanNode& node = scope_.nodes[i];
        if (node.missing_block != PlanNode::kNone) add(Candidate{0, 0, i, false, true});
        // A root that was missing has been planned.
        const bool planned_root = node.parent == PlanNode::kNone && node.residency == Residency::kNone;
        if (node.residency == Residency::kNone && node.record().hasDraft() && !planned_root)
            add(Candidate{0, 0, i, true, false});
        if (node.residency != Residency::kWhole && !(planned_root && !node.record().hasDraft()))
            add(Candidate{0, 0, i, false, false});
    }

    // Brings a candidate's worth up to date with what is drawn.
    void weigh(Candidate& c) const {
        const PlanNode& node = scope_.nodes[c.node];
        double sum = 0;
        if (c.block) {
            for (std::uint32_t u = node.begin; u < node.end; ++u) sum += scope_.units[u].error();
            c.worth = sum * kBlockShare;
            c.rate = c.worth / (bytesOf(c) + kBricksBehindBlock * node.record().payload_bytes);
            return;
        }
        const int rank = planRank(node.key, c.draft);
        for (std::uint32_t u = node.begin; u < node.end; ++u) {
            const PlanUnit& unit = scope_.units[u];
            const NodeKey& drawn = scope_.nodes[unit.drawn].key;
            if (planRank(drawn, unit.drawn_draft) <= rank || drawn.level > node.key.level + kFarthestJump)
                continue;
            const double square = planSquare(node, c.draft, unit.region);
            sum += unit.measure * (unit.drawn_square - square);
        }
        c.worth = sum;
        c.rate = sum / bytesOf(c);
    }

    // Larger rate first; what ties, by place in the tree.
    bool later(const Candidate& a, const Candidate& b) const {
        if (a.rate != b.rate) return a.rate < b.rate;
        return std::tuple(!a.block, a.node, !a.draft) > std::tuple(!b.block, b.node, !b.draft);
    }

    // Lazy greedy: what is drawn gets better, so worth falls, and a page that is still ahead after having
    // been weighed anew is the best. Only pages below one that was taken may be worth more: they are put in
    // again.
    void planByWorth() {
        auto order = [this](const Candidate& a, const Candidate& b) { return later(a, b); };
        std::priority_queue<Candidate, std::vector<Candidate>, decltype(order)> queue(order);
        auto push = [&](Candidate c) {
            weigh(c);
            if (c.worth > 0 && !isFailed(c)) queue.push(c);
        };
        forEachCandidate(push);
        while (!queue.empty() && !full()) {
            Candidate best = queue.top();
            queue.pop();
            weigh(best);
            if (!(best.worth > 0)) continue;
            if (!queue.empty() && later(best, queue.top()))
                queue.push(best);
            else if (take(best) && !best.block)
                pushBelow(best.node, kFarthestJump, push);
        }
    }

    // Blocks below are in the queue already.
    template <class Push>
    void pushBelow(std::uint32_t node, int levels, const Push& push) const {
        for (std::uint32_t c = scope_.nodes[node].first_child; c != PlanNode::kNone;
             c = scope_.nodes[c].next_sibling) {
            forEachCandidateOf(c, [&](const Candidate& candidate) {
                if (!candidate.block) push(candidate);
            });
            if (levels > 1) pushBelow(c, levels - 1, push);
        }
    }

    // The orders that look at no error. A node never comes before its parent; drafts are voxels of level 0,
    // and whole bricks behind them come when nothing else is left.
    void planByRank() {
        constexpr double kLast = 1e-12;
        std::vector<double> rank(scope_.nodes.size());
        for (std::size_t i = 0; i < rank.size(); ++i) {
            const PlanNode& node = scope_.nodes[i];
            rank[i] = node.key.level + 1;
            if (request_.order == PageOrder::kProjectedSize) {
                const double edge = nodeEdge(node.key, channel_.shape());
                const glm::dvec3 middle =
                    channel_.transform().point(nodeLow(node.key, channel_.shape()) + 0.5 * edge);
                rank[i] = cellEdge(node.key.level) / glm::length(middle - camera_.eye());
            }
            if (node.parent != PlanNode::kNone) rank[i] = std::min(rank[i], rank[node.parent]);
        }
        std::vector<Candidate> all;
        forEachCandidate([&](Candidate c) {
            const PlanNode& node = scope_.nodes[c.node];
            if (node.begin == node.end || isFailed(c)) return;
            c.rate = rank[c.node];
            if (!c.block && !c.draft && node.record().hasDraft()) c.rate *= kLast;
            c.worth = c.rate;
            all.push_back(c);
        });
        std::sort(all.begin(), all.end(),
                  [this](const Candidate& a, const Candidate& b) { return later(b, a); });
        for (const Candidate& c : all) {
            if (full()) return;
            take(c);
        }
    }

    const PagedChannel& channel_;
    const PinholeCamera& camera_;
    const PlanRequest& request_;
    PlanScope scope_;
    PagePlan plan_;
    int passed_over_ = 0;
};

}  // namespace

PagePlan planPages(const PagedChannel& channel, const PinholeCamera& camera, const ResidentTree& tree,
                   const PlanRequest& request) {
    PagePlan plan;
    if (channel.empty() || channel.blockCount() == 0 || channel.roots().empty()) return plan;
    if (!channel.block(0)) {
        const PlannedPage first{{true, {channel.index(), 0, 0}}, std::uint32_t(channel.blockBytes(0)), 0};
        if (request.failed && request.failed(first.page)) return plan;
        plan.over_budget = first.bytes > request.max_bytes;
        if (plan.over_budget) return plan;
        plan.pages.push_back(first);
        plan.bytes = first.bytes;
        return plan;
    }
    return Planner(channel, camera, tree, request).plan();
}

}  // namespace brickyard

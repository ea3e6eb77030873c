// Which pages to ask for next, for a picture that is to be good early: with a limit of bytes or time, and in
// viewers. After Crassin et al., GigaVoxels, 2009, where rays ask for what they miss by its size on the
// screen; here by the expected picture error that a page removes per byte.
//
// The picture is the one that resident_tree.h describes: the finest resident page is drawn. The squared error
// of a pixel's alpha is (transmittance of its whole ray)^2 x variance of its optical depth; the variance adds
// up along the ray: square of the effective deviation (node_error.h) x length x one voxel of the drawn level.
// A page's worth is the sum, over the rays through it, of what it takes off that, against whatever is drawn
// there now. Pages of the two levels below what is drawn compete, drafts and whole bricks too, so a level
// that adds little is jumped over. The order is greedy: best worth per byte first, with the worth of the
// others brought up to date after each. docs/decisions/0004-page-order.md has the measurements.
//
// Pure function of its arguments: the same plan for the same topology, residency and transmittance, whatever
// the thread. A wish is best planned in batches of 10 to 25 % of the bytes so far.
#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <span>
#include <vector>

#include "client/cpu/resident_tree.h"
#include "client/cpu/want_list.h"
#include "client/paged_channel.h"
#include "core/camera.h"

namespace brickyard {

enum class PageOrder {
    kErrorPerByte,   // ours
    kProjectedSize,  // what a ray reaches before it is opaque, largest projected voxel first (GigaVoxels)
    kBreadthFirst,   // what a ray meets, level by level
};

struct PlanRequest {
    PageOrder order = PageOrder::kErrorPerByte;
    double scale = 1;  // extinction per world unit and unit of the channel
    // 1 - alpha of each pixel of the picture as it is drawn now, row by row; empty: 1 everywhere.
    std::span<const float> transmittance;
    // kProjectedSize: world distance at which each pixel's ray is opaque; empty: none is.
    std::span<const float> opaque_distance;
    // Every `stride`-th pixel per axis casts a ray. 0: at most kMostPlanRays in all.
    std::uint32_t stride = 0;
    // Pages that cannot be had are neither planned nor waited for. May be empty.
    std::function<bool(const WantedPage&)> failed;
    // The plan ends with the page that reaches this.
    std::uint64_t batch_bytes = 64u << 10;
    // Never exceeded. A page that does not fit is passed over for smaller ones.
    std::uint64_t max_bytes = std::numeric_limits<std::uint64_t>::max();
};
inline constexpr std::uint32_t kMostPlanRays = 16384;

struct PlannedPage {
    WantedPage page;
    std::uint32_t bytes = 0;
    // Squared error of alpha expected to go, summed over pixels; a tree block's is what it may lead to. For
    // the other orders: the rank, larger is sooner.
    double worth = 0;
};

struct PagePlan {
    // Tree blocks and pages, best first. Of each page the block has arrived already.
    std::vector<PlannedPage> pages;
    std::uint64_t bytes = 0;
    // Expected squared error of alpha, summed over pixels, before and after the plan's pages.
    double error_before = 0, error_after = 0;
    // A page that would change the picture was left out because of max_bytes. (An empty plan without this
    // means that nothing is left to ask for.)
    bool over_budget = false;
};

// `tree` is the residency of now. Without block 0 the plan is block 0; roots come before all other pages.
// Costs one walk of each ray through the nodes it meets down to four levels below what is drawn; memory: some
// 100 bytes for each such node. An empty channel has an empty plan.
PagePlan planPages(const PagedChannel& channel, const PinholeCamera& camera, const ResidentTree& tree,
                   const PlanRequest& request);

}  // namespace brickyard

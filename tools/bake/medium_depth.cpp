#include "tools/bake/medium_depth.h"

#include <fmt/format.h>

#include <algorithm>
#include <glm/geometric.hpp>
#include <limits>
#include <unordered_set>

#include "client/arrived_nodes.h"
#include "client/brick_page.h"
#include "client/cpu/cell_walk.h"
#include "client/cpu/octree_walk.h"

namespace brickyard {

namespace {

// A wish at a time; a page may wait for the next.
constexpr std::uint64_t kWishBytes = 32u << 20;

// Bricks that a walk to the finest level ends at, and blocks on the way there, that have not arrived.
PageWish missingOf(const PagedChannel& channel, const PageCache& cache, std::uint64_t room_bytes) {
    PageWish wish;
    const auto add = [&](const WishedPage& page, std::uint64_t bytes) {
        if (!wish.pages.empty() && wish.credit_bytes + bytes > room_bytes) return;
        wish.pages.push_back(page);
        wish.credit_bytes += bytes;
    };
    std::unordered_set<std::uint32_t> blocks;
    forEachArrived(
        channel,
        [&](const NodeRef& ref, const NodeKey& key) {
            const TreeBlock& block = *channel.block(ref.block);
            const NodeRecord& record = block.record(ref.node);
            const PageAddress page{channel.index(), ref.block, ref.node};
            if ((key.level == 0 || block.isLeaf(ref.node)) && record.hasBrick() && !cache.contains(page))
                add({false, page}, record.payload_bytes);
            return true;
        },
        [&](std::uint32_t block) {
            if (blocks.insert(block).second)
                add({true, {channel.index(), block, 0}}, channel.blockBytes(block));
        });
    return wish;
}

// What a clip leaves of a ray is one stretch: box and half-spaces are convex.
RaySpan clipped(const WorldClip& clip, const WorldRay& ray, RaySpan span) {
    const auto keep = [&](double at_origin, double along) {
        // Kept is at_origin + t * along >= 0.
        if (along > 0)
            span.begin = std::max(span.begin, -at_origin / along);
        else if (along < 0)
            span.end = std::min(span.end, -at_origin / along);
        else if (at_origin < 0)
            span.end = span.begin;
    };
    for (int a = 0; clip.box && a < 3; ++a) {
        keep(ray.origin[a] - (*clip.box)[0][a], ray.direction[a]);
        keep((*clip.box)[1][a] - ray.origin[a], -ray.direction[a]);
    }
    for (const WorldClip::Plane& plane : clip.planes)
        keep(glm::dot(plane.normal, ray.origin - plane.point), glm::dot(plane.normal, ray.direction));
    return span;
}

// Of max(0, field) through one channel.
double channelDepth(const PagedChannel& channel, const PageCache& cache, const WorldRay& world, RaySpan span,
                    double enough) {
    if (channel.empty()) return 0;
    const IndexRay ray(world, channel.transform());
    span = ray.clip(channel.clipLow(), channel.clipHigh(), span);
    if (span.empty()) return 0;
    const double background = std::max(0.0, double(channel.background()));
    double depth = 0;
    walkOctree(
        channel, ray, span, [](const WalkedNode&) { return true; },
        [&](const WalkedNode& node) {
            const double length = node.span.end - node.span.begin;
            if (node.status != WalkStatus::kNode) {
                // A block that is missing is one that does not exist: all have been loaded.
                depth += background * length;
            } else if (!node.record().hasBrick()) {
                const ValueBits bits = node.block->constant(node.ref.node)[0];
                depth += std::max(0.0, double(toFloat(channel.type(), bits))) * length;
            } else if (const float* samples = cache.find({channel.index(), node.ref.block, node.ref.node})) {
                double inside = 0;
                walkCells(samples, channel.shape(), node.key, node.record(), ray, node.span,
                          [&](const Cell& cell, const glm::dvec3& a, const glm::dvec3& b, double begin,
                              double end) {
                              depth += meanPositive(cell, a, b) * (end - begin);
                              inside += end - begin;
                          });
                depth += background * std::max(0.0, length - inside);
            }
            return depth <= enough;
        });
    return depth;
}

}  // namespace

Result<std::unique_ptr<const MediumDepth>> MediumDepth::load(BrickSource& source, std::uint32_t frame,
                                                             const FrameFooter& footer,
                                                             const WorldSettings& world) {
    std::unique_ptr<MediumDepth> depth(new MediumDepth(source));
    if (const auto opened = depth->stream_.open(frame, SourceDeadline::max()); !opened)
        return tl::unexpected(opened.error());
    // As many as there can be; memory is taken as they come.
    std::uint64_t bytes = 0;
    const std::uint64_t page = pageFloats(BrickShape{int(footer.brick_edge())}) * sizeof(float);
    for (const MediumSettings& medium : world.media)
        bytes += (footer.channels(int(medium.density.channel)).bricks() + 1) * page;
    if (Result<void> begun = depth->stream_.begin(footer, bytes); !begun)
        return tl::unexpected(begun.error());
    for (const MediumSettings& medium : world.media) {
        if (medium.transfer)
            return fail(
                ErrorCode::kUnsupported,
                fmt::format("{}: a medium with a transfer function cannot be baked; use --shadows deep",
                            source.name()));
        const Result<PagedChannel*> channel = depth->stream_.channel(medium.density.channel);
        if (!channel) return tl::unexpected(channel.error());
        depth->media_.push_back({*channel, medium.density_scale});
    }
    depth->clip_ = world.clip;
    if (Result<void> loaded = depth->loadPages(); !loaded) return tl::unexpected(loaded.error());
    return std::unique_ptr<const MediumDepth>(std::move(depth));
}

Result<void> MediumDepth::loadPages() {
    for (const Extinction& medium : media_)
        while (stream_.failed().empty()) {
            const PageWish wish = missingOf(*medium.channel, stream_.cache(), kWishBytes);
            if (wish.pages.empty()) break;
            if (Result<void> taken = stream_.take(wish, SourceDeadline::max()); !taken) return taken;
        }
    if (stream_.failed().empty()) return {};
    return fail(ErrorCode::kCorrupt, stream_.firstFailure());
}

double MediumDepth::along(const WorldRay& ray, double end) const {
    const RaySpan span = clipped(clip_, ray, {0, end});
    if (span.empty()) return 0;
    double depth = 0;
    for (const Extinction& medium : media_) {
        if (!(medium.scale > 0)) continue;
        depth += medium.scale *
                 channelDepth(*medium.channel, stream_.cache(), ray, span, (kOpaque - depth) / medium.scale);
        if (depth > kOpaque) break;
    }
    return depth;
}

}  // namespace brickyard

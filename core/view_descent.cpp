#include "core/view_descent.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <glm/geometric.hpp>
#include <limits>
#include <optional>
#include <queue>
#include <unordered_set>
#include <utility>

#include "core/affine.h"
#include "core/node_key.h"

namespace brickyard {
namespace {

// A tree that refers to itself must not keep us forever; no view of a sound one looks at this many nodes.
constexpr std::uint64_t kMaxVisits = 1u << 23;
// Nodes that wait to be looked at. Some thousand bricks are sent before so many are found.
constexpr std::size_t kMaxCandidates = 1u << 16;
// Blocks that are held: those above the nodes that are being looked at.
constexpr std::size_t kHeldBlocks = 8;
// Slack of the frustum test, relative to the corner's distance: rounding may not lose a visible node.
constexpr double kPlaneSlack = 1e-9;

struct Box {
    glm::dvec3 begin{0}, end{0};  // index space, closed
};

// The region in which a medium is: its active voxels and one sample around them.
std::optional<Box> grownActiveBox(const ChannelFooter& channel) {
    if (channel.active_min_size() != 3 || channel.active_max_size() != 3) return std::nullopt;
    Box box;
    for (int a = 0; a < 3; ++a) {
        box.begin[a] = double(channel.active_min(a)) - 1;
        box.end[a] = double(channel.active_max(a)) + 1;
    }
    return box;
}

Box regionOf(const NodeKey& key, int brick_edge) {
    const double edge = std::ldexp(double(brick_edge), key.level);
    const glm::dvec3 begin = glm::dvec3(key.x, key.y, key.z) * edge;
    return {begin, begin + edge};
}

// Whether the root's voxels are within int32, so that no coordinate of a node below it overflows.
bool fitsLattice(const RootNode& root) {
    if (root.level() > std::uint32_t(kMaxLevel)) return false;
    const std::int64_t limit = (std::int64_t{1} << 31) >> root.level();
    const auto fits = [&](std::int64_t c) { return c >= -limit && c <= limit; };
    return fits(root.x()) && fits(root.y()) && fits(root.z());
}

// How a box of index space looks from the camera.
struct Projection {
    bool visible = false;
    double distance =
        0;            // from the eye to the nearest point of the box's bounding sphere, guarded against zero
    double area = 0;  // in pixels, at most the picture's
};

class View {
public:
    View(const PinholeCamera& camera, const Affine& index_to_world) : camera_(camera), map_(index_to_world) {
        // Relative to the eye from the start: at 1e12 an absolute corner would have lost its digits.
        eye_index_ = map_.inversePoint(camera.eye());
        const double w = camera.halfWidth(), h = camera.halfHeight();
        planes_ = {camera.forward(), camera.forward() * w + camera.right(),
                   camera.forward() * w - camera.right(), camera.forward() * h + camera.up(),
                   camera.forward() * h - camera.up()};
        voxel_world_ = map_.voxelSize();
    }

    Projection project(const Box& box) const {
        std::array<glm::dvec3, 8> corners;
        double farthest = 0;
        for (std::size_t i = 0; i < 8; ++i) {
            const glm::dvec3 corner{i & 1 ? box.end.x : box.begin.x, i & 2 ? box.end.y : box.begin.y,
                                    i & 4 ? box.end.z : box.begin.z};
            corners[i] = map_.vector(corner - eye_index_);
            farthest = std::max(farthest, glm::length(corners[i]));
        }
        Projection seen;
        for (const glm::dvec3& plane : planes_) {
            const double slack = -kPlaneSlack * farthest * glm::length(plane);
            if (std::all_of(corners.begin(), corners.end(),
                            [&](const glm::dvec3& c) { return glm::dot(plane, c) < slack; }))
                return seen;
        }
        seen.visible = true;

        const glm::dvec3 center = (corners[0] + corners[7]) * 0.5;
        double radius = 0;
        for (const glm::dvec3& corner : corners) radius = std::max(radius, glm::length(corner - center));
        seen.distance = std::max(glm::length(center) - radius, 1e-6 * radius);
        const double edge_pixels = 2 * radius / std::sqrt(3.0) / (seen.distance * camera_.pixelEdge());
        seen.area = std::min(edge_pixels * edge_pixels, double(camera_.width()) * double(camera_.height()));
        return seen;
    }

    // Edge of a voxel of `level` in pixels.
    double voxelPixels(int level, double distance) const {
        return std::ldexp(voxel_world_, level) / (distance * camera_.pixelEdge());
    }

private:
    const PinholeCamera& camera_;
    const Affine& map_;
    glm::dvec3 eye_index_{0};
    std::array<glm::dvec3, 5> planes_;  // normals; every plane goes through the eye and looks inwards
    double voxel_world_ = 0;
};

// A node whose brick is wanted, or a block without which a node's children are unknown.
struct Candidate {
    double priority = 0;      // expected squared error removed per byte
    std::uint64_t order = 0;  // earlier found goes first among equals: the order must not depend on the heap
    bool is_block = false;
    NodeKey key;  // the node; for a block, the parent of the nodes in it
    std::uint32_t block = 0, node = 0;
    bool operator<(const Candidate& other) const {
        return priority != other.priority ? priority < other.priority : order > other.order;
    }
};

}  // namespace

class ViewDescent::Search {
public:
    Search(const PinholeCamera& camera, const Affine& map, const ChannelFooter& channel,
           std::uint32_t channel_index, int brick_edge, float pixels_per_voxel)
        : camera_(camera),
          map_(map),
          view_(camera_, map_),
          channel_(channel),
          channel_index_(channel_index),
          brick_edge_(brick_edge),
          pixels_per_voxel_(double(pixels_per_voxel)) {}
    Search(const Search&) = delete;  // view_ refers to its neighbours
    Search& operator=(const Search&) = delete;

    Result<std::optional<DescentStep>> next(const BlockLoader& load) {
        load_ = &load;
        while (!over_) {
            if (auto done = goOn(); !done) {
                over_ = true;
                return tl::unexpected(done.error());
            }
            if (step_) return std::exchange(step_, std::nullopt);
        }
        return std::nullopt;
    }

    std::size_t memoryBytes() const {
        return queue_.size() * sizeof(Candidate) + emitted_.size() * 4 * sizeof(std::uint32_t);
    }

private:
    // Does one thing; perhaps it gives a step.
    Result<void> goOn() {
        if (!begun_) return begin();
        if (opening_) {
            const Candidate parent = *opening_;
            opening_.reset();
            return offerChildren(parent);
        }
        if (!rooted_) return offerRoots();
        if (queue_.empty() || visits_ >= kMaxVisits) {
            over_ = true;
            return {};
        }
        const Candidate next = queue_.top();
        queue_.pop();
        return next.is_block ? openBlock(next) : takeNode(next);
    }

    Result<void> begin() {
        begun_ = true;
        active_ = grownActiveBox(channel_);
        over_ = !active_ || channel_.blocks_size() == 0;
        if (channel_.blocks_size() > 0) emit(true, 0, 0, channel_.blocks(0).bytes());
        return {};
    }

    Result<void> offerRoots() {
        rooted_ = true;
        const auto top = load(0);
        if (!top) return tl::unexpected(top.error());
        for (int r = 0; r < channel_.roots_size(); ++r) {
            const RootNode& root = channel_.roots(r);
            if (std::uint32_t(r) >= (*top)->nodeCount() || !fitsLattice(root))
                return fail(ErrorCode::kCorrupt,
                            fmt::format("channel {}: root {} is not in its tree; convert this frame again",
                                        channel_.name(), r));
            // Nothing is known above a root: its brick removes the whole range of the values.
            const NodeRecord& record = (*top)->record(std::uint32_t(r));
            const double range = double(record.value_max) - double(record.value_min);
            offer({std::int32_t(root.level()), root.x(), root.y(), root.z()}, **top, 0, std::uint32_t(r),
                  range);
        }
        return {};
    }

    void emit(bool is_block, std::uint32_t block, std::uint32_t node, std::uint32_t bytes) {
        if (is_block) emitted_.insert(block);
        step_ = DescentStep{is_block, {channel_index_, block, node}, bytes};
    }

    Result<std::shared_ptr<const TreeBlock>> load(std::uint32_t block) {
        for (const auto& [held, nodes] : held_)
            if (held == block) return nodes;
        auto nodes = (*load_)(block);
        if (!nodes) return nodes;
        if (held_.size() == kHeldBlocks) held_.pop_front();
        held_.emplace_back(block, *nodes);
        return nodes;
    }

    // What a camera sees of a node: its region within the active box.
    Projection project(const NodeKey& key) const {
        Box box = regionOf(key, brick_edge_);
        for (int a = 0; a < 3; ++a) {
            box.begin[a] = std::max(box.begin[a], active_->begin[a]);
            box.end[a] = std::min(box.end[a], active_->end[a]);
            // A shared face belongs to the neighbour as well.
            if (box.begin[a] >= box.end[a]) return {};
        }
        return view_.project(box);
    }

    // `deviation` is what is expected to be wrong without this node, in the channel's unit.
    void offer(const NodeKey& key, const TreeBlock& nodes, std::uint32_t block, std::uint32_t node,
               double deviation) {
        ++visits_;
        if (queue_.size() >= kMaxCandidates) return;
        const Projection seen = project(key);
        if (!seen.visible) return;
        const double bytes = std::max<double>(nodes.record(node).payload_bytes, 1);
        queue_.push({priorityOf(deviation, seen.area, bytes), order_++, false, key, block, node});
    }

    static double priorityOf(double deviation, double area, double bytes) {
        const double priority = deviation * deviation * area / bytes;
        // Infinite ranges must not make the order depend on how NaN compares.
        return std::isnan(priority) ? 0 : priority;
    }

    Result<void> takeNode(const Candidate& taken) {
        const auto nodes = load(taken.block);
        if (!nodes) return tl::unexpected(nodes.error());
        const NodeRecord& record = (*nodes)->record(taken.node);
        if (record.hasBrick()) emit(false, taken.block, taken.node, record.payload_bytes);

        // A node that is exact, or as fine as the pixels are, needs no children.
        if ((*nodes)->isLeaf(taken.node) || taken.key.level == 0 || record.bound == 0) return {};
        const Projection seen = project(taken.key);
        if (view_.voxelPixels(taken.key.level, seen.distance) <= pixels_per_voxel_) return {};

        const ChildrenRef children = (*nodes)->children(taken.node);
        if (emitted_.contains(children.block)) {
            opening_ = taken;
            return {};
        }
        if (children.block >= std::uint32_t(channel_.blocks_size()))
            return fail(
                ErrorCode::kCorrupt,
                fmt::format("channel {}: node {} has children in block {} of {}; convert this frame again",
                            channel_.name(), toString(taken.key), children.block, channel_.blocks_size()));
        const double bytes = channel_.blocks(int(children.block)).bytes();
        queue_.push({priorityOf(record.rms, seen.area, std::max(bytes, 1.0)), order_++, true, taken.key,
                     taken.block, taken.node});
        return {};
    }

    Result<void> openBlock(const Candidate& parent) {
        const auto nodes = load(parent.block);
        if (!nodes) return tl::unexpected(nodes.error());
        const std::uint32_t block = (*nodes)->children(parent.node).block;
        if (!emitted_.contains(block)) emit(true, block, 0, channel_.blocks(int(block)).bytes());
        // Not looked into before someone asks for what follows.
        opening_ = parent;
        return {};
    }

    // REQUIRES: the step of the block that holds the children was given.
    Result<void> offerChildren(const Candidate& parent) {
        const auto held = load(parent.block);
        if (!held) return tl::unexpected(held.error());
        const TreeBlock& nodes = **held;
        const ChildrenRef children = nodes.children(parent.node);
        const auto held_below = load(children.block);
        if (!held_below) return tl::unexpected(held_below.error());
        const TreeBlock& below = **held_below;
        std::uint32_t child = children.first;
        for (int octant = 0; octant < 8; ++octant) {
            if (!(nodes.validMask(parent.node) >> octant & 1)) continue;
            if (child >= below.nodeCount())
                return fail(
                    ErrorCode::kCorrupt,
                    fmt::format(
                        "channel {}: node {} has more children than block {} holds; convert this frame again",
                        channel_.name(), toString(parent.key), children.block));
            offer(parent.key.child(octant), below, children.block, child++, nodes.record(parent.node).rms);
        }
        return {};
    }

    const PinholeCamera camera_;
    const Affine map_;
    const View view_;
    const ChannelFooter& channel_;
    const std::uint32_t channel_index_;
    const int brick_edge_;
    const double pixels_per_voxel_;
    const BlockLoader* load_ = nullptr;  // of the call that is under way
    std::optional<Box> active_;
    std::optional<DescentStep> step_;
    std::optional<Candidate> opening_;  // whose children are to be offered next
    bool begun_ = false, rooted_ = false, over_ = false;
    std::uint64_t visits_ = 0;
    std::uint64_t order_ = 0;
    std::priority_queue<Candidate> queue_;
    std::unordered_set<std::uint32_t> emitted_;  // blocks
    std::deque<std::pair<std::uint32_t, std::shared_ptr<const TreeBlock>>> held_;
};

ViewDescent::ViewDescent(std::unique_ptr<Search> search) : search_(std::move(search)) {}
ViewDescent::ViewDescent(ViewDescent&&) noexcept = default;
ViewDescent& ViewDescent::operator=(ViewDescent&&) noexcept = default;
ViewDescent::~ViewDescent() = default;

Result<ViewDescent> ViewDescent::create(const PinholeCamera& camera, const ChannelFooter& channel,
                                        std::uint32_t channel_index, int brick_edge, float pixels_per_voxel) {
    const auto map =
        Affine::fromColumns({channel.index_to_world().data(), std::size_t(channel.index_to_world_size())});
    if (!map)
        return fail(ErrorCode::kCorrupt, fmt::format("channel {}: {}", channel.name(), map.error().message));
    return ViewDescent(
        std::make_unique<Search>(camera, *map, channel, channel_index, brick_edge, pixels_per_voxel));
}

Result<std::optional<DescentStep>> ViewDescent::next(const BlockLoader& load) { return search_->next(load); }
std::size_t ViewDescent::memoryBytes() const { return search_->memoryBytes(); }

Result<std::vector<DescentStep>> describeView(const PinholeCamera& camera, const ChannelFooter& channel,
                                              std::uint32_t channel_index, int brick_edge,
                                              const BlockLoader& load, const DescentLimits& limits) {
    auto descent = ViewDescent::create(camera, channel, channel_index, brick_edge, limits.pixels_per_voxel);
    if (!descent) return tl::unexpected(descent.error());
    std::vector<DescentStep> steps;
    for (std::uint64_t bytes = 0; bytes < limits.max_bytes || steps.empty();) {
        auto step = descent->next(load);
        if (!step) return tl::unexpected(step.error());
        if (!*step) break;
        bytes += (*step)->bytes;
        steps.push_back(**step);
    }
    return steps;
}

}  // namespace brickyard

#include "client/trace/channel_reader.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "client/cpu/node_error.h"
#include "client/cpu/octree_walk.h"
#include "client/trace/filter_weights.h"

namespace brickyard {

namespace {

// std::floor is a call without SSE4.1.
std::int64_t floorOf(double x) {
    const std::int64_t i = std::int64_t(x);
    return i - (x < double(i));
}

// Between the eight samples from `c` on.
template <class Number>
Number trilinearOf(const float* c, BrickShape shape, Number x, Number y, Number z) {
    const std::size_t sy = std::size_t(shape.edgeSamples()), sz = sy * sy;
    auto mix = [](Number from, Number to, Number t) { return from + (to - from) * t; };
    auto row = [&](std::size_t at) { return mix(Number(c[at]), Number(c[at + 1]), x); };
    return mix(mix(row(0), row(sy), y), mix(row(sz), row(sz + sy), y), z);
}

}  // namespace

ChannelReader::ChannelReader(const PagedChannel& channel, FieldFilter filter, ReadAccuracy accuracy,
                             const RayContext& context)
    : channel_(&channel),
      context_(&context),
      filter_(filter),
      accuracy_(accuracy),
      edge_cells_(channel.shape().edge_cells) {
    for (const NodeKey& root : channel.roots()) top_level_ = std::max(top_level_, int(root.level));
}

void ChannelReader::want(const WantedPage& page, std::uint32_t bytes) {
    if (context_->wants) context_->wants->add(page, bytes, 1, context_->tile);
}

void ChannelReader::takeNode(const NodeRef& ref, const NodeKey& key, Entry& out) const {
    const TreeBlock& block = *channel_->block(ref.block);
    const NodeRecord& record = block.record(ref.node);
    out.low = nodeLow(key, channel_->shape());
    out.edge = cellEdge(key.level);
    out.per_cell = 1 / out.edge;
    out.samples = nullptr;
    out.speck = speckFactor(*channel_, key);
    out.square = squareOfNode(*channel_, key, record) * out.edge;
    out.grid = block.errorGrid(ref.node);
    out.bound = double(record.bound);
    out.region = 0;
    constexpr float kTiny = 1e-30f;
    out.careful = std::max(std::abs(record.value_min), std::abs(record.value_max)) < kTiny ||
                  (record.value_min < 0 && record.value_max > 0);
    if (record.hasBrick()) return;
    out.region = nodeEdge(key, channel_->shape());
    const std::span<const ValueBits> value = block.constant(ref.node);
    const SampleType type = levelType(channel_->type(), key.level);
    for (std::size_t c = 0; c < value.size() && c < 3; ++c) out.constant[c] = toFloat(type, value[c]);
}

// From the root down to the node that stands for `key`, or that has no child there.
void ChannelReader::find(const NodeKey& key, const glm::dvec3& position, Entry& out) {
    out.key = key;
    out.missing = false;
    out.samples = nullptr;
    out.square = 0;
    out.grid = nullptr;
    out.low = nodeLow(key, channel_->shape());
    out.edge = cellEdge(key.level);
    out.per_cell = 1 / out.edge;
    const std::span<const ValueBits> background = channel_->backgroundBits();
    for (std::size_t c = 0; c < background.size() && c < 3; ++c)
        out.constant[c] = toFloat(channel_->type(), background[c]);

    NodeRef ref;
    NodeKey at{-1, 0, 0, 0};
    for (std::size_t i = 0; i < channel_->roots().size(); ++i) {
        const NodeKey& root = channel_->roots()[i];
        const glm::dvec3 low = nodeLow(root, channel_->shape());
        const double edge = nodeEdge(root, channel_->shape());
        if (position.x >= low.x && position.x < low.x + edge && position.y >= low.y &&
            position.y < low.y + edge && position.z >= low.z && position.z < low.z + edge) {
            at = root;
            ref = {0, std::uint32_t(i)};
        }
    }
    out.region = nodeEdge(key, channel_->shape());
    if (at.level < 0) return;  // outside all roots: background

    // The finest resident brick on the way down stands in for one that is missing.
    Entry stand_in;
    bool has_stand_in = false;
    std::optional<std::pair<PageAddress, std::uint32_t>> coarsest;  // that is missing, and its bytes
    auto missing = [&](bool failed) {
        if (has_stand_in) {
            const NodeKey asked = out.key;
            out = stand_in;
            out.key = asked;
        }
        out.missing = !failed;
    };
    for (;;) {
        const TreeBlock* block = channel_->block(ref.block);
        if (!block) {
            const WantedPage page{true, {channel_->index(), ref.block, 0, false}};
            const bool failed = context_->failed && context_->failed->contains(page);
            if (!failed) want(page, std::uint32_t(channel_->blockBytes(ref.block)));
            return missing(failed);
        }
        if (ref.node >= block->nodeCount()) return;  // a block that lies about its roots: nothing there
        const NodeRecord& record = block->record(ref.node);
        const PageAddress page{channel_->index(), ref.block, ref.node, false};
        const bool stays =
            at.level <= key.level || at.level == 0 || block->isLeaf(ref.node) ||
            squareOfNode(*channel_, at, record) * cellEdge(at.level) <= accuracy_.square_budget;
        if (stays || record.hasBrick()) {
            const float* samples = record.hasBrick() ? context_->cache->find(page) : nullptr;
            if (samples || (stays && !record.hasBrick())) {
                Entry& taken = stays ? out : stand_in;
                takeNode(ref, at, taken);
                taken.samples = samples;
                has_stand_in |= !stays;
                if (stays) return;
            }
            if (!stays && !samples && accuracy_.coarse_first && !coarsest &&
                !(context_->failed && context_->failed->contains(WantedPage{false, page})))
                coarsest.emplace(page, record.payload_bytes);
            if (stays) {
                const bool failed = context_->failed && context_->failed->contains(WantedPage{false, page});
                if (!failed && coarsest)
                    want({false, coarsest->first}, coarsest->second);
                else if (!failed)
                    want({false, page}, record.payload_bytes);
                if (!has_stand_in) {
                    // Some value that the node may have.
                    takeNode(ref, at, out);
                    out.region = 0;
                    for (float& value : out.constant) value = 0.5f * (record.value_min + record.value_max);
                }
                return missing(failed);
            }
        }
        // On to the child that holds the position.
        const glm::dvec3 middle = nodeLow(at, channel_->shape()) + 0.5 * nodeEdge(at, channel_->shape());
        const int octant =
            int(position.x >= middle.x) | int(position.y >= middle.y) << 1 | int(position.z >= middle.z) << 2;
        const unsigned valid = block->validMask(ref.node);
        if (!(valid >> octant & 1)) {  // background
            out.region = std::max(out.region, 0.5 * nodeEdge(at, channel_->shape()));
            return;
        }
        const ChildrenRef first = block->children(ref.node);
        ref = {first.block, first.first + std::uint32_t(__builtin_popcount(valid & ((1u << octant) - 1)))};
        at = at.child(octant);
    }
}

const ChannelReader::Entry& ChannelReader::entryAt(int level, const glm::dvec3& position) {
    const double per_brick = 1 / (double(edge_cells_) * cellEdge(level));
    const NodeKey key{level, std::int32_t(floorOf(position.x * per_brick)),
                      std::int32_t(floorOf(position.y * per_brick)),
                      std::int32_t(floorOf(position.z * per_brick))};
    Entry& entry = entries_[key.octant() | (level & 1) << 3];
    if (!(entry.key == key)) find(key, position, entry);
    missed_ |= entry.missing;
    return entry;
}

int ChannelReader::clampLevel(double lod) const { return std::clamp(int(lod), 0, top_level_); }

double ChannelReader::trilinear(const Entry& entry, const glm::dvec3& position, int component) const {
    if (!entry.samples) return double(entry.constant[component]);
    const BrickShape shape = channel_->shape();
    const float* samples = entry.samples + std::size_t(component) * shape.samples();
    const int last = shape.edge_cells - 1;
    const double x = (position.x - entry.low.x) * entry.per_cell,
                 y = (position.y - entry.low.y) * entry.per_cell,
                 z = (position.z - entry.low.z) * entry.per_cell;
    const int i = std::clamp(int(x), 0, last), j = std::clamp(int(y), 0, last),
              k = std::clamp(int(z), 0, last);
    if (entry.careful)
        return trilinearOf<double>(samples + shape.sampleAt(i, j, k), shape, x - i, y - j, z - k);
    // Samples are floats, and so is what lies between them.
    return double(trilinearOf<float>(samples + shape.sampleAt(i, j, k), shape, float(x - i), float(y - j),
                                     float(z - k)));
}

// The kernels over 4^3 samples of the level's lattice, brick by brick where they lie in several.
double ChannelReader::filtered(int level, const glm::dvec3& position, int component) {
    const double cell = cellEdge(level);
    const BrickShape shape = channel_->shape();
    std::int64_t first[3];  // sample, in cells of the level
    int split[3];           // samples of the first brick on each axis
    double weights[3][4];
    for (int a = 0; a < 3; ++a) {
        const double p = position[a] / cell;
        const std::int64_t base = floorOf(p);
        filterWeights(filter_, p - double(base), weights[a]);
        first[a] = base - 1;
        const std::int64_t in_brick = first[a] & (edge_cells_ - 1);  // edges are powers of two
        split[a] = int(std::min<std::int64_t>(4, edge_cells_ - in_brick));
    }
    double sum = 0;
    for (int part = 0; part < 8; ++part) {
        int begin[3], end[3];
        bool empty = false;
        for (int a = 0; a < 3; ++a) {
            begin[a] = part >> a & 1 ? split[a] : 0;
            end[a] = part >> a & 1 ? 4 : split[a];
            empty = empty || begin[a] >= end[a];
        }
        if (empty) continue;
        const glm::dvec3 corner(double(first[0] + begin[0]) * cell, double(first[1] + begin[1]) * cell,
                                double(first[2] + begin[2]) * cell);
        const Entry& entry = entryAt(level, corner);
        if (entry.samples && entry.edge == cell) {
            const float* samples =
                entry.samples + std::size_t(component) * shape.samples() +
                shape.sampleAt(int((corner.x - entry.low.x) / cell), int((corner.y - entry.low.y) / cell),
                               int((corner.z - entry.low.z) / cell));
            for (int k = begin[2]; k < end[2]; ++k)
                for (int j = begin[1]; j < end[1]; ++j) {
                    const float* row = samples + shape.sampleAt(0, j - begin[1], k - begin[2]);
                    double line = 0;
                    for (int i = begin[0]; i < end[0]; ++i) line += weights[0][i] * double(row[i - begin[0]]);
                    sum += weights[2][k] * weights[1][j] * line;
                }
            continue;
        }
        // What stands for the brick is coarser, or one value.
        for (int k = begin[2]; k < end[2]; ++k)
            for (int j = begin[1]; j < end[1]; ++j)
                for (int i = begin[0]; i < end[0]; ++i) {
                    const glm::dvec3 sample =
                        corner + cell * glm::dvec3(i - begin[0], j - begin[1], k - begin[2]);
                    sum +=
                        weights[0][i] * weights[1][j] * weights[2][k] * trilinear(entry, sample, component);
                }
    }
    return sum;
}

double ChannelReader::onLevel(int level, const glm::dvec3& position, int component) {
    if (filter_ == FieldFilter::kNearest) {
        const double cell = cellEdge(level);
        const glm::dvec3 sample(double(floorOf(position.x / cell + 0.5)) * cell,
                                double(floorOf(position.y / cell + 0.5)) * cell,
                                double(floorOf(position.z / cell + 0.5)) * cell);
        return trilinear(entryAt(level, sample), sample, component);
    }
    if (filter_ == FieldFilter::kTrilinear) return trilinear(entryAt(level, position), position, component);
    return filtered(level, position, component);
}

double ChannelReader::blended(const glm::dvec3& position, double lod, int component) {
    const int level = clampLevel(lod);
    const double fine = onLevel(level, position, component);
    const double share = level < top_level_ ? std::min(lod - level, 1.0) : 0;
    if (!(share > 0)) return fine;
    return fine + share * (onLevel(level + 1, position, component) - fine);
}

double ChannelReader::value(const glm::dvec3& position, double lod) { return blended(position, lod, 0); }

glm::dvec3 ChannelReader::vector(const glm::dvec3& position, double lod) {
    glm::dvec3 v;
    for (int c = 0; c < 3; ++c) {
        glm::dvec3 at = position;
        if (channel_->staggered()) at[c] += 0.5;
        v[c] = blended(at, lod, c);
    }
    return v;
}

glm::dvec3 ChannelReader::gradient(const glm::dvec3& position, double lod) {
    const double reach = cellEdge(clampLevel(lod));
    glm::dvec3 slope;
    for (int a = 0; a < 3; ++a) {
        glm::dvec3 before = position, behind = position;
        before[a] -= reach;
        behind[a] += reach;
        slope[a] = (blended(behind, lod, 0) - blended(before, lod, 0)) / (2 * reach);
    }
    return slope;
}

double ChannelReader::cellEdgeAt(const glm::dvec3& position, double lod) {
    const int level = clampLevel(lod);
    const double cell = cellEdge(level);
    const Entry& entry = entryAt(level, position);
    if (filter_ == FieldFilter::kTrilinear) {
        if (entry.region == 0) return entry.edge;
        // One value here; but what the coarser level has may be spread over it.
        const double region = entry.region;
        if (!(lod > level) || level >= top_level_) return region;
        const Entry& coarser = entryAt(level + 1, position);
        return std::min(region, coarser.region > 0 ? coarser.region : coarser.edge);
    }
    if (entry.edge == cell || filter_ == FieldFilter::kNearest) return cell;
    // A kernel reaches two samples of the level over the border of a coarser node.
    for (int a = 0; a < 3; ++a) {
        const double place = (position[a] - entry.low[a]) * entry.per_cell;
        if (place < 1 || place > edge_cells_ - 1) return cell;
    }
    return entry.edge;
}

double ChannelReader::squareIn(const Entry& entry, const glm::dvec3& position) const {
    if (!entry.grid) return entry.square;
    const double boxes = entry.per_cell * kErrorGridEdge / edge_cells_;
    auto box = [&](int axis) {
        return std::size_t(
            std::clamp(int((position[axis] - entry.low[axis]) * boxes), 0, kErrorGridEdge - 1));
    };
    const std::size_t at = box(0) + kErrorGridEdge * (box(1) + kErrorGridEdge * box(2));
    return effectiveSquareOfCodes(entry.grid->rms[at], entry.grid->bound[at]) * entry.bound * entry.bound *
           entry.speck * entry.edge;
}

double ChannelReader::spreadAt(const glm::dvec3& position, double lod) {
    const Entry& entry = entryAt(clampLevel(lod), position);
    if (!entry.samples) return 0;
    const BrickShape shape = channel_->shape();
    int cell[3];
    for (int a = 0; a < 3; ++a)
        cell[a] = std::clamp(int((position[a] - entry.low[a]) * entry.per_cell), 0, shape.edge_cells - 1);
    float least = std::numeric_limits<float>::infinity(), greatest = -least;
    for (int corner = 0; corner < 8; ++corner) {
        const float value = entry.samples[shape.sampleAt(cell[0] + (corner & 1), cell[1] + (corner >> 1 & 1),
                                                         cell[2] + (corner >> 2))];
        least = std::min(least, value);
        greatest = std::max(greatest, value);
    }
    return double(greatest) - double(least);
}

double ChannelReader::squareAt(const glm::dvec3& position, double lod) {
    const int level = clampLevel(lod);
    const double fine = squareIn(entryAt(level, position), position);
    const double share = level < top_level_ ? std::min(lod - level, 1.0) : 0;
    return share > 0 ? fine + share * (squareIn(entryAt(level + 1, position), position) - fine) : fine;
}

}  // namespace brickyard

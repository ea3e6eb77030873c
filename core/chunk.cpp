#include "core/chunk.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <cstring>

#include "core/brick_codec.h"
#include "core/brick_statistics.h"
#include "core/brick_store.h"
#include "core/float_rounding.h"
#include "core/level_reduction.h"
#include "core/sample_conversion.h"

namespace brickyard {

namespace {

// Coarse samples are kept to this part of the error their level makes anyway: it costs 3 to 4 % of a lossless
// cache, against 18 to 33 % for storing them as floats (DESIGN.md, section 13).
constexpr double kCoarseQuantisation = 0.1;
// Under a conversion error E, coarse samples need not be finer than this part of it.
constexpr double kCoarseShareOfError = 0.25;
// A draft of a level-0 brick is kept to this part of its parent's RMS error: a hundredth of its variance at
// most.
constexpr double kDraftShareOfParent = 0.1;

template <class Visit>
void visitType(SampleType type, Visit&& visit) {
    switch (type) {
        case SampleType::kFloat32: return visit(static_cast<const float*>(nullptr));
        case SampleType::kFloat64: return visit(static_cast<const double*>(nullptr));
        case SampleType::kInt32: return visit(static_cast<const std::int32_t*>(nullptr));
        case SampleType::kInt64: return visit(static_cast<const std::int64_t*>(nullptr));
        case SampleType::kBool: return visit(static_cast<const std::uint8_t*>(nullptr));
    }
}

// Slots of the 2^log2 cube, x fastest.
std::array<int, 3> placeOf(std::size_t slot, int log2) {
    const std::size_t mask = (std::size_t(1) << log2) - 1;
    return {int(slot & mask), int(slot >> log2 & mask), int(slot >> 2 * log2)};
}

void includeBox(NodeRecord& parent, const NodeRecord& child, int octant, int n) {
    if (child.box_end[0] <= child.box_begin[0]) return;
    const bool empty = parent.box_end[0] <= parent.box_begin[0];
    for (std::size_t a = 0; a < 3; ++a) {
        const int offset = (octant >> a & 1) ? n : 0;
        const int begin = (offset + child.box_begin[a]) / 2, end = (offset + child.box_end[a] + 1) / 2;
        parent.box_begin[a] = std::uint8_t(empty ? begin : std::min<int>(parent.box_begin[a], begin));
        parent.box_end[a] = std::uint8_t(empty ? end : std::max<int>(parent.box_end[a], end));
    }
}

}  // namespace

void ActiveSummary::include(const ActiveSummary& other) {
    if (other.voxels == 0) return;
    if (voxels == 0) box = other.box;
    voxels += other.voxels;
    for (std::size_t a = 0; a < 3; ++a) {
        box.begin[a] = std::min(box.begin[a], other.box.begin[a]);
        box.end[a] = std::max(box.end[a], other.box.end[a]);
    }
    min = any ? std::min(min, other.min) : other.min;
    max = any ? std::max(max, other.max) : other.max;
    any = true;
}

void ActiveSummary::includeUniform(const IndexBox& owned, double min_value, double max_value) {
    ActiveSummary region;
    region.voxels =
        std::uint64_t(owned.extent(0)) * std::uint64_t(owned.extent(1)) * std::uint64_t(owned.extent(2));
    region.box = owned;
    region.any = true;
    region.min = min_value;
    region.max = max_value;
    include(region);
}

Chunk::Chunk(const ChunkSettings& settings, const NodeKey& root, bool for_next_tier)
    : settings_(settings),
      root_(root),
      steps_(chunkSteps(settings.shape)),
      for_next_tier_(for_next_tier),
      levels_(std::size_t(steps_) + 1),
      nodes_(std::size_t(steps_) + 1),
      decoded_(std::size_t(steps_) + 1) {
    for (int d = 0; d <= steps_; ++d) {
        Level& level = levels_[std::size_t(d)];
        level.halo = (1 << (steps_ - d)) - 1;
        level.edge = std::size_t((settings_.shape.edge_cells << (steps_ - d)) + 1 + 2 * level.halo);
        nodes_[std::size_t(d)].resize(std::size_t(1) << 3 * (steps_ - d));
        decoded_[std::size_t(d)].resize(d > 0 ? nodes_[std::size_t(d)].size() : 0);
    }
}

Chunk::~Chunk() { releaseSamples(); }

void Chunk::releaseSamples() {
    settings_.buffers->give(std::move(block_));
    for (Level& level : levels_) {
        for (std::vector<double>& samples : level.samples) settings_.buffers->give(std::move(samples));
        level.samples.clear();
    }
}

NodeKey Chunk::keyOf(int depth, std::size_t slot) const {
    const int down = steps_ - depth;
    const std::array<int, 3> at = placeOf(slot, down);
    return {root_.level - down, (root_.x << down) + at[0], (root_.y << down) + at[1],
            (root_.z << down) + at[2]};
}

// Calls visit with the samples of one component of a node of the base, as a SampleCube of their type,
// followed by the rest of the base's array. REQUIRES: isRead(slot).
template <class Visit>
void Chunk::visitBase(std::size_t component, std::size_t slot, Visit&& visit) const {
    const std::array<std::size_t, 3> at = baseAt(slot);
    if (!atLevel0())
        return visit(
            wholeCube(levels_[0].samples[component].data(), levels_[0].edge).from(at[0], at[1], at[2]));
    visitType(settings_.info().type, [&]<class T>(const T*) {
        // A block of samples is allocated whole, so its values are aligned for their type.
        const auto [x, y, z] = part_.extent;
        const SampleCube<T> whole{reinterpret_cast<const T*>(block_.values.data()) + component * x * y * z, x,
                                  x * y};
        visit(whole.from(at[0], at[1], at[2]));
    });
}

// Where the samples of a node of the base begin in the base's array.
std::array<std::size_t, 3> Chunk::baseAt(std::size_t slot) const {
    std::array<int, 3> place = placeOf(slot, steps_);
    std::array<std::size_t, 3> at;
    for (std::size_t a = 0; a < 3; ++a)
        at[a] = std::size_t(levels_[0].halo + (place[a] - 2 * part_.begin[a]) * settings_.shape.edge_cells);
    return at;
}

bool Chunk::isRead(std::size_t slot) const {
    const std::array<int, 3> place = placeOf(slot, steps_);
    for (std::size_t a = 0; a < 3; ++a)
        if (place[a] < 2 * part_.begin[a] || place[a] >= 2 * part_.end[a]) return false;
    return true;
}

SampleCube<std::uint8_t> Chunk::activeOf(std::size_t slot) const {
    const std::array<std::size_t, 3> at = baseAt(slot);
    const SampleCube<std::uint8_t> whole{block_.active.data(), part_.extent[0],
                                         part_.extent[0] * part_.extent[1]};
    return whole.from(at[0], at[1], at[2]);
}

// Samples (N + 1)^3 of a node above the base, before they were encoded.
SampleCube<double> Chunk::exact(int depth, std::size_t slot, std::size_t component) const {
    const Level& level = levels_[std::size_t(depth)];
    const std::array<int, 3> at = placeOf(slot, steps_ - depth);
    const auto from = [&](int axis) {
        return std::size_t(level.halo + at[std::size_t(axis)] * settings_.shape.edge_cells);
    };
    return wholeCube(level.samples[component].data(), level.edge).from(from(0), from(1), from(2));
}

double Chunk::valueOf(const ChunkNode& node, std::size_t component) const {
    return node.kind == NodeKind::kUniform ? toDouble(settings_.info().type, node.constant[component])
                                           : settings_.background[component];
}

// Finds the part that has to be read, false where there is none: thin or small fields fill little of their
// chunks.
bool Chunk::findPart() {
    const auto isBackground = [&](const IndexBox& box) {
        const auto uniform = settings_.field->uniformOver(box);
        return uniform && !uniform->active && uniform->value == settings_.info().background;
    };
    const int nodes = 1 << (steps_ - 1);
    part_.begin = {nodes, nodes, nodes};
    part_.end = {0, 0, 0};
    for (std::size_t slot = 0; slot < nodes_[1].size(); ++slot) {
        if (isBackground(closedRegion(keyOf(1, slot), settings_.shape))) continue;
        const std::array<int, 3> at = placeOf(slot, steps_ - 1);
        for (std::size_t a = 0; a < 3; ++a) {
            part_.begin[a] = std::min(part_.begin[a], at[a]);
            part_.end[a] = std::max(part_.end[a], at[a] + 1);
        }
    }
    if (part_.end[0] == 0) return false;
    // Around the chunk there may be more than background: then the part reaches that side.
    const IndexBox chunk = closedRegion(root_, settings_.shape);
    const int halo = levels_[0].halo;
    for (std::size_t a = 0; a < 3; ++a)
        for (const bool high : {false, true}) {
            if (high ? part_.end[a] == nodes : part_.begin[a] == 0) continue;
            IndexBox slab = chunk;
            for (std::size_t b = 0; b < 3; ++b) {
                slab.begin[b] -= halo;
                slab.end[b] += halo;
            }
            (high ? slab.begin[a] : slab.end[a]) = high ? chunk.end[a] : chunk.begin[a];
            if (!isBackground(slab)) (high ? part_.end[a] : part_.begin[a]) = high ? nodes : 0;
        }
    return true;
}

Result<void> Chunk::readField() {
    if (!findPart()) return {};
    const std::int64_t node = 2 * std::int64_t(settings_.shape.edge_cells);
    const IndexBox chunk = closedRegion(root_, settings_.shape);
    IndexBox box;
    for (std::size_t a = 0; a < 3; ++a) {
        box.begin[a] = chunk.begin[a] + part_.begin[a] * node - levels_[0].halo;
        box.end[a] = chunk.begin[a] + part_.end[a] * node + 1 + levels_[0].halo;
        part_.extent[a] = std::size_t(box.end[a] - box.begin[a]);
    }
    block_ = settings_.buffers->takeBlock();
    if (Result<void> read = settings_.field->read(box, block_); !read) return read;
    describeBricks();
    classify();
    reduce();
    return {};
}

// Kinds, ranges, boxes and states of the level-0 bricks.
void Chunk::describeBricks() {
    const BrickShape shape = settings_.shape;
    for (std::size_t slot = 0; slot < nodes_[0].size(); ++slot) {
        if (!isRead(slot)) continue;
        ChunkNode& node = nodes_[0][slot];
        const SampleCube<std::uint8_t> active = activeOf(slot);
        const ActiveVoxels voxels = countActive(active, shape);
        node.states_uniform = voxels.count == 0 || voxels.count == shape.cells();
        node.states_active = voxels.count > 0;
        bool uniform = oneValue(active, shape);
        for (std::size_t c = 0; c < settings_.components() && uniform; ++c)
            visitBase(c, slot, [&]<class T>(SampleCube<T> samples) {
                uniform = oneValue(samples, shape);
                std::memcpy(&node.constant.emplace_back(0), samples.first, sizeof(T));
            });
        if (uniform && !node.states_active && node.constant == settings_.info().background) {
            node.constant.clear();
            continue;
        }

        ActiveSummary found;
        const auto include = [&](double min, double max) {
            found.min = found.any ? std::min(found.min, min) : min;
            found.max = found.any ? std::max(found.max, max) : max;
            found.any = true;
        };
        node.kind = uniform ? NodeKind::kUniform : NodeKind::kSampled;
        node.record.active = uniform && node.states_active;
        if (uniform) {
            describeUniform(node);
            for (std::size_t c = 0; c < settings_.components(); ++c)
                include(valueOf(node, c), valueOf(node, c));
        } else {
            node.constant.clear();
            for (std::size_t c = 0; c < settings_.components(); ++c)
                visitBase(c, slot, [&](auto samples) {
                    const OwnedRange owned =
                        describeSamples(samples, shape, settings_.background[c], c == 0, node.record);
                    if (voxels.count == shape.cells())
                        include(owned.min, owned.max);
                    else if (voxels.count > 0)
                        includeActive(samples, active, shape, found.any, found.min, found.max);
                });
        }
        if (voxels.count == 0) continue;
        found.voxels = voxels.count;
        const IndexBox region = closedRegion(keyOf(0, slot), shape);
        for (std::size_t a = 0; a < 3; ++a) {
            found.box.begin[a] = region.begin[a] + voxels.begin[a];
            found.box.end[a] = region.begin[a] + voxels.end[a];
        }
        active_.include(found);
    }
}

// Range and box of a node of one value.
void Chunk::describeUniform(ChunkNode& node) const {
    for (std::size_t c = 0; c < settings_.components(); ++c) {
        const double value = valueOf(node, c);
        NodeRecord& record = node.record;
        record.value_min = c == 0 ? roundDown(value) : std::min(record.value_min, roundDown(value));
        record.value_max = c == 0 ? roundUp(value) : std::max(record.value_max, roundUp(value));
        if (value != settings_.background[c]) record.box_end.fill(std::uint8_t(settings_.shape.edge_cells));
    }
}

Result<void> Chunk::readBase(const BaseLevel& base) {
    const int reach = 1 << steps_;
    const NodeKey first = keyOf(0, 0);
    Level& level = levels_[0];
    part_.end = {reach / 2, reach / 2, reach / 2};
    for (std::size_t c = 0; c < settings_.components(); ++c) {
        level.samples.push_back(settings_.buffers->takeDoubles(level.edge * level.edge * level.edge));
        std::fill(level.samples[c].begin(), level.samples[c].end(), settings_.background[c]);
    }
    base_residual_.resize(nodes_[0].size());

    for (std::size_t slot = 0; slot < nodes_[0].size(); ++slot) {
        const NodeKey key = keyOf(0, slot);
        ChunkNode& node = nodes_[0][slot];
        if (const ChunkNode* found = base.find(key)) {
            node.kind = found->kind;
            node.states_uniform = found->states_uniform;
            node.states_active = found->states_active;
            node.pruned = found->pruned;
            node.valid_mask = found->valid_mask;
            node.record = found->record;
            node.constant = found->constant;
        } else if (const UniformRegion* region = base.uniformAt(key)) {
            node.kind = NodeKind::kUniform;
            node.states_active = node.record.active = region->active;
            node.constant = region->value;
        }
        if (node.kind != NodeKind::kSampled) continue;
        auto residual = base.residual(key);
        if (!residual) return tl::unexpected(residual.error());
        base_residual_[slot] = std::move(*residual);
    }
    // A larger region of one value becomes a leaf of its own level.
    for (int d = 1; d <= steps_; ++d)
        for (std::size_t slot = 0; slot < nodes_[std::size_t(d)].size(); ++slot)
            if (const UniformRegion* region = base.uniformAt(keyOf(d, slot))) {
                ChunkNode& node = nodes_[std::size_t(d)][slot];
                node.kind = NodeKind::kUniform;
                node.states_active = node.record.active = region->active;
                node.constant = region->value;
            }

    // Nodes with samples come last: on a shared face they win over their neighbour's one value.
    for (const bool with_samples : {false, true})
        for (int z = -1; z <= reach; ++z)
            for (int y = -1; y <= reach; ++y)
                for (int x = -1; x <= reach; ++x) {
                    const NodeKey key{first.level, first.x + x, first.y + y, first.z + z};
                    const ChunkNode* node = base.find(key);
                    if ((node != nullptr && node->kind == NodeKind::kSampled) != with_samples) continue;
                    if (Result<void> copied = copyBase(base, key); !copied) return copied;
                }
    classify();
    for (int d = 0; d <= steps_; ++d)
        for (ChunkNode& node : nodes_[std::size_t(d)])
            if (node.kind == NodeKind::kUniform) describeUniform(node);
    reduce();
    return {};
}

// What a node of the base has, its one value or its samples, into the part of the base's array that it
// reaches.
Result<void> Chunk::copyBase(const BaseLevel& base, const NodeKey& key) {
    const ChunkNode* const node = base.find(key);
    const UniformRegion* const region = node ? nullptr : base.uniformAt(key);
    if (!node && !region) return {};
    Level& level = levels_[0];
    const int n = settings_.shape.edge_cells, s = n + 1;
    const NodeKey first = keyOf(0, 0);
    const std::array<int, 3> at{(key.x - first.x) * n + level.halo, (key.y - first.y) * n + level.halo,
                                (key.z - first.z) * n + level.halo};
    std::vector<double> samples;
    if (node && node->kind == NodeKind::kSampled) {
        auto read = base.samples(key);
        if (!read) return tl::unexpected(read.error());
        samples = std::move(*read);
    }
    const int edge = int(level.edge);
    for (std::size_t c = 0; c < settings_.components(); ++c) {
        const double value =
            samples.empty() ? toDouble(settings_.info().type, node ? node->constant[c] : region->value[c])
                            : 0;
        for (int k = std::max(0, -at[2]); k < std::min(s, edge - at[2]); ++k)
            for (int j = std::max(0, -at[1]); j < std::min(s, edge - at[1]); ++j) {
                const int begin = std::max(0, -at[0]), end = std::min(s, edge - at[0]);
                if (begin >= end) continue;
                double* const out =
                    level.samples[c].data() +
                    (std::size_t(at[2] + k) * level.edge + std::size_t(at[1] + j)) * level.edge +
                    std::size_t(at[0] + begin);
                if (samples.empty())
                    std::fill_n(out, end - begin, value);
                else
                    std::copy_n(samples.data() + c * settings_.shape.samples() +
                                    settings_.shape.sampleAt(begin, j, k),
                                end - begin, out);
            }
    }
    return {};
}

// Kinds above the base from those below; a region that became one value is one leaf.
void Chunk::classify() {
    for (int d = 1; d <= steps_; ++d)
        for (std::size_t slot = 0; slot < nodes_[std::size_t(d)].size(); ++slot) {
            ChunkNode& node = nodes_[std::size_t(d)][slot];
            if (node.kind == NodeKind::kUniform) continue;
            const std::array<int, 3> at = placeOf(slot, steps_ - d);
            const auto child = [&](int octant) -> const ChunkNode& {
                return this->node(d - 1, 2 * at[0] + (octant & 1), 2 * at[1] + (octant >> 1 & 1),
                                  2 * at[2] + (octant >> 2));
            };
            bool same = true;
            for (int octant = 0; octant < 8; ++octant) {
                const ChunkNode& below = child(octant);
                if (below.kind != NodeKind::kAbsent) node.valid_mask |= std::uint8_t(1 << octant);
                same = same && below.kind == NodeKind::kUniform && below.constant == child(0).constant &&
                       below.states_active == child(0).states_active;
            }
            if (node.valid_mask == 0) continue;
            node.kind = NodeKind::kSampled;
            if (!same) {
                coarse_.emplace_back(d, slot);
                continue;
            }
            node.kind = NodeKind::kUniform;
            node.valid_mask = 0;
            node.constant = child(0).constant;
            node.states_active = node.record.active = child(0).states_active;
            node.record.value_min = child(0).record.value_min;
            node.record.value_max = child(0).record.value_max;
            node.record.box_end = child(0).record.box_end;
        }
}

// The levels above the base, exactly, with as much around the chunk as the next one needs.
void Chunk::reduce() {
    if (coarse_.empty()) return;
    for (int d = 1; d <= steps_; ++d) {
        Level& level = levels_[std::size_t(d)];
        const Level& below = levels_[std::size_t(d) - 1];
        for (std::size_t c = 0; c < settings_.components(); ++c) {
            level.samples.push_back(settings_.buffers->takeDoubles(level.edge * level.edge * level.edge));
            double* const out = level.samples[c].data();
            const std::size_t plane = level.edge * level.edge;
            if (d > 1 || !atLevel0()) {
                reduceLevel(wholeCube<double>(below.samples[c].data(), below.edge),
                            {level.edge, level.edge, level.edge}, {out, level.edge, plane});
                continue;
            }
            // Around the part that was read there is nothing but background, whose average is itself.
            std::array<std::size_t, 3> extent, at;
            for (std::size_t a = 0; a < 3; ++a) {
                extent[a] = part_.extent[a] / 2;
                at[a] = std::size_t(part_.begin[a] * settings_.shape.edge_cells);
            }
            if (extent != std::array<std::size_t, 3>{level.edge, level.edge, level.edge})
                std::fill(level.samples[c].begin(), level.samples[c].end(), settings_.background[c]);
            visitType(settings_.info().type, [&]<class T>(const T*) {
                const auto [x, y, z] = part_.extent;
                reduceLevel(
                    SampleCube<T>{reinterpret_cast<const T*>(block_.values.data()) + c * x * y * z, x, x * y},
                    extent, {out + at[2] * plane + at[1] * level.edge + at[0], level.edge, plane});
            });
        }
    }
    shares_.assign(nodes_[1].size(),
                   std::vector<std::vector<NodeDeviation>>(
                       std::size_t(steps_ - 1), std::vector<NodeDeviation>(settings_.components())));
    if (for_next_tier_) residual_.resize(settings_.shape.cells() * settings_.components());
}

void Chunk::encodeCoarse(std::size_t index) {
    const auto [depth, slot] = coarse_[index];
    ChunkNode& node = nodes_[std::size_t(depth)][slot];
    const BrickShape shape = settings_.shape;
    const std::size_t s = std::size_t(shape.edgeSamples()), volume = shape.samples();
    const std::array<int, 3> at = placeOf(slot, steps_ - depth);

    std::vector<double> samples(volume * settings_.components());
    double step_rms = 0;
    for (std::size_t c = 0; c < settings_.components(); ++c) {
        const SampleCube<double> coarse = exact(depth, slot, c);
        for (std::size_t k = 0; k < s; ++k)
            for (std::size_t j = 0; j < s; ++j)
                std::copy_n(coarse.rowAt(j, k), s, samples.data() + c * volume + (k * s + j) * s);
        const auto measureStep = [&](auto fine) {
            step_rms = std::max(step_rms, reductionRms(fine, coarse, shape.edge_cells, settings_.scale));
        };
        if (depth == 1)
            visitBase(c, this->slot(0, 2 * at[0], 2 * at[1], 2 * at[2]), measureStep);
        else
            measureStep(exact(depth - 1, this->slot(depth - 1, 2 * at[0], 2 * at[1], 2 * at[2]), c));
    }

    const SampleType stored = levelType(settings_.info().type, root_.level - steps_ + depth);
    const std::vector<std::byte> values = doublesToSamples(stored, samples);
    std::vector<ValueBits> background;
    for (double value : settings_.background) background.push_back(fromDouble(stored, value));
    BrickToEncode brick;
    brick.shape = shape;
    brick.type = stored;
    brick.components = int(settings_.components());
    brick.values = values;
    brick.background = background;
    brick.max_error = std::max(kCoarseQuantisation * step_rms, kCoarseShareOfError * settings_.max_error);
    if (!std::isfinite(brick.max_error)) brick.max_error = 0;
    node.payload = encodeBrick(brick).payload;

    // Bounds are measured on what a reader will decode, not on what was meant.
    const Result<DecodedBrick> decoded =
        decodeBrick(node.payload, shape, stored, brick.components, background);
    assert(decoded && "the codec reads what it wrote");
    std::vector<double>& kept = decoded_[std::size_t(depth)][slot];
    samplesToDouble(stored, decoded->values, kept);
    for (std::size_t c = 0; c < settings_.components(); ++c)
        describeSamples(wholeCube<double>(kept.data() + c * volume, s), shape, settings_.background[c],
                        c == 0, node.record);
}

// The slot at depth `above` that holds `slot` of `depth`.
std::size_t Chunk::ancestorOf(std::size_t slot, int depth, int above) const {
    const std::array<int, 3> at = placeOf(slot, steps_ - depth);
    const int up = above - depth;
    return this->slot(above, at[0] >> up, at[1] >> up, at[2] >> up);
}

void Chunk::measure(std::size_t index) {
    ChunkNode& node = nodes_[1][index];
    if (node.kind != NodeKind::kSampled) return measureUniform(index);
    std::vector<NodeDeviation> own(settings_.components());
    const std::array<int, 3> at = placeOf(index, steps_ - 1);
    std::array<std::size_t, 8> children;
    for (int octant = 0; octant < 8; ++octant) {
        children[std::size_t(octant)] =
            slot(0, 2 * at[0] + (octant & 1), 2 * at[1] + (octant >> 1 & 1), 2 * at[2] + (octant >> 2));
        measureChild(children[std::size_t(octant)], index, own);
    }
    settleDeviation(1, index, own);
    if (!atLevel0()) return;
    for (const std::size_t child : children)
        if (nodes_[0][child].kind == NodeKind::kSampled) encodeFinest(child, double(node.record.rms));
}

// One node of the base against all nodes above it in the chunk.
void Chunk::measureChild(std::size_t child, std::size_t parent, std::vector<NodeDeviation>& own) {
    const NodeKey key = keyOf(0, child);
    const ChunkNode& node = nodes_[0][child];
    const BrickShape shape = settings_.shape;
    const std::size_t volume = shape.samples();
    const bool one_value = !atLevel0() && node.kind != NodeKind::kSampled;
    for (std::size_t c = 0; c < settings_.components(); ++c)
        visitBase(c, child, [&]<class T>(SampleCube<T> samples) {
            MeasuredBrick measured{key, {}, {}};
            if constexpr (std::is_same_v<T, double>)
                if (!atLevel0() && !one_value)
                    measured = {key, samples,
                                std::span(base_residual_[child]).subspan(c * shape.cells(), shape.cells())};
            for (int d = 1; d <= steps_; ++d) {
                const std::size_t above = d == 1 ? parent : ancestorOf(parent, 1, d);
                const std::span<const double> decoded(decoded_[std::size_t(d)][above].data() + c * volume,
                                                      volume);
                // A brick of one value under a node that says the same deviates nowhere.
                if (node.kind != NodeKind::kSampled &&
                    hasOneValue(keyOf(d, above), wholeCube(decoded.data(), std::size_t(shape.edgeSamples())),
                                key, valueOf(node, c), shape))
                    continue;
                DeviationPart part;
                if (one_value)
                    addUniformDeviation(keyOf(d, above), decoded, key, valueOf(node, c), shape,
                                        settings_.scale, part);
                else if (!atLevel0())
                    addMeasuredDeviation(keyOf(d, above), decoded, measured, shape, settings_.scale, part);
                else
                    addBrickDeviation(keyOf(d, above), decoded, key, samples, shape, settings_.scale, part);
                (d == 1 ? own[c] : shares_[parent][std::size_t(d - 2)][c]).merge(part);
            }
            if (!for_next_tier_) return;
            const std::span<CellResidual> out =
                std::span(residual_).subspan(c * shape.cells(), shape.cells());
            const SampleCube<double> top = exact(steps_, 0, c);
            if (node.kind != NodeKind::kSampled && hasOneValue(root_, top, key, valueOf(node, c), shape))
                return;
            if (one_value)
                addUniformResidual(root_, top, key, valueOf(node, c), shape, settings_.scale, out);
            else if (!atLevel0())
                addMeasuredResidual(root_, top, measured, shape, settings_.scale, out);
            else
                addBrickResidual(root_, top, key, samples, shape, settings_.scale, out);
        });
}

// A node one step above the base that has one value, against the nodes above it.
void Chunk::measureUniform(std::size_t index) {
    const NodeKey key = keyOf(1, index);
    const BrickShape shape = settings_.shape;
    for (std::size_t c = 0; c < settings_.components(); ++c) {
        double value = valueOf(nodes_[1][index], c);
        for (int d = 2; d <= steps_; ++d) {
            // A larger region of one value says what its parts, which may be left out, are.
            const ChunkNode& node = nodes_[std::size_t(d)][ancestorOf(index, 1, d)];
            if (node.kind == NodeKind::kUniform) value = valueOf(node, c);
        }
        for (int d = 2; d <= steps_; ++d) {
            const std::size_t above = ancestorOf(index, 1, d);
            if (nodes_[std::size_t(d)][above].kind != NodeKind::kSampled) continue;
            DeviationPart part;
            addUniformDeviation(
                keyOf(d, above),
                {decoded_[std::size_t(d)][above].data() + c * shape.samples(), shape.samples()}, key, value,
                shape, settings_.scale, part);
            shares_[index][std::size_t(d - 2)][c].merge(part);
        }
        if (for_next_tier_)
            addUniformResidual(root_, exact(steps_, 0, c), key, value, shape, settings_.scale,
                               std::span(residual_).subspan(c * shape.cells(), shape.cells()));
    }
}

// Of several components the worst counts, sub-box by sub-box.
void Chunk::settleDeviation(int depth, std::size_t slot, const std::vector<NodeDeviation>& components) {
    ChunkNode& node = nodes_[std::size_t(depth)][slot];
    const NodeKey key = keyOf(depth, slot);
    double rms = 0;
    for (const NodeDeviation& component : components) {
        node.deviation = std::max(node.deviation, component.largest());
        rms = std::max(rms, component.rms(key, settings_.shape, settings_.scale));
    }
    node.record.bound = roundUp(node.deviation);
    node.record.rms = std::min(roundUp(rms), node.record.bound);
    node.grid = std::make_unique<ErrorGrid>();
    for (const NodeDeviation& component : components) {
        const ErrorGrid grid = component.grid(key, settings_.shape, settings_.scale, node.record.bound);
        for (std::size_t b = 0; b < std::size_t(kErrorGridCells); ++b) {
            node.grid->bound[b] = std::max(node.grid->bound[b], grid.bound[b]);
            node.grid->rms[b] = std::max(node.grid->rms[b], grid.rms[b]);
        }
    }
}

void Chunk::encodeFinest(std::size_t index, double parent_rms) {
    const ChannelInfo& info = settings_.info();
    ChunkNode& node = nodes_[0][index];
    const BrickShape shape = settings_.shape;
    const std::size_t n = std::size_t(shape.edge_cells), s = n + 1;
    thread_local std::vector<std::byte> values;
    thread_local std::vector<std::uint8_t> active;
    const std::size_t bytes = sampleBytes(info.type);
    values.resize(shape.samples() * settings_.components() * bytes);
    active.resize(shape.cells());
    std::byte* out = values.data();
    for (std::size_t c = 0; c < settings_.components(); ++c)
        visitBase(c, index, [&](auto samples) {
            for (std::size_t k = 0; k < s; ++k)
                for (std::size_t j = 0; j < s; ++j, out += s * bytes)
                    std::memcpy(out, samples.rowAt(j, k), s * bytes);
        });
    const SampleCube<std::uint8_t> states = activeOf(index);
    for (std::size_t k = 0; k < n; ++k)
        for (std::size_t j = 0; j < n; ++j)
            std::copy_n(states.rowAt(j, k), n, active.data() + (k * n + j) * n);

    BrickToEncode brick;
    brick.shape = shape;
    brick.type = info.type;
    brick.components = info.components;
    brick.values = values;
    brick.active = active;
    brick.background = info.background;
    brick.max_error = settings_.max_error;
    brick.draft_error = settings_.drafts && settings_.max_error == 0 ? kDraftShareOfParent * parent_rms : 0;
    EncodedBrick encoded = encodeBrick(brick);
    node.payload = std::move(encoded.payload);
    node.deviation = encoded.error_made;
    NodeRecord& record = node.record;
    if (encoded.draft_bytes > 0) {
        record.draft_bytes = std::uint32_t(encoded.draft_bytes);
        record.draft_checksum = checksum(std::span(node.payload).first(encoded.draft_bytes));
        record.draft_bound = roundUp(encoded.draft_error_made);
        record.draft_rms = std::min(roundUp(encoded.draft_rms_made), record.draft_bound);
    }
    if (encoded.error_made == 0) return;
    record.bound = roundUp(encoded.error_made);
    record.rms = std::min(roundUp(encoded.rms_made), record.bound);
    record.value_min = roundDown(double(record.value_min) - encoded.error_made);
    record.value_max = roundUp(double(record.value_max) + encoded.error_made);
}

void Chunk::finish() {
    for (int d = 2; d <= steps_; ++d)
        for (const auto& [depth, slot] : coarse_) {
            if (depth != d) continue;
            std::vector<NodeDeviation> components(settings_.components());
            for (std::size_t unit = 0; unit < shares_.size(); ++unit)
                if (ancestorOf(unit, 1, d) == slot)
                    for (std::size_t c = 0; c < components.size(); ++c)
                        components[c].merge(shares_[unit][std::size_t(d - 2)][c]);
            settleDeviation(d, slot, components);
        }
    for (const auto& [depth, slot] : coarse_) summarise(depth, slot);
    if (settings_.max_error > 0 && atLevel0()) prune();
    shares_ = {};
    decoded_ = {};
    base_residual_ = {};
    std::vector<std::vector<double>> top = std::move(levels_.back().samples);
    levels_.back().samples.clear();
    releaseSamples();
    levels_.back().samples = std::move(top);
}

// Ranges, boxes and states from what is below.
void Chunk::summarise(int depth, std::size_t slot) {
    ChunkNode& node = nodes_[std::size_t(depth)][slot];
    const std::array<int, 3> at = placeOf(slot, steps_ - depth);
    for (int octant = 0; octant < 8; ++octant) {
        const ChunkNode& child = this->node(depth - 1, 2 * at[0] + (octant & 1),
                                            2 * at[1] + (octant >> 1 & 1), 2 * at[2] + (octant >> 2));
        const bool active = child.kind != NodeKind::kAbsent && child.states_active;
        if (!child.states_uniform || (octant > 0 && active != node.states_active))
            node.states_uniform = false;
        node.states_active = active;
        if (child.kind == NodeKind::kAbsent) continue;
        node.record.value_min = std::min(node.record.value_min, child.record.value_min);
        node.record.value_max = std::max(node.record.value_max, child.record.value_max);
        includeBox(node.record, child.record, octant, settings_.shape.edge_cells);
    }
}

// A node that is within the conversion's error everywhere needs no children; its states must be told by one
// bit.
void Chunk::prune() {
    for (int d = steps_; d >= 1; --d)
        for (std::size_t slot = 0; slot < nodes_[std::size_t(d)].size(); ++slot) {
            ChunkNode& node = nodes_[std::size_t(d)][slot];
            if (node.kind == NodeKind::kSampled && !node.dropped) {
                node.pruned = node.states_uniform && node.deviation <= settings_.max_error;
                if (node.pruned) node.record.active = node.states_active;
            }
            if (!node.pruned && !node.dropped) continue;
            const std::array<int, 3> at = placeOf(slot, steps_ - d);
            for (int octant = 0; octant < 8; ++octant)
                this->node(d - 1, 2 * at[0] + (octant & 1), 2 * at[1] + (octant >> 1 & 1),
                           2 * at[2] + (octant >> 2))
                    .dropped = true;
        }
}

std::vector<double> Chunk::topSamples() const {
    std::vector<double> samples;
    for (const std::vector<double>& component : levels_[std::size_t(steps_)].samples)
        samples.insert(samples.end(), component.begin(), component.end());
    return samples;
}

}  // namespace brickyard

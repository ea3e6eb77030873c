#include "core/channel_builder.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <mutex>

#include "core/brick_codec.h"
#include "core/brick_store.h"
#include "core/deviation.h"
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
// Parts measured by one task: fixed, so that sums do not depend on the number of threads.
constexpr std::size_t kPartsPerTask = 32;
// A draft of a level-0 brick is kept to this part of its parent's RMS error: a hundredth of its variance at
// most.
constexpr double kDraftShareOfParent = 0.1;
// Bricks encoded before they are appended in order.
constexpr std::size_t kBricksPerBatch = 512;

// Of the errors of a parallel loop, the one with the lowest index: the same message for any number of
// threads.
class FirstError {
public:
    void add(std::size_t index, Error error) {
        const std::lock_guard lock(mutex_);
        if (index < index_) index_ = index, error_ = std::move(error);
    }
    Result<void> result() {
        if (index_ == SIZE_MAX) return {};
        return tl::unexpected<Error>(std::move(error_));
    }

private:
    std::mutex mutex_;
    std::size_t index_ = SIZE_MAX;
    Error error_{};
};

struct BackgroundTest {
    std::vector<double> values;
    bool operator()(std::size_t component, double value) const { return value == values[component]; }
};

BackgroundTest backgroundOf(const ChannelInfo& info) {
    BackgroundTest test;
    for (ValueBits bits : info.background) test.values.push_back(toDouble(info.type, bits));
    return test;
}

// The tight box of cells that have a corner other than the background, and the range of the samples.
void describeSamples(std::span<const double> samples, BrickShape shape, const BackgroundTest& is_background,
                     NodeRecord& record) {
    const int s = shape.edgeSamples(), n = shape.edge_cells;
    std::array<int, 3> low{s, s, s}, high{-1, -1, -1};
    double min = samples[0], max = samples[0];
    const std::size_t per_component = shape.samples();
    for (std::size_t i = 0; i < samples.size(); ++i) {
        min = std::min(min, samples[i]);
        max = std::max(max, samples[i]);
        if (is_background(i / per_component, samples[i])) continue;
        const int at = int(i % per_component);
        const std::array<int, 3> p{at % s, at / s % s, at / (s * s)};
        for (std::size_t a = 0; a < 3; ++a) {
            low[a] = std::min(low[a], p[a]);
            high[a] = std::max(high[a], p[a]);
        }
    }
    record.value_min = roundDown(min);
    record.value_max = roundUp(max);
    if (high[0] < 0) return;
    for (std::size_t a = 0; a < 3; ++a) {
        // A sample touches the cells on both sides of it.
        record.box_begin[a] = std::uint8_t(std::max(low[a] - 1, 0));
        record.box_end[a] = std::uint8_t(std::min(high[a] + 1, n));
    }
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

ChannelBuilder::ChannelBuilder(FiniteField field, const BuildOptions& options)
    : field_(std::move(field)), options_(options) {
    if (!isFloating(field_.info().type))
        options_.max_error = 0;  // an identifier off by one is another identifier
}

Result<std::unique_ptr<ChannelBuilder>> ChannelBuilder::create(const FieldSource& source,
                                                               const BuildOptions& options) {
    Result<FiniteField> field = FiniteField::create(source, options.nonfinite);
    if (!field) return tl::unexpected(field.error());
    std::unique_ptr<ChannelBuilder> builder(new ChannelBuilder(std::move(*field), options));
    builder->plan_ = OctreePlan::make(builder->field_, options.shape);
    for (const std::vector<PlannedNode>& level : builder->plan_.levels()) {
        for (const PlannedNode& node : level)
            for (ValueBits bits : node.uniform.value)
                if (!std::isfinite(toDouble(source.info().type, bits)))
                    return refuseNonFinite(source.info(), closedRegion(node.key, options.shape).begin);
        builder->nodes_.emplace_back(level.size());
    }
    return builder;
}

Result<std::vector<double>> ChannelBuilder::readBrick(const NodeKey& key, SampleBlock& block) const {
    if (Result<void> read = field_.read(closedRegion(key, options_.shape), block); !read)
        return tl::unexpected(read.error());
    std::vector<double> samples;
    samplesToDouble(field_.info().type, block.values, samples);
    return samples;
}

// What is known before any level is computed: ranges, boxes and states of level 0 and of regions of one
// value.
Result<void> ChannelBuilder::readStatistics() {
    const BackgroundTest is_background = backgroundOf(field_.info());
    const std::size_t cells_edge = std::size_t(options_.shape.edge_cells), s = cells_edge + 1;
    std::mutex range_mutex;
    auto includeActive = [&](double min, double max) {
        const std::lock_guard lock(range_mutex);
        value_min_ = any_active_ ? std::min(value_min_, min) : min;
        value_max_ = any_active_ ? std::max(value_max_, max) : max;
        any_active_ = true;
    };
    FirstError first;
    for (std::size_t l = 0; l < nodes_.size(); ++l)
        options_.parallel_for(nodes_[l].size(), [&](std::size_t i) {
            const PlannedNode& planned = plan_.levels()[l][i];
            Node& node = nodes_[l][i];
            if (planned.kind == PlannedKind::kUniform) {
                node.constant = planned.uniform.value;
                node.states_uniform = true;
                node.states_active = node.record.active = planned.uniform.active;
                double min = 0, max = 0;
                for (std::size_t c = 0; c < componentCount(); ++c) {
                    const double value = toDouble(field_.info().type, node.constant[c]);
                    min = c ? std::min(min, value) : value;
                    max = c ? std::max(max, value) : value;
                    if (!is_background(c, value)) node.record.box_end.fill(std::uint8_t(cells_edge));
                }
                node.record.value_min = roundDown(min);
                node.record.value_max = roundUp(max);
                if (planned.uniform.active) includeActive(min, max);
            } else if (planned.kind == PlannedKind::kBrick) {
                SampleBlock block;
                const Result<std::vector<double>> samples = readBrick(planned.key, block);
                if (!samples) return first.add(i, samples.error());
                describeSamples(*samples, options_.shape, is_background, node.record);
                std::size_t active = 0;
                double min = 0, max = 0;
                for (std::size_t z = 0; z < cells_edge; ++z)
                    for (std::size_t y = 0; y < cells_edge; ++y)
                        for (std::size_t x = 0; x < cells_edge; ++x) {
                            const std::size_t at = (z * s + y) * s + x;
                            if (!block.active[at]) continue;
                            for (std::size_t c = 0; c < componentCount(); ++c) {
                                const double value = (*samples)[c * options_.shape.samples() + at];
                                min = active + c ? std::min(min, value) : value;
                                max = active + c ? std::max(max, value) : value;
                            }
                            ++active;
                        }
                node.states_uniform = active == 0 || active == options_.shape.cells();
                node.states_active = active > 0;
                if (active > 0) includeActive(min, max);
            }
        });
    if (Result<void> result = first.result(); !result) return result;

    for (const std::vector<Node>& level : nodes_)
        for (const Node& node : level)
            scale_ = std::max({scale_ == 1 ? 0 : scale_, std::abs(double(node.record.value_min)),
                               std::abs(double(node.record.value_max))});
    for (double value : is_background.values) scale_ = std::max(scale_, std::abs(value));
    if (!(scale_ > 1e-300)) scale_ = 1;
    return {};
}

// Samples of the level below on [2k - 1, 2k + 2N + 1] per axis. A position that no node of that level stores
// is inside a region of one value, or background.
Result<void> ChannelBuilder::gatherFine(const NodeKey& key, std::vector<double>& fine) const {
    const int n = options_.shape.edge_cells, f = 2 * n + 3;
    const ChannelInfo& info = field_.info();
    if (key.level == 1) {
        IndexBox box;
        box.begin = {std::int64_t(key.x) * 2 * n - 1, std::int64_t(key.y) * 2 * n - 1,
                     std::int64_t(key.z) * 2 * n - 1};
        for (std::size_t a = 0; a < 3; ++a) box.end[a] = box.begin[a] + f;
        SampleBlock block;
        if (Result<void> read = field_.read(box, block); !read) return read;
        samplesToDouble(info.type, block.values, fine);
        return {};
    }

    const std::size_t volume = std::size_t(f) * std::size_t(f) * std::size_t(f);
    fine.resize(volume * componentCount());
    for (std::size_t c = 0; c < componentCount(); ++c)
        std::fill_n(fine.begin() + std::ptrdiff_t(c * volume), volume,
                    toDouble(info.type, info.background[c]));
    // Nodes with samples come last: on a shared face they win over their neighbour's one value.
    for (const bool with_samples : {false, true})
        for (int bz = -1; bz <= 2; ++bz)
            for (int by = -1; by <= 2; ++by)
                for (int bx = -1; bx <= 2; ++bx) {
                    const NodeKey below{key.level - 1, 2 * key.x + bx, 2 * key.y + by, 2 * key.z + bz};
                    const PlannedNode* planned = plan_.findOrAbove(below);
                    if (!planned) continue;
                    const bool uniform = planned->kind == PlannedKind::kUniform;
                    if (!uniform && !(planned->key == below)) continue;  // absent: background
                    if (uniform == with_samples) continue;
                    const Node* node =
                        uniform ? nullptr : &nodes_[std::size_t(below.level)][plan_.indexOf(below)];
                    // The brick's samples 0..N stand at b * N + 1 + 0..N of the gathered block.
                    const std::array<int, 3> at{bx * n + 1, by * n + 1, bz * n + 1};
                    for (std::size_t c = 0; c < componentCount(); ++c) {
                        const double value = uniform ? toDouble(info.type, planned->uniform.value[c]) : 0;
                        for (int k = std::max(0, -at[2]); k <= n && at[2] + k < f; ++k)
                            for (int j = std::max(0, -at[1]); j <= n && at[1] + j < f; ++j)
                                for (int i = std::max(0, -at[0]); i <= n && at[0] + i < f; ++i)
                                    fine[c * volume +
                                         std::size_t(((at[2] + k) * f + at[1] + j) * f + at[0] + i)] =
                                        uniform ? value
                                                : node->exact[c * options_.shape.samples() +
                                                              options_.shape.sampleAt(i, j, k)];
                    }
                }
    return {};
}

Result<void> ChannelBuilder::buildNode(const PlannedNode& planned, Node& node) {
    std::vector<double> fine;
    if (Result<void> gathered = gatherFine(planned.key, fine); !gathered) return gathered;
    const std::size_t volume = fine.size() / componentCount();
    double step_rms = 0;
    for (std::size_t c = 0; c < componentCount(); ++c) {
        const std::span<const double> plane(fine.data() + c * volume, volume);
        const std::vector<double> coarse = reduceLevel(plane, options_.shape.edge_cells);
        step_rms = std::max(step_rms, reductionRms(plane, coarse, options_.shape.edge_cells, scale_));
        node.exact.insert(node.exact.end(), coarse.begin(), coarse.end());
    }

    const SampleType stored = levelType(field_.info().type, planned.key.level);
    const std::vector<std::byte> values = doublesToSamples(stored, node.exact);
    // Levels above 0 keep no states, so the background tells the codec nothing.
    const std::vector<ValueBits> no_background(componentCount(), 0);
    BrickToEncode brick;
    brick.shape = options_.shape;
    brick.type = stored;
    brick.components = field_.info().components;
    brick.values = values;
    brick.background = no_background;
    brick.max_error = std::max(kCoarseQuantisation * step_rms, kCoarseShareOfError * options_.max_error);
    if (!std::isfinite(brick.max_error)) brick.max_error = 0;
    node.payload = encodeBrick(brick).payload;

    // Bounds are measured on what a reader will decode, not on what was meant.
    const Result<DecodedBrick> decoded =
        decodeBrick(node.payload, options_.shape, stored, field_.info().components, no_background);
    assert(decoded && "the codec reads what it wrote");
    samplesToDouble(stored, decoded->values, node.decoded);
    return {};
}

void ChannelBuilder::summarise(const PlannedNode& planned, Node& node) {
    describeSamples(node.decoded, options_.shape, backgroundOf(field_.info()), node.record);
    node.states_uniform = true;
    bool first = true;
    for (int octant = 0; octant < 8; ++octant) {
        const bool exists = planned.valid_mask >> octant & 1;
        const Node* child =
            exists ? &level(planned.key.level - 1)[plan_.indexOf(planned.key.child(octant))] : nullptr;
        const bool active = child && child->states_active;
        if (child && !child->states_uniform) node.states_uniform = false;
        if (!first && active != node.states_active) node.states_uniform = false;
        node.states_active = active;
        first = false;
        if (!child) continue;
        node.record.value_min = std::min(node.record.value_min, child->record.value_min);
        node.record.value_max = std::max(node.record.value_max, child->record.value_max);
        includeBox(node.record, child->record, octant, options_.shape.edge_cells);
    }
}

void ChannelBuilder::collectParts(const PlannedNode& from, std::vector<NodeKey>& bricks,
                                  std::vector<std::pair<NodeKey, UniformRegion>>& uniform) const {
    for (int octant = 0; octant < 8; ++octant) {
        const NodeKey key = from.key.child(octant);
        if (!(from.valid_mask >> octant & 1)) {
            uniform.push_back({key, {field_.info().background, false}});
            continue;
        }
        const PlannedNode& child = *plan_.find(key);
        if (child.kind == PlannedKind::kInner) collectParts(child, bricks, uniform);
        if (child.kind == PlannedKind::kBrick) bricks.push_back(key);
        if (child.kind == PlannedKind::kUniform) uniform.push_back({key, child.uniform});
    }
}

// Deviations of every node of a level from level 0. Parts are measured by tasks of a fixed size and merged in
// order.
Result<void> ChannelBuilder::measureLevel(int l) {
    const std::vector<PlannedNode>& planned = plan_.levels()[std::size_t(l)];
    struct Parts {
        std::vector<NodeKey> bricks;
        std::vector<std::pair<NodeKey, UniformRegion>> uniform;
        std::vector<std::vector<NodeDeviation>> tasks;  // by task, by component
    };
    std::vector<Parts> parts(planned.size());
    std::vector<std::pair<std::size_t, std::size_t>> tasks;  // node, number of the task within it
    for (std::size_t i = 0; i < planned.size(); ++i) {
        if (planned[i].kind != PlannedKind::kInner) continue;
        collectParts(planned[i], parts[i].bricks, parts[i].uniform);
        const std::size_t all = parts[i].bricks.size() + parts[i].uniform.size();
        parts[i].tasks.resize((all + kPartsPerTask - 1) / kPartsPerTask,
                              std::vector<NodeDeviation>(componentCount()));
        for (std::size_t t = 0; t < parts[i].tasks.size(); ++t) tasks.emplace_back(i, t);
    }

    FirstError first;
    const std::size_t volume = options_.shape.samples();
    options_.parallel_for(tasks.size(), [&](std::size_t task) {
        const auto [i, t] = tasks[task];
        const NodeKey key = planned[i].key;
        const Node& node = level(l)[i];
        const std::size_t all = parts[i].bricks.size() + parts[i].uniform.size();
        SampleBlock block;
        for (std::size_t p = t * kPartsPerTask; p < std::min(all, (t + 1) * kPartsPerTask); ++p) {
            const bool is_brick = p < parts[i].bricks.size();
            std::vector<double> samples;
            if (is_brick) {
                Result<std::vector<double>> read = readBrick(parts[i].bricks[p], block);
                if (!read) return first.add(task, read.error());
                samples = std::move(*read);
            }
            for (std::size_t c = 0; c < componentCount(); ++c) {
                const std::span<const double> own(node.decoded.data() + c * volume, volume);
                DeviationPart part;
                if (is_brick) {
                    addBrickDeviation(key, own, parts[i].bricks[p], {samples.data() + c * volume, volume},
                                      options_.shape, scale_, part);
                } else {
                    const auto& [region, uniform] = parts[i].uniform[p - parts[i].bricks.size()];
                    addUniformDeviation(key, own, region, toDouble(field_.info().type, uniform.value[c]),
                                        options_.shape, scale_, part);
                }
                parts[i].tasks[t][c].merge(part);
            }
        }
    });
    if (Result<void> result = first.result(); !result) return result;

    for (std::size_t i = 0; i < planned.size(); ++i) {
        if (planned[i].kind != PlannedKind::kInner) continue;
        Node& node = level(l)[i];
        // Of several components the worst counts, sub-box by sub-box.
        double rms = 0;
        std::vector<NodeDeviation> components(componentCount());
        for (std::size_t c = 0; c < componentCount(); ++c) {
            for (const std::vector<NodeDeviation>& task : parts[i].tasks) components[c].merge(task[c]);
            node.deviation = std::max(node.deviation, components[c].largest());
            rms = std::max(rms, components[c].rms(planned[i].key, options_.shape, scale_));
        }
        node.record.bound = roundUp(node.deviation);
        node.record.rms = std::min(roundUp(rms), node.record.bound);
        for (std::size_t c = 0; c < componentCount(); ++c) {
            const ErrorGrid grid =
                components[c].grid(planned[i].key, options_.shape, scale_, node.record.bound);
            for (std::size_t b = 0; b < std::size_t(kErrorGridCells); ++b) {
                node.grid.bound[b] = std::max(node.grid.bound[b], grid.bound[b]);
                node.grid.rms[b] = std::max(node.grid.rms[b], grid.rms[b]);
            }
        }
    }
    return {};
}

Result<void> ChannelBuilder::buildLevels() {
    if (Result<void> read = readStatistics(); !read) return read;
    for (int l = 1; l < levelCount(); ++l) {
        const std::vector<PlannedNode>& planned = plan_.levels()[std::size_t(l)];
        FirstError first;
        options_.parallel_for(planned.size(), [&](std::size_t i) {
            if (planned[i].kind != PlannedKind::kInner) return;
            if (Result<void> built = buildNode(planned[i], level(l)[i]); !built)
                return first.add(i, built.error());
            summarise(planned[i], level(l)[i]);
        });
        if (Result<void> result = first.result(); !result) return result;
        if (Result<void> measured = measureLevel(l); !measured) return measured;
        for (Node& node : level(l)) node.decoded = {};
        for (Node& node : level(l - 1)) node.exact = {};
    }
    if (options_.max_error > 0) prune();
    return {};
}

// A node that is within the conversion's error everywhere needs no children; its states must be told by one
// bit.
void ChannelBuilder::prune() {
    for (int l = levelCount() - 1; l >= 1; --l)
        for (std::size_t i = 0; i < level(l).size(); ++i) {
            const PlannedNode& planned = plan_.levels()[std::size_t(l)][i];
            Node& node = level(l)[i];
            if (planned.kind != PlannedKind::kInner) continue;
            node.pruned = !node.dropped && node.states_uniform && node.deviation <= options_.max_error;
            if (node.pruned) {
                node.record.active = node.states_active;
                error_made_ = std::max(error_made_, node.deviation);
            }
            if (!node.pruned && !node.dropped) continue;
            for (int octant = 0; octant < 8; ++octant)
                if (planned.valid_mask >> octant & 1)
                    level(l - 1)[plan_.indexOf(planned.key.child(octant))].dropped = true;
        }
}

void ChannelBuilder::encodeFinest(const SampleBlock& block, double parent_rms, Node& node,
                                  std::vector<std::byte>& payload) const {
    const ChannelInfo& info = field_.info();
    const std::size_t n = std::size_t(options_.shape.edge_cells), s = n + 1;
    std::vector<std::uint8_t> active(options_.shape.cells());
    for (std::size_t z = 0; z < n; ++z)
        for (std::size_t y = 0; y < n; ++y)
            std::copy_n(block.active.begin() + std::ptrdiff_t((z * s + y) * s), n,
                        active.begin() + std::ptrdiff_t((z * n + y) * n));

    BrickToEncode brick;
    brick.shape = options_.shape;
    brick.type = info.type;
    brick.components = info.components;
    brick.values = block.values;
    brick.active = active;
    brick.background = info.background;
    brick.max_error = options_.max_error;
    brick.draft_error = options_.max_error == 0 ? kDraftShareOfParent * parent_rms : 0;
    EncodedBrick encoded = encodeBrick(brick);
    payload = std::move(encoded.payload);
    node.deviation = encoded.error_made;

    auto rmsOf = [&](const Result<DecodedBrick>& decoded) {
        assert(decoded && "the codec reads what it wrote");
        std::vector<double> before, after;
        samplesToDouble(info.type, block.values, before);
        samplesToDouble(info.type, decoded->values, after);
        double squares = 0;
        for (std::size_t i = 0; i < before.size(); ++i) {
            const double d = (after[i] - before[i]) / scale_;
            squares += d * d;
        }
        return scale_ * std::sqrt(squares / double(before.size()));
    };
    if (encoded.draft_bytes > 0) {
        const std::span<const std::byte> draft(payload.data(), encoded.draft_bytes);
        node.record.draft_bytes = std::uint32_t(encoded.draft_bytes);
        node.record.draft_checksum = checksum(draft);
        node.record.draft_bound = roundUp(encoded.draft_error_made);
        node.record.draft_rms =
            std::min(roundUp(rmsOf(decodeDraft(draft, options_.shape, info.type, info.components))),
                     node.record.draft_bound);
    }
    if (encoded.error_made == 0) return;
    node.record.bound = roundUp(encoded.error_made);
    node.record.rms = std::min(
        roundUp(rmsOf(decodeBrick(payload, options_.shape, info.type, info.components, info.background))),
        node.record.bound);
    node.record.value_min = roundDown(double(node.record.value_min) - encoded.error_made);
    node.record.value_max = roundUp(double(node.record.value_max) + encoded.error_made);
}

Result<void> ChannelBuilder::writeFinest(FrameWriter& writer, std::size_t& done, std::size_t total) {
    if (plan_.levels().empty()) return {};
    const std::vector<PlannedNode>& planned = plan_.levels()[0];
    std::vector<std::vector<std::byte>> payloads;
    for (std::size_t begin = 0; begin < planned.size(); begin += kBricksPerBatch) {
        const std::size_t count = std::min(kBricksPerBatch, planned.size() - begin);
        payloads.assign(count, {});
        FirstError first;
        options_.parallel_for(count, [&](std::size_t i) {
            const PlannedNode& brick = planned[begin + i];
            Node& node = level(0)[begin + i];
            if (brick.kind != PlannedKind::kBrick || node.dropped) return;
            SampleBlock block;
            if (Result<void> read = field_.read(closedRegion(brick.key, options_.shape), block); !read)
                return first.add(i, read.error());
            const double parent_rms =
                levelCount() > 1 ? double(level(1)[plan_.indexOf(brick.key.parent())].record.rms) : 0;
            encodeFinest(block, parent_rms, node, payloads[i]);
        });
        if (Result<void> result = first.result(); !result) return result;
        for (std::size_t i = 0; i < count; ++i) {
            Node& node = level(0)[begin + i];
            if (payloads[i].empty()) continue;
            const Result<StoredBytes> stored = writer.append(payloads[i]);
            if (!stored) return tl::unexpected(stored.error());
            node.record.payload_offset = stored->offset;
            node.record.payload_bytes = stored->bytes;
            node.record.payload_checksum = stored->checksum;
            error_made_ = std::max(error_made_, node.deviation);
            payload_bytes_ += stored->bytes;
            ++bricks_;
        }
        done += count;
        if (options_.progress) options_.progress(done, total);
    }
    return {};
}

Result<void> ChannelBuilder::writeLevel(FrameWriter& writer, int l) {
    if (l >= levelCount()) return {};
    for (Node& node : level(l)) {
        if (node.payload.empty() || node.dropped) continue;
        const Result<StoredBytes> stored = writer.append(node.payload);
        if (!stored) return tl::unexpected(stored.error());
        node.record.payload_offset = stored->offset;
        node.record.payload_bytes = stored->bytes;
        node.record.payload_checksum = stored->checksum;
        payload_bytes_ += stored->bytes;
        ++bricks_;
        node.payload = {};
    }
    return {};
}

std::unique_ptr<TreeNode> ChannelBuilder::treeNode(const NodeKey& key) {
    const PlannedNode& planned = *plan_.find(key);
    Node& node = level(key.level)[plan_.indexOf(key)];
    auto tree = std::make_unique<TreeNode>();
    tree->record = node.record;
    tree->constant = node.constant;
    if (planned.kind == PlannedKind::kInner) tree->grid = std::make_unique<ErrorGrid>(node.grid);
    if (node.pruned) return tree;
    tree->valid_mask = planned.valid_mask;
    for (int octant = 0; octant < 8; ++octant)
        if (planned.valid_mask >> octant & 1) tree->children.push_back(treeNode(key.child(octant)));
    return tree;
}

Result<ChannelFooter> ChannelBuilder::writeTree(FrameWriter& writer) {
    const ChannelInfo& info = field_.info();
    ChannelFooter footer;
    footer.set_name(info.name);
    footer.set_sample_type(StoredSampleType(int(info.type)));
    footer.set_components(std::uint32_t(info.components));
    for (ValueBits bits : info.background) footer.add_background(bits);
    for (int c = 0; c < 4; ++c)
        for (int r = 0; r < 4; ++r) footer.add_index_to_world(info.index_to_world.matrix()[c][r]);
    if (info.active_voxels > 0)
        for (std::size_t a = 0; a < 3; ++a) {
            footer.add_active_min(std::int32_t(info.active_box.begin[a]));
            footer.add_active_max(std::int32_t(info.active_box.end[a] - 1));
        }
    footer.set_active_voxels(info.active_voxels);
    footer.set_grid_class(info.grid_class);
    footer.set_vector_type(info.vector_type);
    footer.set_saved_as_half(info.saved_as_half);
    footer.set_source_type(info.source_type);
    for (const MetadataEntry& entry : info.metadata) {
        SourceMetadata& stored = *footer.add_metadata();
        stored.set_name(entry.name);
        stored.set_type(entry.type);
        stored.set_value(entry.value);
    }
    footer.set_error_bound(options_.max_error);
    footer.set_error_made(error_made_);
    footer.set_value_min(value_min_);
    footer.set_value_max(value_max_);
    footer.set_bricks(bricks_);
    footer.set_levels(std::uint32_t(levelCount()));
    footer.set_payload_bytes(payload_bytes_);

    std::vector<std::unique_ptr<TreeNode>> roots;
    if (levelCount() > 0)
        for (const PlannedNode& root : plan_.levels().back()) {
            RootNode* out = footer.add_roots();
            out->set_level(std::uint32_t(root.key.level));
            out->set_x(root.key.x);
            out->set_y(root.key.y);
            out->set_z(root.key.z);
            roots.push_back(treeNode(root.key));
        }
    std::vector<std::uint32_t> raw_bytes;
    const std::vector<std::vector<std::byte>> blocks = encodeTree(roots, info.components, raw_bytes);
    for (std::size_t b = 0; b < blocks.size(); ++b) {
        const Result<StoredBytes> stored = writer.append(blocks[b]);
        if (!stored) return tl::unexpected(stored.error());
        BlockRef* ref = footer.add_blocks();
        ref->set_offset(stored->offset);
        ref->set_bytes(stored->bytes);
        ref->set_raw_bytes(raw_bytes[b]);
        ref->set_xxh64(stored->checksum);
    }
    return footer;
}

}  // namespace brickyard

#include "core/channel_builder.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>

#include "core/brick_store.h"
#include "core/float_rounding.h"
#include "core/sample_conversion.h"

namespace brickyard {

namespace {

// Chunks of a higher tier that are worked on at once.
constexpr std::size_t kTierBatch = 4;
// Payloads above level 0 are copied to the frame file in pieces of this size.
constexpr std::size_t kCopyBytes = 1u << 20;

template <class T>
std::span<const std::byte> bytesOf(const std::vector<T>& values) {
    return std::as_bytes(std::span(values));
}

// A node's cells as a box of level-0 voxels.
IndexBox ownedRegion(const NodeKey& key, BrickShape shape) {
    IndexBox box = closedRegion(key, shape);
    for (std::size_t a = 0; a < 3; ++a) --box.end[a];
    return box;
}

bool meetOrigin(const std::vector<NodeKey>& keys) {
    return std::all_of(keys.begin(), keys.end(), [](const NodeKey& key) {
        const auto near = [](std::int32_t c) { return c == 0 || c == -1; };
        return near(key.x) && near(key.y) && near(key.z);
    });
}

}  // namespace

ChannelBuilder::ChannelBuilder(const FieldSource& source, FiniteField field, const BuildOptions& options,
                               ScratchFile& scratch, BufferPool& buffers)
    : source_(&source), field_(std::move(field)), options_(options), scratch_(&scratch), subtrees_(scratch) {
    const ChannelInfo& info = field_.info();
    settings_.field = &field_;
    settings_.buffers = &buffers;
    settings_.shape = options_.shape;
    settings_.drafts = options_.drafts;
    // An identifier off by one is another identifier.
    settings_.max_error = options_.max_error = isFloating(info.type) ? options_.max_error : 0;
    for (ValueBits bits : info.background) settings_.background.push_back(toDouble(info.type, bits));
}

Result<std::unique_ptr<ChannelBuilder>> ChannelBuilder::create(const FieldSource& source,
                                                               const BuildOptions& options,
                                                               ScratchFile& scratch, BufferPool& buffers) {
    Result<FiniteField> field = FiniteField::create(source, options.nonfinite);
    if (!field) return tl::unexpected(field.error());
    return std::unique_ptr<ChannelBuilder>(
        new ChannelBuilder(source, std::move(*field), options, scratch, buffers));
}

Result<void> ChannelBuilder::plan() {
    Result<OctreePlan> plan = OctreePlan::make(field_, options_.shape);
    if (!plan) return tl::unexpected(plan.error());
    plan_ = std::move(*plan);
    for (const auto& [key, region] : plan_->uniform()) {
        if (!region.active) continue;
        double min = 0, max = 0;
        for (std::size_t c = 0; c < region.value.size(); ++c) {
            const double value = toDouble(field_.info().type, region.value[c]);
            min = c ? std::min(min, value) : value;
            max = c ? std::max(max, value) : value;
        }
        active_.includeUniform(ownedRegion(key, options_.shape), min, max);
    }
    several_tiers_ = !isTop(plan_->chunks(), chunkSteps(options_.shape));

    // Squares of everything but large doubles fit a double.
    if (field_.info().type != SampleType::kFloat64) return {};
    const Result<double> largest = largestMagnitude();
    if (!largest) return tl::unexpected(largest.error());
    if (*largest > 1e-300) settings_.scale = *largest;
    return {};
}

// One more pass over the field, for doubles alone.
Result<double> ChannelBuilder::largestMagnitude() const {
    double largest = 0;
    for (double value : settings_.background) largest = std::max(largest, std::abs(value));
    for (const auto& [key, region] : plan_->uniform())
        for (ValueBits bits : region.value)
            largest = std::max(largest, std::abs(toDouble(field_.info().type, bits)));
    SampleBlock block;
    std::vector<double> values;
    for (const NodeKey& key : plan_->chunks()) {
        if (Result<void> read = field_.read(closedRegion(key, options_.shape), block); !read)
            return tl::unexpected(read.error());
        samplesToDouble(field_.info().type, block.values, values);
        for (double value : values) largest = std::max(largest, std::abs(value));
    }
    return largest;
}

// Whether nothing stands above these nodes of a level: one node, or nodes that meet at the origin, which
// floor division never brings together.
bool ChannelBuilder::isTop(const std::vector<NodeKey>& keys, int level) const {
    for (const auto& [key, region] : plan_->uniform()) {
        if (key.level > level) return false;
        if (key.level == level && !keys.empty() && !meetOrigin({key, keys.front()})) return false;
    }
    return keys.size() <= 1 || meetOrigin(keys);
}

std::unique_ptr<Chunk> ChannelBuilder::chunk(std::size_t index) const {
    return std::make_unique<Chunk>(settings_, plan_->chunks()[index], several_tiers_);
}

std::uint64_t ChannelBuilder::chunkBytes() const {
    const std::uint64_t edge = (std::uint64_t(options_.shape.edge_cells) << chunkSteps(options_.shape)) + 15;
    const std::uint64_t volume = edge * edge * edge, components = settings_.components();
    // The samples and states, the levels above as doubles, and payloads that may be as large as the samples.
    return volume * (components * (2 * sampleBytes(field_.info().type) + 2) + 1);
}

Result<void> ChannelBuilder::commitFinest(Chunk& chunk, FrameWriter& writer) {
    active_.include(chunk.active());
    // Near in space is near in the file.
    std::vector<std::size_t> order;
    for (std::size_t slot = 0; slot < chunk.nodesAt(0).size(); ++slot) order.push_back(slot);
    std::sort(order.begin(), order.end(),
              [&](std::size_t a, std::size_t b) { return mortonLess(chunk.keyOf(0, a), chunk.keyOf(0, b)); });
    for (const std::size_t slot : order) {
        ChunkNode& node = chunk.nodesAt(0)[slot];
        if (node.payload.empty() || node.dropped) continue;
        const Result<StoredBytes> stored = writer.append(node.payload);
        if (!stored) return tl::unexpected(stored.error());
        node.record.payload_offset = stored->offset;
        node.record.payload_bytes = stored->bytes;
        node.record.payload_checksum = stored->checksum;
        error_made_ = std::max(error_made_, node.deviation);
        payload_bytes_ += stored->bytes;
        ++bricks_;
        node.payload = {};
    }
    if (Result<void> put = putPayloads(chunk, 1); !put) return put;
    if (chunk.node(chunk.steps(), 0, 0, 0).kind == NodeKind::kAbsent) return {};
    auto tree = treeOf(chunk, chunk.steps(), 0, 0, 0);
    if (!tree) return tl::unexpected(tree.error());
    auto stub = subtrees_.put(std::move(*tree));
    if (!stub) return tl::unexpected(stub.error());
    tops_.emplace(chunk.root(), std::move(*stub));
    return keepBase(chunk, several_tiers_, bases_);
}

// The payloads of a chunk's nodes above its base, level by level.
Result<void> ChannelBuilder::putPayloads(Chunk& chunk, int lowest_depth) {
    std::vector<std::byte> bytes;
    for (int d = lowest_depth; d <= chunk.steps(); ++d) {
        Level& level = levels_[chunk.root().level - chunk.steps() + d];
        bytes.clear();
        for (ChunkNode& node : chunk.nodesAt(d)) {
            if (node.pruned && !node.dropped) error_made_ = std::max(error_made_, node.deviation);
            if (node.payload.empty() || node.dropped) continue;
            node.record.payload_offset = level.bytes + bytes.size();
            node.record.payload_bytes = std::uint32_t(node.payload.size());
            node.record.payload_checksum = checksum(node.payload);
            bytes.insert(bytes.end(), node.payload.begin(), node.payload.end());
            ++level.bricks;
            node.payload = {};
        }
        if (bytes.empty()) continue;
        const auto at = scratch_->append(bytes);
        if (!at) return tl::unexpected(at.error());
        level.extents.emplace_back(*at, bytes.size());
        level.bytes += bytes.size();
    }
    return {};
}

// A node of a chunk with what is below it in the chunk; in a higher tier also what was there already.
Result<std::unique_ptr<TreeNode>> ChannelBuilder::treeOf(Chunk& chunk, int depth, int x, int y, int z) {
    ChunkNode& node = chunk.node(depth, x, y, z);
    const NodeKey key = chunk.keyOf(depth, chunk.slot(depth, x, y, z));
    if (depth == 0 && key.level > 0 && node.kind == NodeKind::kSampled) {
        const auto found = tops_.find(key);
        assert(found != tops_.end());
        return std::move(found->second);
    }
    auto tree = std::make_unique<TreeNode>();
    tree->record = node.record;
    tree->constant = node.constant;
    tree->grid = std::move(node.grid);
    if (node.pruned || depth == 0) return tree;
    tree->valid_mask = node.valid_mask;
    for (int octant = 0; octant < 8; ++octant) {
        if (!(node.valid_mask >> octant & 1)) continue;
        auto child =
            treeOf(chunk, depth - 1, 2 * x + (octant & 1), 2 * y + (octant >> 1 & 1), 2 * z + (octant >> 2));
        if (!child) return tl::unexpected(child.error());
        tree->children.push_back(std::move(*child));
    }
    return tree;
}

// What the next tier needs of a chunk's root.
Result<void> ChannelBuilder::keepBase(Chunk& chunk, bool for_next_tier,
                                      std::unordered_map<NodeKey, Base, NodeKeyHash>& bases) {
    Base base;
    base.node = std::move(chunk.node(chunk.steps(), 0, 0, 0));
    if (for_next_tier && base.node.kind == NodeKind::kSampled) {
        const auto samples = scratch_->append(bytesOf(chunk.topSamples()));
        if (!samples) return tl::unexpected(samples.error());
        base.samples_at = *samples;
        const auto residual = scratch_->append(bytesOf(chunk.topResidual()));
        if (!residual) return tl::unexpected(residual.error());
        base.residual_at = *residual;
    }
    bases.emplace(chunk.root(), std::move(base));
    return {};
}

const ChunkNode* ChannelBuilder::find(const NodeKey& key) const {
    const auto found = bases_.find(key);
    return found == bases_.end() ? nullptr : &found->second.node;
}

Result<std::vector<double>> ChannelBuilder::samples(const NodeKey& key) const {
    std::vector<double> out(options_.shape.samples() * settings_.components());
    if (auto read = scratch_->read(bases_.at(key).samples_at, std::as_writable_bytes(std::span(out))); !read)
        return tl::unexpected(read.error());
    return out;
}

Result<std::vector<CellResidual>> ChannelBuilder::residual(const NodeKey& key) const {
    std::vector<CellResidual> out(options_.shape.cells() * settings_.components());
    if (auto read = scratch_->read(bases_.at(key).residual_at, std::as_writable_bytes(std::span(out))); !read)
        return tl::unexpected(read.error());
    return out;
}

// The chunks of the tier above nodes of level `base`, in Morton order.
std::vector<NodeKey> ChannelBuilder::tierRoots(int base) const {
    const int steps = chunkSteps(options_.shape);
    std::vector<NodeKey> keys;
    const auto add = [&](NodeKey key) {
        while (key.level < base + steps) key = key.parent();
        keys.push_back(key);
    };
    for (const auto& [key, node] : bases_) add(key);
    for (const auto& [key, region] : plan_->uniform())
        if (key.level >= base && key.level < base + steps) add(key);
    std::sort(keys.begin(), keys.end(), mortonLess);
    keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
    return keys;
}

Result<void> ChannelBuilder::buildTiers(const ParallelFor& parallel_for) {
    source_->release();
    const int steps = chunkSteps(options_.shape);
    int base = steps;
    for (;; base += steps) {
        std::vector<NodeKey> keys;
        for (const auto& [key, node] : bases_) keys.push_back(key);
        if (isTop(keys, base)) break;
        const std::vector<NodeKey> roots = tierRoots(base);
        const bool more = !isTop(roots, base + steps);
        std::unordered_map<NodeKey, Base, NodeKeyHash> bases;
        Nodes tops;
        for (std::size_t begin = 0; begin < roots.size(); begin += kTierBatch) {
            std::vector<std::unique_ptr<Chunk>> chunks;
            for (std::size_t i = begin; i < std::min(roots.size(), begin + kTierBatch); ++i)
                chunks.push_back(std::make_unique<Chunk>(settings_, roots[i], more));
            FirstError first;
            parallel_for(chunks.size(), [&](std::size_t i) { first.add(i, chunks[i]->readBase(*this)); });
            if (Result<void> result = first.result(); !result) return result;
            std::vector<std::pair<Chunk*, std::size_t>> pieces;
            for (const auto& chunk : chunks)
                for (std::size_t i = 0; i < chunk->coarseCount(); ++i) pieces.emplace_back(chunk.get(), i);
            parallel_for(pieces.size(),
                         [&](std::size_t i) { pieces[i].first->encodeCoarse(pieces[i].second); });
            pieces.clear();
            for (const auto& chunk : chunks)
                for (std::size_t i = 0; i < chunk->measureCount(); ++i) pieces.emplace_back(chunk.get(), i);
            parallel_for(pieces.size(), [&](std::size_t i) { pieces[i].first->measure(pieces[i].second); });
            for (const auto& chunk : chunks) {
                chunk->finish();
                if (Result<void> put = putPayloads(*chunk, 1); !put) return put;
                auto tree = treeOf(*chunk, steps, 0, 0, 0);
                if (!tree) return tl::unexpected(tree.error());
                tops.emplace(chunk->root(), std::move(*tree));
                if (Result<void> kept = keepBase(*chunk, more, bases); !kept) return kept;
            }
        }
        bases_ = std::move(bases);
        tops_ = std::move(tops);
    }
    for (auto& [key, tree] : tops_) roots_.emplace_back(key, std::move(tree));
    for (const auto& [key, region] : plan_->uniform()) {
        if (key.level != base) continue;
        // Nothing was built above it.
        auto tree = std::make_unique<TreeNode>();
        tree->record.active = region.active;
        tree->constant = region.value;
        for (std::size_t c = 0; c < region.value.size(); ++c) {
            const double value = toDouble(field_.info().type, region.value[c]);
            NodeRecord& record = tree->record;
            record.value_min = c == 0 ? roundDown(value) : std::min(record.value_min, roundDown(value));
            record.value_max = c == 0 ? roundUp(value) : std::max(record.value_max, roundUp(value));
            if (value != settings_.background[c])
                record.box_end.fill(std::uint8_t(options_.shape.edge_cells));
        }
        roots_.emplace_back(key, std::move(tree));
    }
    bases_.clear();
    tops_.clear();
    std::sort(roots_.begin(), roots_.end(),
              [](const auto& a, const auto& b) { return mortonLess(a.first, b.first); });
    return trimRoots();
}

// Levels above the lowest that still has one root, or roots that meet at the origin, say nothing new.
Result<void> ChannelBuilder::trimRoots() {
    while (!roots_.empty() && roots_[0].first.level > 0) {
        std::vector<NodeKey> below;
        bool all_inner = true;
        for (const auto& [key, root] : roots_) {
            all_inner = all_inner && root->valid_mask != 0;
            for (int octant = 0; octant < 8; ++octant)
                if (root->valid_mask >> octant & 1) below.push_back(key.child(octant));
        }
        if (!all_inner || !(below.size() == 1 || meetOrigin(below))) break;
        std::vector<std::pair<NodeKey, std::unique_ptr<TreeNode>>> children;
        for (auto& [key, root] : roots_) {
            if (root->unloaded > 0)
                if (Result<void> loaded = subtrees_.load(*root); !loaded) return loaded;
            std::size_t child = 0;
            for (int octant = 0; octant < 8; ++octant)
                if (root->valid_mask >> octant & 1)
                    children.emplace_back(key.child(octant), std::move(root->children[child++]));
        }
        roots_ = std::move(children);
    }
    std::sort(roots_.begin(), roots_.end(),
              [](const auto& a, const auto& b) { return mortonLess(a.first, b.first); });
    level_count_ = roots_.empty() ? 0 : roots_[0].first.level + 1;
    return {};
}

Result<void> ChannelBuilder::writeLevel(FrameWriter& writer, int l) {
    if (l >= level_count_) return {};
    Level& level = levels_[l];
    level.begin = writer.position();
    std::vector<std::byte> bytes;
    for (const auto& [at, size] : level.extents)
        for (std::uint64_t done = 0; done < size; done += bytes.size()) {
            bytes.resize(std::size_t(std::min<std::uint64_t>(kCopyBytes, size - done)));
            if (auto read = scratch_->read(at + done, bytes); !read) return read;
            if (auto stored = writer.append(bytes); !stored) return tl::unexpected(stored.error());
        }
    payload_bytes_ += level.bytes;
    bricks_ += level.bricks;
    return {};
}

// Where the payloads above level 0 came to lie; what is below a stub is told when it is loaded.
void ChannelBuilder::placePayloads(TreeNode& node, int level) const {
    if (node.unloaded > 0 && node.children.empty()) return;
    if (level > 0 && node.record.hasBrick()) node.record.payload_offset += levels_.at(level).begin;
    for (const auto& child : node.children) placePayloads(*child, level - 1);
}

Result<void> ChannelBuilder::loadPlaced(TreeNode& stub) const {
    if (Result<void> loaded = subtrees_.load(stub); !loaded) return loaded;
    placePayloads(stub, chunkSteps(options_.shape));
    return {};
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
    if (active_.voxels > 0)
        for (std::size_t a = 0; a < 3; ++a) {
            footer.add_active_min(std::int32_t(active_.box.begin[a]));
            footer.add_active_max(std::int32_t(active_.box.end[a] - 1));
        }
    footer.set_active_voxels(active_.voxels);
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
    footer.set_value_min(active_.min);
    footer.set_value_max(active_.max);
    footer.set_bricks(bricks_);
    footer.set_levels(std::uint32_t(level_count_));
    footer.set_payload_bytes(payload_bytes_);

    std::vector<std::unique_ptr<TreeNode>> roots;
    for (auto& [key, root] : roots_) {
        RootNode* out = footer.add_roots();
        out->set_level(std::uint32_t(key.level));
        out->set_x(key.x);
        out->set_y(key.y);
        out->set_z(key.z);
        placePayloads(*root, key.level);
        roots.push_back(std::move(root));
    }
    const auto encoded = encodeTree(
        roots, info.components, [this](TreeNode& stub) { return loadPlaced(stub); },
        [&](std::span<const std::byte> block, std::uint32_t raw_bytes) -> Result<void> {
            const Result<StoredBytes> stored = writer.append(block);
            if (!stored) return tl::unexpected(stored.error());
            BlockRef* ref = footer.add_blocks();
            ref->set_offset(stored->offset);
            ref->set_bytes(stored->bytes);
            ref->set_raw_bytes(raw_bytes);
            ref->set_xxh64(stored->checksum);
            return {};
        });
    if (!encoded) return tl::unexpected(encoded.error());
    return footer;
}

}  // namespace brickyard

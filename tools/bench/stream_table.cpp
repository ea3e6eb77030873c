#include "tools/bench/stream_table.h"

#include <algorithm>

#include "client/cpu/cell_walk.h"
#include "core/brick_codec.h"

namespace brickyard {

class StreamTableBuilder {
public:
    StreamTableBuilder(StreamTable& table, const BrickStore& store, const PinholeCamera& camera, double scale)
        : table_(table), channel_(*table.channel_), store_(store), scale_(scale) {
        table_.index_.resize(channel_.blockCount());
        for (std::uint32_t y = 0; y < camera.height(); ++y)
            for (std::uint32_t x = 0; x < camera.width(); ++x)
                rays_.emplace_back(camera.ray(x, y), channel_.transform());
    }

    Result<void> build() {
        table_.first_in_ray_.assign(rays_.size() + 1, 0);
        for (ray_ = 0; ray_ < rays_.size(); ++ray_) {
            cast();
            table_.first_in_ray_[ray_ + 1] = std::uint32_t(found_.size());
        }
        arrange();
        for (std::uint32_t n = 0; n < table_.nodes_.size(); ++n)
            if (Result<void> done = integrateNode(n); !done) return done;
        return {};
    }

private:
    struct Found {
        StreamStretch stretch;
        RaySpan span;
    };

    void cast() {
        const IndexRay& ray = rays_[ray_];
        const RaySpan span =
            ray.clip(channel_.clipLow(), channel_.clipHigh(), {0, std::numeric_limits<double>::infinity()});
        if (span.empty()) return;
        walkOctree(
            channel_, ray, span, [](const WalkedNode&) { return false; },
            [&](const WalkedNode& root) {
                if (root.status == WalkStatus::kNode) visit(root, StreamNode::kNoStreamNode);
                return true;
            });
    }

    void visit(const WalkedNode& node, std::uint32_t parent) {
        if (node.status != WalkStatus::kNode || !node.record().hasBrick()) {
            double value = double(channel_.background());
            if (node.status == WalkStatus::kNode)
                value = double(toFloat(channel_.type(), node.block->constant(node.ref.node)[0]));
            if (parent == StreamNode::kNoStreamNode) return;  // a root of one value: no page changes it
            const double depth = std::max(0.0, value) * scale_ * (node.span.end - node.span.begin);
            found_.push_back({{ray_, parent, 0, float(depth), true}, node.span});
            return;
        }
        const std::uint32_t at = place(node, parent);
        if (!canDescend(node)) {
            found_.push_back({{ray_, at, 0, 0, false}, node.span});
            return;
        }
        walkChildren(channel_, rays_[ray_], node, [&](const WalkedNode& child) {
            visit(child, at);
            return true;
        });
    }

    std::uint32_t place(const WalkedNode& node, std::uint32_t parent) {
        std::vector<std::uint32_t>& places = table_.index_[node.ref.block];
        if (places.empty()) places.assign(node.block->nodeCount(), StreamNode::kNoStreamNode);
        std::uint32_t& at = places[node.ref.node];
        if (at != StreamNode::kNoStreamNode) return at;
        at = std::uint32_t(table_.nodes_.size());
        StreamNode& added = table_.nodes_.emplace_back();
        added.ref = node.ref;
        added.key = node.key;
        added.parent = parent;
        added.depth = parent == StreamNode::kNoStreamNode ? 0 : table_.nodes_[parent].depth + 1;
        added.payload_bytes = node.record().payload_bytes;
        added.draft_bytes = node.record().draft_bytes;
        return at;
    }

    // Stretches of a subtree become neighbours, those of the node itself first.
    void arrange() {
        std::vector<StreamNode>& nodes = table_.nodes_;
        std::vector<std::uint32_t> own(nodes.size(), 0), all(nodes.size(), 0);
        for (const Found& found : found_) ++own[found.stretch.node];
        for (std::size_t i = nodes.size(); i-- > 0;) {
            all[i] += own[i];
            if (nodes[i].parent != StreamNode::kNoStreamNode) all[nodes[i].parent] += all[i];
        }
        std::uint32_t total = 0;
        std::vector<std::uint32_t> next(nodes.size());
        for (std::size_t i = 0; i < nodes.size(); ++i) {
            std::uint32_t& place =
                nodes[i].parent == StreamNode::kNoStreamNode ? total : next[nodes[i].parent];
            nodes[i].begin = place;
            nodes[i].own_end = next[i] = nodes[i].begin + own[i];
            nodes[i].end = place += all[i];
        }
        for (std::size_t i = 0; i < nodes.size(); ++i) next[i] = nodes[i].begin;
        table_.stretches_.resize(found_.size());
        table_.ends_.resize(found_.size());
        table_.ray_order_.resize(found_.size());
        spans_.resize(found_.size());
        std::uint32_t values = 0;
        for (std::size_t i = 0; i < found_.size(); ++i) {
            const std::uint32_t at = next[found_[i].stretch.node]++;
            table_.stretches_[at] = found_[i].stretch;
            table_.stretches_[at].values = values;
            const StreamNode& node = nodes[found_[i].stretch.node];
            values += node.depth + 1 + (node.draft_bytes > 0 ? 1 : 0);
            spans_[at] = found_[i].span;
            table_.ends_[at] = float(found_[i].span.end);
            table_.ray_order_[i] = at;
        }
        table_.values_.assign(values, 0);
        found_ = {};
    }

    Result<void> integrateNode(std::uint32_t n) {
        const StreamNode& node = table_.nodes_[n];
        const NodeRecord& record = channel_.block(node.ref.block)->record(node.ref.node);
        Result<std::vector<std::byte>> payload = store_.readPayload(record, toString(node.key));
        if (!payload) return tl::unexpected(payload.error());
        samples_.resize(channel_.shape().samples());
        const SampleType type = levelType(channel_.type(), node.key.level);
        if (auto done = decodeBrickToFloat(*payload, channel_.shape(), type, 1, samples_); !done) return done;
        integrate(node, record, node.depth);
        if (!record.hasDraft()) return {};
        payload->resize(record.draft_bytes);
        if (auto done = decodeDraftToFloat(*payload, channel_.shape(), type, 1, samples_); !done) return done;
        integrate(node, record, node.depth + 1);
        return {};
    }

    void integrate(const StreamNode& node, const NodeRecord& record, std::uint32_t slot) {
        const double background = std::max(0.0, double(channel_.background()));
        for (std::uint32_t s = node.begin; s < node.end; ++s) {
            const StreamStretch& stretch = table_.stretches_[s];
            double sum = 0, inside = 0;
            walkCells(samples_.data(), channel_.shape(), node.key, record, rays_[stretch.ray], spans_[s],
                      [&](const Cell& cell, const glm::dvec3& from, const glm::dvec3& to, double begin,
                          double end) {
                          sum += meanPositive(cell, from, to) * (end - begin);
                          inside += end - begin;
                      });
            sum += background * (spans_[s].end - spans_[s].begin - inside);
            table_.values_[stretch.values + slot] = float(sum * scale_);
        }
    }

    StreamTable& table_;
    const PagedChannel& channel_;
    const BrickStore& store_;
    const double scale_;
    std::vector<IndexRay> rays_;
    std::uint32_t ray_ = 0;
    std::vector<Found> found_;
    std::vector<RaySpan> spans_;  // beside stretches_
    std::vector<float> samples_;
};

Result<StreamTable> StreamTable::create(const BrickStore& store, std::uint32_t channel_index,
                                        const PinholeCamera& camera, double scale) {
    const FrameFooter& footer = store.footer();
    Result<PagedChannel> channel = PagedChannel::create(footer.channels(int(channel_index)), channel_index,
                                                        int(footer.brick_edge()), store.fileBytes());
    if (!channel) return tl::unexpected(channel.error());
    StreamTable table;
    table.channel_ = std::make_unique<PagedChannel>(std::move(*channel));
    for (std::uint32_t b = 0; b < table.channel_->blockCount(); ++b) {
        Result<std::vector<std::byte>> stored = store.readBlock(channel_index, b);
        if (!stored) return tl::unexpected(stored.error());
        if (Result<void> added = table.channel_->addBlock(b, *stored); !added)
            return tl::unexpected(added.error());
    }
    StreamTableBuilder builder(table, store, camera, scale);
    if (Result<void> built = builder.build(); !built) return tl::unexpected(built.error());
    return table;
}

std::uint32_t StreamTable::find(const NodeRef& ref) const {
    if (ref.block >= index_.size() || ref.node >= index_[ref.block].size()) return StreamNode::kNoStreamNode;
    return index_[ref.block][ref.node];
}

}  // namespace brickyard

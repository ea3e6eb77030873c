#include "tools/dataset_check.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <mutex>
#include <set>

#include "core/dataset.h"
#include "core/frame_format.h"
#include "core/printable_name.h"
#include "core/sample_conversion.h"
#include "tools/field_reader.h"

namespace brickyard {
namespace {

// What a stretch of a frame file belongs to.
struct Stretch {
    std::uint64_t begin, end;
    std::string owner;
};

class FrameCheck {
public:
    FrameCheck(std::shared_ptr<const BrickStore> store, const ParallelFor& parallel_for, CheckReport& report)
        : store_(std::move(store)), parallel_for_(parallel_for), report_(report) {}

    void run() {
        checkEnds();
        for (int c = 0; c < store_->footer().channels_size(); ++c) checkChannel(std::uint32_t(c));
        checkTiling();
    }

private:
    void add(CheckFault fault) {
        fault.file = store_->path().string();
        const std::lock_guard lock(mutex_);
        report_.faults.push_back(std::move(fault));
    }
    void add(const std::string& channel, const std::string& node, std::uint64_t begin, std::uint64_t end,
             const std::string& what) {
        std::string place;
        if (!channel.empty()) place += fmt::format("channel '{}', ", printableName(channel));
        if (!node.empty()) place += fmt::format("{}, ", node);
        add({{},
             channel,
             node,
             begin,
             end,
             fmt::format("{}: {}bytes [{}, {}): {}; convert this frame again", store_->path().string(), place,
                         begin, end, what)});
    }

    // The header says the same as the trailer; BrickStore::open has believed only the trailer.
    void checkEnds() {
        using namespace frame_format;
        std::array<std::byte, kHeaderBytes> start{};
        std::array<std::byte, kTrailerBytes> tail{};
        const std::uint64_t size = store_->fileBytes();
        if (::pread(store_->descriptor(), start.data(), start.size(), 0) != ssize_t(start.size()) ||
            ::pread(store_->descriptor(), tail.data(), tail.size(), off_t(size - tail.size())) !=
                ssize_t(tail.size()))
            return add({}, {}, 0, size, "cannot be read");
        const auto trailer = decodeTrailer(tail);
        if (!trailer) return add({}, {}, size - kTrailerBytes, size, "the trailer changed while it was read");
        auto expected = header();
        put(expected.data() + 8, std::uint16_t(trailer->major));
        put(expected.data() + 10, std::uint16_t(trailer->minor));
        if (start != expected)
            add({}, {}, 0, kHeaderBytes, "the header is wrong, or tells another version than the trailer");
        stretches_.push_back({0, kHeaderBytes, "the header"});
        stretches_.push_back({trailer->footer_offset, size, "the footer and trailer"});
    }

    void checkChannel(std::uint32_t index) {
        // Bricks are looked at once each: there is nothing to keep.
        const FieldReader reader(store_, index, /*cache_bytes=*/0);
        const ChannelFooter& channel = reader.channel();
        ++report_.channels;
        readable_ = true;
        std::vector<bool> sound_blocks(std::size_t(channel.blocks_size()), true);
        for (int b = 0; b < channel.blocks_size(); ++b) {
            const BlockRef& ref = channel.blocks(b);
            ++report_.blocks;
            stretches_.push_back({ref.offset(), ref.offset() + ref.bytes(), "a tree block"});
            if (const auto loaded = store_->loadBlock(index, std::uint32_t(b)); !loaded) {
                readable_ = all_readable_ = false;
                add({{},
                     channel.name(),
                     fmt::format("tree block {}", b),
                     ref.offset(),
                     ref.offset() + ref.bytes(),
                     loaded.error().message});
            }
        }
        const std::vector<FieldNode> nodes = collectNodes(reader);
        checkNodes(reader, nodes);
    }

    // Every node below the roots, each once: a damaged tree may refer to a node twice, or eight to the power
    // of 31 times.
    std::vector<FieldNode> collectNodes(const FieldReader& reader) {
        std::vector<FieldNode> nodes, waiting;
        std::set<std::pair<std::uint32_t, std::uint32_t>> met;
        if (auto roots = reader.roots())
            waiting = std::move(*roots);
        else if (readable_)
            add({{}, reader.channel().name(), {}, 0, 0, roots.error().message});
        while (!waiting.empty()) {
            FieldNode node = std::move(waiting.back());
            waiting.pop_back();
            if (!met.insert({node.block, node.node}).second) {
                add(reader.channel().name(), toString(node.key), 0, 0, "the tree refers to this node twice");
                continue;
            }
            if (!node.isLeaf())
                for (int octant = 7; octant >= 0; --octant) {
                    if (!(node.validMask() >> octant & 1)) continue;
                    auto child = reader.child(node, octant);
                    if (child)
                        waiting.push_back(std::move(*child));
                    else if (readable_)
                        add({{}, reader.channel().name(), toString(node.key), 0, 0, child.error().message});
                }
            nodes.push_back(std::move(node));
        }
        return nodes;
    }

    void checkNodes(const FieldReader& reader, const std::vector<FieldNode>& nodes) {
        const ChannelFooter& channel = reader.channel();
        std::uint64_t bricks = 0, payload_bytes = 0;
        // Modulo 2^64, as the footer's count: a region of one value may have 2^96 voxels.
        std::uint64_t active = 0;
        std::set<std::uint64_t> offsets;
        for (const FieldNode& node : nodes) {
            const NodeRecord& record = node.record();
            if (record.hasBrick()) {
                ++bricks;
                payload_bytes += record.payload_bytes;
                // Equal bricks may share their bytes.
                if (offsets.insert(record.payload_offset).second)
                    stretches_.push_back({record.payload_offset, record.payload_offset + record.payload_bytes,
                                          reader.describe(node.key)});
            }
            if (node.isLeaf() && (node.key.level > 0 || !record.hasBrick()) && record.active) {
                const std::uint64_t edge = std::uint64_t(reader.shape().edge_cells) << node.key.level;
                active += edge * edge * edge;
            }
        }
        report_.bricks += bricks;

        bool damaged = false;
        parallel_for_(nodes.size(), [&](std::size_t i) {
            const FieldNode& node = nodes[i];
            if (!node.record().hasBrick()) return;
            std::uint64_t states = 0;
            const bool sound = checkBrick(reader, node, states);
            const std::lock_guard lock(mutex_);
            active += states;
            damaged = damaged || !sound;
        });

        // With a part missing, sums say nothing new.
        if (!readable_ || damaged) return;
        if (bricks != channel.bricks() || payload_bytes != channel.payload_bytes())
            add(channel.name(), {}, 0, 0,
                fmt::format("the tree has {} bricks of {} bytes, the footer says {} of {}", bricks,
                            payload_bytes, channel.bricks(), channel.payload_bytes()));
        if (active != channel.active_voxels())
            add(channel.name(), {}, 0, 0,
                fmt::format("{} voxels are active, the footer says {}", active, channel.active_voxels()));
    }

    // `states` receives the active voxels of a brick of level 0.
    bool checkBrick(const FieldReader& reader, const FieldNode& node, std::uint64_t& states) {
        const NodeRecord& record = node.record();
        const std::uint64_t begin = record.payload_offset, end = begin + record.payload_bytes;
        const auto brick = reader.brick(node);
        if (!brick) {
            add({{}, reader.channel().name(), toString(node.key), begin, end, brick.error().message});
            return false;
        }
        const DecodedBrick& decoded = **brick;
        std::vector<double> values;
        samplesToDouble(decoded.type, decoded.values, values);
        for (const double stored : values) {
            // Ranges are floats: what lies beyond them is recorded as the largest float. NaN is outside of
            // any.
            const double value = std::clamp(stored, -double(FLT_MAX), double(FLT_MAX));
            if (value >= double(record.value_min) && value <= double(record.value_max)) continue;
            add(reader.channel().name(), toString(node.key), begin, end,
                fmt::format("holds {}, outside the range [{}, {}] of its node", stored, record.value_min,
                            record.value_max));
            return false;
        }
        if (node.key.level == 0 && !decoded.active.empty())
            states = std::uint64_t(std::count(decoded.active.begin(), decoded.active.end(), std::uint8_t(1)));
        else if (node.key.level == 0 && record.active)
            states = reader.shape().cells();
        return true;
    }

    // Header, payloads, tree blocks and footer follow each other without a gap: every byte is under some
    // check.
    void checkTiling() {
        report_.bytes += store_->fileBytes();
        if (!all_readable_) return;
        std::sort(stretches_.begin(), stretches_.end(),
                  [](const Stretch& a, const Stretch& b) { return a.begin < b.begin; });
        std::uint64_t at = 0;
        for (const Stretch& stretch : stretches_) {
            if (stretch.begin > at) add({}, {}, at, stretch.begin, "these bytes belong to nothing");
            if (stretch.begin < at)
                add({}, {}, stretch.begin, std::min(at, stretch.end),
                    fmt::format("{} overlaps what stands before it", stretch.owner));
            at = std::max(at, stretch.end);
        }
        if (at != store_->fileBytes()) add({}, {}, at, store_->fileBytes(), "these bytes belong to nothing");
    }

    std::shared_ptr<const BrickStore> store_;
    const ParallelFor& parallel_for_;
    CheckReport& report_;
    std::mutex mutex_;
    std::vector<Stretch> stretches_;
    bool readable_ = true;      // the tree of the channel at hand
    bool all_readable_ = true;  // those of all channels
};

}  // namespace

CheckReport checkDataset(const std::filesystem::path& folder, const ParallelFor& parallel_for,
                         const std::function<void(std::size_t, std::size_t, std::uint64_t)>& progress) {
    CheckReport report;
    const std::string manifest_file = (folder / kManifestName).string();
    const auto dataset = Dataset::open(folder);
    if (!dataset) {
        report.faults.push_back({manifest_file, {}, {}, 0, 0, dataset.error().message});
        return report;
    }
    const Manifest& manifest = dataset->manifest();
    if (manifest.checksum().empty())
        report.faults.push_back(
            {manifest_file,
             {},
             {},
             0,
             0,
             fmt::format("{}: has no checksum: it was damaged or edited; convert this dataset again",
                         manifest_file)});
    std::size_t done = 0;
    for (const FrameEntry& entry : manifest.frames()) {
        ++report.frames;
        const auto store = dataset->openFrame(entry.frame());
        if (store)
            FrameCheck(*store, parallel_for, report).run();
        else
            report.faults.push_back({(folder / entry.file()).string(), {}, {}, 0, 0, store.error().message});
        if (progress) progress(++done, std::size_t(manifest.frames_size()), report.bytes);
    }
    std::sort(report.faults.begin(), report.faults.end(), [](const CheckFault& a, const CheckFault& b) {
        return std::tie(a.file, a.begin, a.message) < std::tie(b.file, b.begin, b.message);
    });
    return report;
}

}  // namespace brickyard

#include "tiny_dataset.h"

#include <unistd.h>

#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>

#include "core/dataset.h"
#include "core/dataset_writer.h"
#include "core/frame_writer.h"
#include "core/tree_block_encoder.h"

namespace brickyard {
namespace {

// Test data that cannot be made is no test failure but a broken machine.
template <class T>
T need(Result<T> result) {
    if (!result) {
        std::fprintf(stderr, "tiny dataset: %s\n", result.error().message.c_str());
        std::abort();
    }
    if constexpr (!std::is_void_v<T>) return std::move(*result);
}

std::vector<std::byte> payloadOf(std::uint32_t channel, std::uint32_t number, std::uint32_t bytes) {
    std::vector<std::byte> payload(bytes);
    std::uint64_t state = (std::uint64_t(channel) << 32 | number) * 0x9e3779b97f4a7c15ull + 1;
    for (std::byte& byte : payload) {
        state = state * 6364136223846793005ull + 1442695040888963407ull;
        byte = std::byte(state >> 56);
    }
    return payload;
}

class TreeMaker {
public:
    TreeMaker(FrameWriter& writer, std::uint32_t channel, const TinyOptions& options)
        : writer_(writer), channel_(channel), options_(options) {}

    std::unique_ptr<TreeNode> make(int level) {
        auto node = std::make_unique<TreeNode>();
        node->record.bound = level == 0 ? 0 : std::ldexp(1.0f, level);
        node->record.rms = node->record.bound / 2;
        node->record.value_max = 1;
        node->record.box_end = {8, 8, 8};
        if (level > 0) {
            node->valid_mask = 0xff;
            for (int octant = 0; octant < 8; ++octant)
                node->children.push_back(level == options_.levels - 1 && octant == 7 ? constant()
                                                                                     : make(level - 1));
        }
        const auto payload = payloadOf(channel_, number_++, options_.payload_bytes);
        const auto stored = need(writer_.append(payload));
        node->record.payload_offset = stored.offset;
        node->record.payload_bytes = stored.bytes;
        node->record.payload_checksum = stored.checksum;
        return node;
    }
    std::uint32_t bricks() const { return number_; }

private:
    static std::unique_ptr<TreeNode> constant() {
        auto node = std::make_unique<TreeNode>();
        node->constant = {0};
        node->record.box_end = {0, 0, 0};
        return node;
    }

    FrameWriter& writer_;
    const std::uint32_t channel_;
    const TinyOptions& options_;
    std::uint32_t number_ = 0;
};

void addChannel(FrameWriter& writer, std::uint32_t index, const TinyOptions& options, FrameFooter& footer) {
    TreeMaker maker(writer, index, options);
    std::vector<std::unique_ptr<TreeNode>> roots;
    roots.push_back(maker.make(options.levels - 1));
    std::vector<std::uint32_t> raw_bytes;
    const auto blocks = encodeTree(roots, 1, raw_bytes);

    ChannelFooter& channel = *footer.add_channels();
    channel.set_name(options.channels[index]);
    channel.set_sample_type(SAMPLE_TYPE_FLOAT32);
    channel.set_components(1);
    channel.add_background(0);
    for (int i = 0; i < 16; ++i) channel.add_index_to_world(i % 5 == 0 ? 1 : 0);
    for (int a = 0; a < 3; ++a) {
        channel.add_active_min(0);
        channel.add_active_max((8 << (options.levels - 1)) - 1);
    }
    channel.set_active_voxels(1);
    channel.set_grid_class("fog volume");
    channel.set_value_max(1);
    channel.set_bricks(maker.bricks());
    channel.set_levels(std::uint32_t(options.levels));
    channel.add_roots()->set_level(std::uint32_t(options.levels - 1));
    for (std::size_t b = 0; b < blocks.size(); ++b) {
        const auto stored = need(writer.append(blocks[b]));
        BlockRef& ref = *channel.add_blocks();
        ref.set_offset(stored.offset);
        ref.set_bytes(stored.bytes);
        ref.set_raw_bytes(raw_bytes[b]);
        ref.set_xxh64(stored.checksum);
    }
}

}  // namespace

TinyDataset::TinyDataset(const std::string& name, const TinyOptions& options)
    : first_frame_(options.frames.front()) {
    static std::atomic<int> count{0};
    scratch_ = std::filesystem::temp_directory_path() /
               ("brickyard-tiny-" + std::to_string(::getpid()) + "-" + std::to_string(count++));
    std::filesystem::create_directories(scratch_);
    folder_ = scratch_ / (name + ".bricks");

    Manifest settings;
    settings.set_format_major(kFormatMajor);
    settings.set_format_minor(kFormatMinor);
    settings.set_brick_edge(8);
    settings.set_writer("test");
    settings.set_nonfinite("reject");
    auto dataset = need(DatasetWriter::open(folder_, settings, ExistingDataset::kContinue));
    for (const std::uint32_t frame : options.frames) {
        const auto file = need(dataset->temporaryFrame(frame));
        auto writer = need(FrameWriter::create(file));
        FrameFooter footer;
        footer.set_brick_edge(8);
        footer.set_coarse_begin(writer->position());
        for (std::uint32_t c = 0; c < options.channels.size(); ++c) addChannel(*writer, c, options, footer);
        const auto finished = need(writer->finish(footer));
        FrameEntry entry;
        entry.set_frame(frame);
        entry.set_file_bytes(finished.file_bytes);
        entry.set_footer_xxh64(finished.footer_checksum);
        for (const ChannelFooter& channel : footer.channels()) {
            ChannelSummary& summary = *entry.add_channels();
            summary.set_name(channel.name());
            summary.set_sample_type(channel.sample_type());
            summary.set_components(channel.components());
            *summary.mutable_index_to_world() = channel.index_to_world();
            *summary.mutable_active_min() = channel.active_min();
            *summary.mutable_active_max() = channel.active_max();
            summary.set_levels(channel.levels());
        }
        need(dataset->commitFrame(file, entry));
    }
    need(dataset->finish());
}

TinyDataset::~TinyDataset() {
    std::error_code ignored;
    std::filesystem::remove_all(scratch_, ignored);
}

std::vector<PageAddress> TinyDataset::bricks(std::uint32_t channel) const {
    std::vector<PageAddress> found;
    for (std::uint32_t b = 0; b < blockCount(channel); ++b) {
        const TreeBlock block = need(store()->loadBlock(channel, b));
        for (std::uint32_t n = 0; n < block.nodeCount(); ++n)
            if (block.record(n).hasBrick()) found.push_back({channel, b, n});
    }
    return found;
}

std::vector<std::byte> TinyDataset::payload(const PageAddress& brick) const {
    const TreeBlock block = need(store()->loadBlock(brick.channel, brick.block));
    return need(store()->readPayload(block.record(brick.node), "test"));
}

std::uint32_t TinyDataset::blockCount(std::uint32_t channel) const {
    return std::uint32_t(store()->footer().channels(int(channel)).blocks_size());
}

std::shared_ptr<const BrickStore> TinyDataset::store() const {
    return need(need(Dataset::open(folder_)).openFrame(first_frame_));
}

}  // namespace brickyard

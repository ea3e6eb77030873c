#include "core/octree_builder.h"

#include <algorithm>
#include <cassert>

#include "core/channel_builder.h"
#include "core/first_error.h"

namespace brickyard {

namespace {

// Chunks on their way at once, where memory does not tell.
constexpr std::size_t kMostChunks = 4;
constexpr std::uint64_t kDefaultMemory = std::uint64_t(512) << 20;
constexpr std::uint64_t kMostScratchMemory = std::uint64_t(256) << 20;

// Works through the level-0 chunks of all channels, in batches: while one batch is measured and encoded, the
// batch before it is written and the next one is read.
class FinestPass {
public:
    FinestPass(std::vector<std::unique_ptr<ChannelBuilder>>& channels, const BuildOptions& options,
               FrameWriter& writer)
        : channels_(channels), options_(options), writer_(writer) {}

    Result<void> run() {
        Batch done, current, next;
        // The first time there is nothing but channels to plan.
        do {
            encodeCoarse(current);
            next = take();
            if (Result<void> result = overlap(done, current, next); !result) return result;
            done = std::move(current);
            current = std::move(next);
            next = Batch();
            if (options_.progress) options_.progress(taken_ - current.size(), planned_);
        } while (!done.empty() || !current.empty() || channel_ < channels_.size());
        return {};
    }

private:
    struct Item {
        ChannelBuilder* channel = nullptr;
        std::unique_ptr<Chunk> chunk;
    };
    using Batch = std::vector<Item>;

    Batch take() {
        const std::uint64_t memory = options_.memory_bytes > 0 ? options_.memory_bytes : kDefaultMemory;
        // Two batches are on their way, and half of the memory is for other things.
        std::uint64_t left = memory / 4;
        Batch batch;
        while (batch.size() < kMostChunks && channel_ < planned_channels_) {
            ChannelBuilder& channel = *channels_[channel_];
            if (chunk_ == channel.chunkCount()) {
                ++channel_;
                chunk_ = 0;
                continue;
            }
            if (!batch.empty() && channel.chunkBytes() > left) break;
            left -= std::min(left, channel.chunkBytes());
            batch.push_back({&channel, channel.chunk(chunk_++)});
            ++taken_;
        }
        return batch;
    }

    void encodeCoarse(Batch& batch) {
        std::vector<std::pair<Chunk*, std::size_t>> pieces;
        for (const Item& item : batch)
            for (std::size_t i = 0; i < item.chunk->coarseCount(); ++i)
                pieces.emplace_back(item.chunk.get(), i);
        options_.parallel_for(pieces.size(),
                              [&](std::size_t i) { pieces[i].first->encodeCoarse(pieces[i].second); });
    }

    // Writes `done`, plans channels, reads `next`, measures and encodes `current`: all at once. The long
    // pieces come first.
    Result<void> overlap(Batch& done, Batch& current, Batch& next) {
        std::vector<std::pair<Chunk*, std::size_t>> pieces;
        for (const Item& item : current)
            for (std::size_t i = 0; i < item.chunk->measureCount(); ++i)
                pieces.emplace_back(item.chunk.get(), i);
        const std::size_t plan_end = std::min(channels_.size(), channel_ + 1 + channelsAhead());
        const std::size_t plans = plan_end > planned_channels_ ? plan_end - planned_channels_ : 0;
        const std::size_t reads = 1 + plans, measures = reads + next.size();
        FirstError first;
        options_.parallel_for(measures + pieces.size(), [&](std::size_t i) {
            if (i == 0)
                first.add(i, write(done));
            else if (i < reads)
                first.add(i, channels_[planned_channels_ + i - 1]->plan());
            else if (i < measures)
                first.add(i, next[i - reads].chunk->readField());
            else
                pieces[i - measures].first->measure(pieces[i - measures].second);
        });
        done.clear();
        if (Result<void> result = first.result(); !result) return result;
        for (std::size_t i = 0; i < plans; ++i) planned_ += channels_[planned_channels_++]->chunkCount();
        return {};
    }

    // A planned channel may keep an index of its source in memory.
    std::size_t channelsAhead() const {
        return options_.memory_bytes > 0 && options_.memory_bytes < kDefaultMemory ? 2 : 8;
    }

    Result<void> write(Batch& batch) {
        for (Item& item : batch) {
            item.chunk->finish();
            if (Result<void> committed = item.channel->commitFinest(*item.chunk, writer_); !committed)
                return committed;
            item.chunk.reset();
        }
        return {};
    }

    std::vector<std::unique_ptr<ChannelBuilder>>& channels_;
    const BuildOptions& options_;
    FrameWriter& writer_;
    std::size_t planned_channels_ = 0, channel_ = 0, chunk_ = 0;
    std::size_t planned_ = 0, taken_ = 0;
};

}  // namespace

Result<FrameFooter> buildFrame(std::span<const FieldSource* const> channels,
                               std::span<const BuildOptions> options, FrameWriter& writer) {
    assert(channels.size() == options.size());
    FrameFooter footer;
    if (channels.empty()) return footer;
    const BuildOptions& common = options[0];
    ScratchFile scratch(
        common.scratch_folder,
        std::size_t(common.memory_bytes > 0 ? std::min(kMostScratchMemory, common.memory_bytes / 8)
                                            : kMostScratchMemory));
    BufferPool buffers;
    std::vector<std::unique_ptr<ChannelBuilder>> builders;
    for (std::size_t c = 0; c < channels.size(); ++c) {
        Result<std::unique_ptr<ChannelBuilder>> builder =
            ChannelBuilder::create(*channels[c], options[c], scratch, buffers);
        if (!builder) return tl::unexpected(builder.error());
        builders.push_back(std::move(*builder));
    }

    // Finest first: whatever a cold reader wants soon stands together at the end of the file.
    if (Result<void> written = FinestPass(builders, common, writer).run(); !written)
        return tl::unexpected(written.error());
    int levels = 0;
    for (const auto& builder : builders) {
        if (Result<void> built = builder->buildTiers(common.parallel_for); !built)
            return tl::unexpected(built.error());
        levels = std::max(levels, builder->levelCount());
    }
    footer.set_coarse_begin(writer.position());
    for (int level = 1; level < levels; ++level)
        for (const auto& builder : builders)
            if (Result<void> written = builder->writeLevel(writer, level); !written)
                return tl::unexpected(written.error());
    for (const auto& builder : builders) {
        Result<ChannelFooter> channel = builder->writeTree(writer);
        if (!channel) return tl::unexpected(channel.error());
        *footer.add_channels() = std::move(*channel);
    }
    footer.set_brick_edge(std::uint32_t(common.shape.edge_cells));
    return footer;
}

}  // namespace brickyard

#include "tools/bench/codec_samples.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "tools/importers/input_file.h"

namespace brickyard {
namespace {

class ChannelReader {
public:
    ChannelReader(const FieldSource& field, BrickShape shape) : field_(field), shape_(shape) {}

    Result<CodecChannel> read(std::size_t most_bytes) {
        findBricks();
        CodecChannel channel;
        channel.name = field_.info().name;
        channel.shape = {shape_.edgeSamples(), field_.info().components};
        channel.background = field_.info().background;
        const std::size_t most =
            std::max<std::size_t>(most_bytes / (channel.shape.samples() * sizeof(float)), 1);
        const std::size_t every = (places_.size() + most - 1) / most;
        double least = std::numeric_limits<double>::infinity(), greatest = -least;
        double active_least = least, active_greatest = greatest;
        SampleBlock block;
        for (std::size_t i = 0; i < places_.size(); i += every) {
            if (Result<void> read = field_.read(places_[i], block); !read)
                return tl::unexpected(read.error());
            std::vector<float> values(channel.shape.samples());
            std::memcpy(values.data(), block.values.data(), values.size() * sizeof(float));
            const auto [low, high] = std::minmax_element(values.begin(), values.end());
            const bool finite =
                std::all_of(values.begin(), values.end(), [](float v) { return std::isfinite(v); });
            // The octree stores a brick of one value without a payload.
            if (!finite || *low == *high) continue;
            least = std::min(least, double(*low));
            greatest = std::max(greatest, double(*high));
            for (std::size_t v = 0; v < values.size(); ++v) {
                if (block.active[v % shape_.samples()] == 0) continue;
                active_least = std::min(active_least, double(values[v]));
                active_greatest = std::max(active_greatest, double(values[v]));
            }
            channel.bricks.push_back(std::move(values));
        }
        channel.places = places_.size();
        channel.least = least;
        channel.greatest = greatest;
        channel.active_least = active_least;
        channel.active_greatest = active_greatest;
        return channel;
    }

private:
    // From the octants of the whole lattice down to bricks, as the octree is built: what a source knows to be
    // of one value is never looked at.
    void findBricks() {
        const std::int64_t edge = std::int64_t(1) << 31;
        for (int octant = 0; octant < 8; ++octant)
            descend({octant & 1 ? 0 : -edge, octant & 2 ? 0 : -edge, octant & 4 ? 0 : -edge}, edge);
    }

    void descend(const Index3& begin, std::int64_t edge) {
        const IndexBox box{begin, {begin[0] + edge + 1, begin[1] + edge + 1, begin[2] + edge + 1}};
        if (field_.uniformOver(box)) return;
        if (edge == shape_.edge_cells) {
            places_.push_back(box);
            return;
        }
        const std::int64_t half = edge / 2;
        for (int octant = 0; octant < 8; ++octant)
            descend({begin[0] + (octant & 1) * half, begin[1] + (octant >> 1 & 1) * half,
                     begin[2] + (octant >> 2) * half},
                    half);
    }

    const FieldSource& field_;
    BrickShape shape_;
    std::vector<IndexBox> places_;
};

}  // namespace

Result<std::vector<CodecChannel>> readCodecChannels(const std::filesystem::path& file, BrickShape shape,
                                                    std::size_t most_bytes) {
    const Result<InputContents> contents = openInput(file, {});
    if (!contents) return tl::unexpected(contents.error());
    std::vector<CodecChannel> channels;
    for (const std::unique_ptr<FieldSource>& field : contents->fields) {
        if (field->info().type != SampleType::kFloat32) continue;
        Result<CodecChannel> channel = ChannelReader(*field, shape).read(most_bytes);
        if (!channel) return tl::unexpected(channel.error());
        if (!channel->bricks.empty() && channel->range() > 0) channels.push_back(std::move(*channel));
    }
    return channels;
}

}  // namespace brickyard

#include "tools/frame_forecast.h"

#include <fmt/format.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <random>

#include "core/io_error.h"
#include "tools/level_summary.h"

namespace brickyard {
namespace {

// Two levels above its bricks lie inside a region; what is above those is a hundredth of the whole.
constexpr int kRegionLevel = 2;
constexpr std::size_t kRegions = 40;

// Non-uniform regions of a field, aligned to multiples of their edge.
class RegionSearch {
public:
    RegionSearch(const FieldSource& field, std::int64_t edge) : field_(field), edge_(edge) {
        // From the eight octants of all int32, whose edges are `edge` times a power of two.
        constexpr std::int64_t kHalf = std::int64_t(1) << 31;
        for (int octant = 0; octant < 8; ++octant)
            visit({octant & 1 ? 0 : -kHalf, octant & 2 ? 0 : -kHalf, octant & 4 ? 0 : -kHalf}, kHalf);
    }
    std::vector<Index3> take() { return std::move(found_); }

private:
    void visit(const Index3& corner, std::int64_t edge) {
        // A brick has a layer more than its cells.
        if (field_.uniformOver({corner, {corner[0] + edge + 1, corner[1] + edge + 1, corner[2] + edge + 1}}))
            return;
        if (edge <= edge_) {
            found_.push_back(corner);
            return;
        }
        for (int octant = 0; octant < 8; ++octant) {
            Index3 child = corner;
            for (std::size_t a = 0; a < 3; ++a) child[a] += octant >> a & 1 ? edge / 2 : 0;
            visit(child, edge / 2);
        }
    }

    const FieldSource& field_;
    std::int64_t edge_;
    std::vector<Index3> found_;
};

// The field, but background wherever no brick of the chosen regions needs it.
class SampledField final : public FieldSource {
public:
    SampledField(const FieldSource& source, std::vector<Index3> corners, std::int64_t edge)
        : source_(source), corners_(std::move(corners)), edge_(edge) {}

    const ChannelInfo& info() const override { return source_.info(); }
    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override {
        for (const Index3& corner : corners_) {
            // Without its first layer: the bricks below need that too, and are not of the region.
            const IndexBox own{{corner[0] + 1, corner[1] + 1, corner[2] + 1},
                               {corner[0] + edge_, corner[1] + edge_, corner[2] + edge_}};
            if (!intersect(box, own).empty()) return source_.uniformOver(box);
        }
        return UniformRegion{source_.info().background, false};
    }
    Result<void> read(const IndexBox& box, SampleBlock& out) const override { return source_.read(box, out); }
    bool prefersRows() const override { return source_.prefersRows(); }
    void release() const override { source_.release(); }

private:
    const FieldSource& source_;
    std::vector<Index3> corners_;
    std::int64_t edge_;
};

// A file in memory, by a path that any code can open while this lives.
class MemoryFile {
public:
    MemoryFile() : descriptor_(::memfd_create("brickyard-forecast", MFD_CLOEXEC)) {}
    ~MemoryFile() {
        if (descriptor_ >= 0) ::close(descriptor_);
    }
    MemoryFile(const MemoryFile&) = delete;
    MemoryFile& operator=(const MemoryFile&) = delete;
    bool isOpen() const { return descriptor_ >= 0; }
    std::filesystem::path path() const { return fmt::format("/proc/self/fd/{}", descriptor_); }

private:
    int descriptor_;
};

Result<FrameForecast> forecastChannel(const FieldSource& field, BuildOptions options) {
    options.progress = nullptr;
    const auto started = std::chrono::steady_clock::now();
    const auto secondsSince = [&] {
        return std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
    };
    const std::int64_t edge = std::int64_t(options.shape.edge_cells) << kRegionLevel;
    std::vector<Index3> regions = RegionSearch(field, edge).take();
    const std::size_t all = regions.size();
    const double search_seconds = secondsSince();
    std::shuffle(regions.begin(), regions.end(), std::mt19937(1));
    // Half more than the sample is no saving.
    if (all > kRegions + kRegions / 2) regions.resize(kRegions);
    const double scale = regions.empty() ? 1 : double(all) / double(regions.size());
    const bool whole = regions.size() == all;
    const SampledField sampled(field, std::move(regions), edge);

    const MemoryFile file;
    if (!file.isOpen()) return ioError("create", "a file in memory", errno);
    auto writer = FrameWriter::create(file.path());
    if (!writer) return tl::unexpected(writer.error());
    const FieldSource* const sources[] = {whole ? &field : static_cast<const FieldSource*>(&sampled)};
    auto footer = buildFrame(sources, std::span(&options, 1), **writer);
    if (!footer) return tl::unexpected(footer.error());
    const auto finished = (*writer)->finish(*footer);
    if (!finished) return tl::unexpected(finished.error());

    FrameForecast forecast;
    forecast.sampled = 1 / scale;
    forecast.seconds = search_seconds + (secondsSince() - search_seconds) * scale;
    forecast.bytes = double(finished->file_bytes);
    if (whole) return forecast;
    const auto store = BrickStore::open(file.path());
    if (!store) return tl::unexpected(store.error());
    const auto levels = summarizeLevels(FieldReader(*store, 0));
    if (!levels) return tl::unexpected(levels.error());
    // Each region brought its own branch up to the root; the whole frame shares those.
    double inside = 0, nodes = 0, all_nodes = 0, payload = 0;
    for (std::size_t l = 0; l < levels->size(); ++l) {
        const LevelSummary& level = (*levels)[l];
        all_nodes += double(level.nodes);
        payload += double(level.payload_bytes);
        if (l > std::size_t(kRegionLevel)) continue;
        inside += double(level.payload_bytes);
        nodes += double(level.nodes);
    }
    const double tree = (double(finished->file_bytes) - payload) * nodes / std::max(all_nodes, 1.0);
    forecast.bytes = (inside + tree) * scale;
    return forecast;
}

}  // namespace

Result<FrameForecast> forecastFrame(std::span<const FieldSource* const> channels,
                                    std::span<const BuildOptions> options) {
    FrameForecast frame;
    // One by one, so that each channel's time is scaled by its own share.
    for (std::size_t c = 0; c < channels.size(); ++c) {
        const auto channel = forecastChannel(*channels[c], options[c]);
        if (!channel) return channel;
        frame.bytes += channel->bytes;
        frame.seconds += channel->seconds;
        frame.sampled += channel->sampled / double(channels.size());
    }
    return frame;
}

}  // namespace brickyard

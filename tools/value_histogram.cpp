#include "tools/value_histogram.h"

#include <algorithm>
#include <cmath>

namespace brickyard {
namespace {

class HistogramSink final : public VoxelSink {
public:
    HistogramSink(SampleType type, ValueHistogram& histogram) : type_(type), histogram_(histogram) {}

    void fill(const IndexBox& box, std::span<const ValueBits> value, bool active) override {
        if (!active) return;
        double squares = 0;
        for (const ValueBits bits : value) squares += toDouble(type_, bits) * toDouble(type_, bits);
        count(value.size() == 1 ? toDouble(type_, value[0]) : std::sqrt(squares),
              std::uint64_t(box.extent(0)) * std::uint64_t(box.extent(1)) * std::uint64_t(box.extent(2)));
    }

    void copy(const IndexBox& box, const IndexBox& part, std::span<const std::byte> values,
              std::span<const std::uint8_t> active) override {
        const std::size_t count_all = active.size(),
                          components = values.size() / sampleBytes(type_) / count_all;
        const std::size_t nx = std::size_t(box.extent(0)), ny = std::size_t(box.extent(1));
        for (std::int64_t z = part.begin[2]; z < part.end[2]; ++z)
            for (std::int64_t y = part.begin[1]; y < part.end[1]; ++y)
                for (std::int64_t x = part.begin[0]; x < part.end[0]; ++x) {
                    const std::size_t at =
                        std::size_t(x - box.begin[0]) +
                        nx * (std::size_t(y - box.begin[1]) + ny * std::size_t(z - box.begin[2]));
                    if (!active[at]) continue;
                    double first = toDouble(type_, sampleBits(type_, values, at)), squares = first * first;
                    for (std::size_t c = 1; c < components; ++c) {
                        const double next = toDouble(type_, sampleBits(type_, values, c * count_all + at));
                        squares += next * next;
                    }
                    count(components == 1 ? first : std::sqrt(squares), 1);
                }
    }

private:
    void count(double value, std::uint64_t voxels) {
        const double extent = histogram_.highest - histogram_.lowest;
        const double place = extent > 0 ? (value - histogram_.lowest) / extent : 0;
        const double bins = double(histogram_.voxels.size());
        // A NaN fails the comparison, and is at the lower end.
        const double bin = place > 0 ? std::min(place * bins, bins - 1) : 0;
        histogram_.voxels[std::size_t(bin)] += voxels << (3 * histogram_.level);
    }

    SampleType type_;
    ValueHistogram& histogram_;
};

}  // namespace

Result<ValueHistogram> countValues(const FieldReader& reader, int level, int bins) {
    const ChannelFooter& channel = reader.channel();
    ValueHistogram histogram;
    histogram.level = level;
    histogram.voxels.assign(std::size_t(bins), 0);
    histogram.lowest = channel.value_min();
    histogram.highest = channel.value_max();
    if (reader.components() > 1) {
        histogram.highest = std::sqrt(double(reader.components())) *
                            std::max(std::abs(channel.value_min()), std::abs(channel.value_max()));
        histogram.lowest = 0;
    }
    // One value has one place.
    if (!(histogram.lowest < histogram.highest)) histogram.voxels.assign(1, 0);
    constexpr std::int64_t kFar = std::int64_t(1) << 40;
    HistogramSink sink(walkedType(reader.type(), level), histogram);
    if (auto walked = walkField(reader, level, {{-kFar, -kFar, -kFar}, {kFar, kFar, kFar}}, sink); !walked)
        return tl::unexpected(walked.error());
    return histogram;
}

}  // namespace brickyard

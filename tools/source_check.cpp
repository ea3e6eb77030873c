#include "tools/source_check.h"

#include <fmt/format.h>

#include <atomic>
#include <cfloat>
#include <cmath>
#include <mutex>
#include <random>

#include "core/dataset.h"
#include "core/finite_field.h"
#include "core/printable_name.h"
#include "tools/field_reader.h"
#include "tools/frame_plan.h"
#include "tools/importers/openvdb_source.h"
#include "tools/importers/vdb_reader_guard.h"

namespace brickyard {
namespace {

constexpr std::int64_t kInt32End = std::int64_t(1) << 31;

WorstVoxel& worstOf(SourceReport& report, const std::string& channel) {
    for (WorstVoxel& worst : report.worst_of_channels)
        if (worst.channel == channel) return worst;
    report.worst_of_channels.emplace_back().channel = channel;
    return report.worst_of_channels.back();
}

class ChannelCheck {
public:
    ChannelCheck(const FieldReader& stored, const FieldSource& source, const VdbField* sampler,
                 std::uint32_t frame, const ParallelFor& parallel_for, SourceReport& report)
        : stored_(stored),
          source_(source),
          sampler_(sampler),
          frame_(frame),
          parallel_for_(parallel_for),
          report_(report),
          error_(stored.channel().error_bound()) {}

    Result<void> run(std::uint64_t points) {
        if (stored_.type() != source_.info().type || stored_.components() != source_.info().components) {
            fault("the types differ");
            return {};
        }
        if (!std::ranges::equal(stored_.background(), source_.info().background))
            fault("the backgrounds differ");
        if (!(stored_.indexToWorld() == source_.info().index_to_world)) fault("the transforms differ");
        if (stored_.channel().active_voxels() != source_.info().active_voxels)
            fault("the counts of active voxels differ");
        if (auto compared = compareVoxels(); !compared) return compared;
        return sampler_ ? comparePoints(points) : Result<void>();
    }

private:
    void fault(const std::string& what) {
        const std::lock_guard lock(mutex_);
        ++report_.fault_count;
        if (report_.faults.size() < kMaxFaults)
            report_.faults.push_back(fmt::format("frame {}, channel '{}': {}", frame_,
                                                 printableName(stored_.channel().name()), what));
    }

    // Boxes to compare voxel by voxel are gathered by a walk from all of int32 down, then done in parallel.
    Result<void> compareVoxels() {
        auto roots = stored_.roots();
        if (!roots) return tl::unexpected(roots.error());
        roots_ = std::move(*roots);
        int top = 0;
        while ((std::int64_t(stored_.shape().edge_cells) << top) < kInt32End) ++top;
        for (const FieldNode& root : roots_) top = std::max(top, root.key.level);
        for (int octant = 0; octant < 8; ++octant) {
            const NodeKey key{top, (octant & 1) - 1, (octant >> 1 & 1) - 1, (octant >> 2 & 1) - 1};
            if (auto walked = walkAbove(key); !walked) return walked;
        }
        Result<void> result;
        parallel_for_(boxes_.size(), [&](std::size_t i) {
            if (auto compared = compareBox(boxes_[i]); !compared) {
                const std::lock_guard lock(mutex_);
                result = compared;
            }
        });
        return result;
    }

    // Above the roots there are no nodes; beside them there is background.
    Result<void> walkAbove(const NodeKey& key) {
        bool any_below = false;
        for (const FieldNode& root : roots_) {
            if (root.key == key) return walk(key, &root);
            const int up = key.level - root.key.level;
            any_below = any_below || (up > 0 && root.key.x >> up == key.x && root.key.y >> up == key.y &&
                                      root.key.z >> up == key.z);
        }
        if (!any_below) return walk(key, nullptr);
        for (int octant = 0; octant < 8; ++octant)
            if (auto walked = walkAbove(key.child(octant)); !walked) return walked;
        return {};
    }

    // `cover` is the node of `key`, or a leaf above it, or nothing where the background is.
    Result<void> walk(const NodeKey& key, const FieldNode* cover) {
        const IndexBox region = intersect(stored_.ownedRegion(key), {{-kInt32End, -kInt32End, -kInt32End},
                                                                     {kInt32End, kInt32End, kInt32End}});
        if (region.empty()) return {};
        if (cover && !cover->isLeaf()) {
            for (int octant = 0; octant < 8; ++octant) {
                if (!(cover->validMask() >> octant & 1)) {
                    if (auto walked = walk(key.child(octant), nullptr); !walked) return walked;
                    continue;
                }
                const auto child = stored_.child(*cover, octant);
                if (!child) return tl::unexpected(child.error());
                if (auto walked = walk(key.child(octant), &*child); !walked) return walked;
            }
            return {};
        }
        if (!cover || !cover->record().hasBrick()) {
            if (const auto uniform = source_.uniformOver(region)) {
                const auto value = cover ? cover->tree->constant(cover->node) : stored_.background();
                const bool active = cover && cover->record().active;
                ++report_.regions;
                for (int c = 0; c < stored_.components(); ++c)
                    compareValue(region.begin, c, value[std::size_t(c)], uniform->value[std::size_t(c)]);
                if (active != uniform->active) stateFault(region.begin, active);
                return {};
            }
        }
        if (key.level == 0) {
            boxes_.push_back(region);
            return {};
        }
        for (int octant = 0; octant < 8; ++octant)
            if (auto walked = walk(key.child(octant), cover); !walked) return walked;
        return {};
    }

    Result<void> compareBox(const IndexBox& box) {
        SampleBlock stored, source;
        if (auto read = stored_.read(box, stored); !read) return read;
        if (auto read = source_.read(box, source); !read) return read;
        const std::size_t nx = std::size_t(box.extent(0)), ny = std::size_t(box.extent(1)),
                          count = source.active.size();
        for (std::size_t i = 0; i < count; ++i) {
            const Index3 at{box.begin[0] + std::int64_t(i % nx), box.begin[1] + std::int64_t(i / nx % ny),
                            box.begin[2] + std::int64_t(i / nx / ny)};
            for (int c = 0; c < stored_.components(); ++c) {
                const std::size_t value = std::size_t(c) * count + i;
                compareValue(at, c, sampleBits(stored_.type(), stored.values, value),
                             sampleBits(stored_.type(), source.values, value));
            }
            if (stored.active[i] != source.active[i]) stateFault(at, stored.active[i]);
        }
        const std::lock_guard lock(mutex_);
        report_.voxels += count;
        return {};
    }

    void stateFault(const Index3& at, bool stored_active) {
        fault(fmt::format("voxel ({}, {}, {}) is {} here, {} in the source", at[0], at[1], at[2],
                          stored_active ? "active" : "inactive", stored_active ? "inactive" : "active"));
    }

    void compareValue(const Index3& at, int component, ValueBits stored_bits, ValueBits source_bits) {
        // Nothing to remember after the first equal one.
        if (stored_bits == source_bits && any_compared_.exchange(true)) return;
        const double stored = toDouble(stored_.type(), stored_bits),
                     source = toDouble(stored_.type(), source_bits);
        const double deviation = stored_bits == source_bits ? 0 : std::abs(stored - source);
        {
            const std::lock_guard lock(mutex_);
            const WorstVoxel here{
                frame_, stored_.channel().name(), at[0], at[1], at[2], component, stored, source, deviation};
            WorstVoxel& worst = worstOf(report_, here.channel);
            if (deviation > worst.deviation) worst = here;
            if (deviation > report_.worst.deviation) report_.worst = here;
        }
        // A coarse leaf is interpolated in double and rounded to the channel's type: half a unit in the last
        // place more.
        const double rounding = stored_.type() == SampleType::kFloat32 ? FLT_EPSILON : DBL_EPSILON;
        const bool same =
            error_ > 0 ? deviation <= error_ + rounding * std::abs(source) : stored_bits == source_bits;
        if (!same)
            fault(fmt::format("voxel ({}, {}, {}){} is {} here, {} in the source; the bound is {}", at[0],
                              at[1], at[2],
                              stored_.components() > 1 ? fmt::format(", component {}", component) : "",
                              stored, source, error_));
    }

    // Random positions around the active voxels: inside cells, on faces, and a little outside.
    Result<void> comparePoints(std::uint64_t count) {
        const IndexBox& box = source_.info().active_box;
        if (box.empty()) return {};
        std::mt19937_64 random(1);
        for (std::uint64_t i = 0; i < count; ++i) {
            glm::dvec3 at(0);
            for (int a = 0; a < 3; ++a) {
                const double begin = double(box.begin[std::size_t(a)]) - 2,
                             end = double(box.end[std::size_t(a)]) + 1;
                at[a] = std::uniform_real_distribution(begin, end)(random);
                // Every eighth coordinate falls on a sample plane, where bricks and octants meet.
                if (random() % 8 == 0) at[a] = std::round(at[a]);
            }
            if (auto compared = comparePoint(at); !compared) return compared;
        }
        return {};
    }

    Result<void> comparePoint(const glm::dvec3& at) {
        const auto expected = sampler_->boxSample(at);
        if (!expected) return {};
        const auto stored = stored_.sample(at);
        if (!stored) return tl::unexpected(stored.error());
        // OpenVDB interpolates in the grid's own precision; its rounding is relative to the largest corner.
        const Index3 corner{std::int64_t(std::floor(at.x)), std::int64_t(std::floor(at.y)),
                            std::int64_t(std::floor(at.z))};
        SampleBlock corners;
        if (auto read = source_.read({corner, {corner[0] + 2, corner[1] + 2, corner[2] + 2}}, corners); !read)
            return read;
        const bool single = stored_.type() == SampleType::kFloat32;
        ++report_.points;
        for (int c = 0; c < stored_.components(); ++c) {
            double largest = 0;
            for (std::size_t i = 0; i < 8; ++i)
                largest = std::max(
                    largest, std::abs(toDouble(stored_.type(), sampleBits(stored_.type(), corners.values,
                                                                          std::size_t(c) * 8 + i))));
            const double value = (*stored)[std::size_t(c)], reference = (*expected)[std::size_t(c)];
            // Its differences overflow where corners are near the ends of the range; ours do not.
            if (!std::isfinite(reference)) continue;
            const double rounding = 8 * (single ? largest * FLT_EPSILON + double(FLT_TRUE_MIN)
                                                : largest * DBL_EPSILON + DBL_TRUE_MIN);
            const double deviation = std::abs(value - reference);
            report_.worst_point = std::max(report_.worst_point, deviation);
            if (!(deviation <= error_ + rounding))
                fault(fmt::format("at ({}, {}, {}) the field is {} here, OpenVDB samples {}; the bound is {}",
                                  at.x, at.y, at.z, value, reference, error_));
        }
        return {};
    }

    const FieldReader& stored_;
    const FieldSource& source_;
    const VdbField* sampler_;  // null: the format has no program of its own to compare with
    std::uint32_t frame_;
    const ParallelFor& parallel_for_;
    SourceReport& report_;
    double error_;
    std::mutex mutex_;
    std::atomic<bool> any_compared_{false};
    std::vector<FieldNode> roots_;
    std::vector<IndexBox> boxes_;
};

NonFinite nonfiniteOf(const Manifest& manifest) {
    return manifest.nonfinite() == "zero"    ? NonFinite::kZero
           : manifest.nonfinite() == "clamp" ? NonFinite::kClamp
                                             : NonFinite::kReject;
}

struct SourceField {
    std::unique_ptr<FieldSource> field;
    const VdbField* sampler = nullptr;  // the same field, where OpenVDB itself can be asked
};

// OpenVDB files are read by OpenVDB, however the converter reads them: a check wants to be independent.
Result<std::vector<SourceField>> openSource(const std::filesystem::path& file, const InputOptions& options) {
    std::vector<SourceField> fields;
    const auto format = detectFormat(file, options);
    if (!format) return tl::unexpected(format.error());
    if (*format == InputFormat::kOpenVdb) {
        if (auto checked = checkVdb(file, options.channels, {}, options.probe_program); !checked)
            return tl::unexpected(checked.error());
        auto contents = readVdb(file, options.channels);
        if (!contents) return tl::unexpected(contents.error());
        for (auto& field : contents->fields) {
            const VdbField* const sampler = field.get();
            fields.push_back({std::move(field), sampler});
        }
        return fields;
    }
    auto contents = openInput(file, options);
    if (!contents) return tl::unexpected(contents.error());
    for (auto& field : contents->fields) fields.push_back({std::move(field), nullptr});
    return fields;
}

}  // namespace

Result<SourceReport> checkAgainst(const std::filesystem::path& folder, const std::vector<std::string>& inputs,
                                  const ParallelFor& parallel_for, std::uint64_t points_per_channel,
                                  const InputOptions& reading) {
    const auto dataset = Dataset::open(folder);
    if (!dataset) return tl::unexpected(dataset.error());
    const Manifest& manifest = dataset->manifest();
    InputOptions options = reading;
    options.channels.assign(manifest.channel_filter().begin(), manifest.channel_filter().end());
    const auto frames = planInputs(inputs);
    if (!frames) return tl::unexpected(frames.error());

    SourceReport report;
    for (const FrameInputs& frame : *frames) {
        const auto store = dataset->openFrame(frame.frame);
        if (!store) return tl::unexpected(store.error());
        ++report.frames;
        std::size_t met = 0;
        for (const auto& file : frame.files) {
            const auto fields = openSource(file, options);
            if (!fields) return tl::unexpected(fields.error());
            for (const auto& [field, sampler] : *fields) {
                const auto channel = findChannel(**store, field->info().name);
                if (!channel) return tl::unexpected(channel.error());
                auto finite = FiniteField::create(*field, nonfiniteOf(manifest));
                if (!finite) return tl::unexpected(finite.error());
                const FieldReader reader(*store, *channel);
                ++report.channels;
                ++met;
                if (auto checked = ChannelCheck(reader, *finite, sampler, frame.frame, parallel_for, report)
                                       .run(points_per_channel);
                    !checked)
                    return tl::unexpected(checked.error());
            }
        }
        if (met != std::size_t((*store)->footer().channels_size()))
            return fail(
                ErrorCode::kNotFound,
                fmt::format("{}: frame {} has {} channels, its source {}; name all files of this frame",
                            folder.string(), frame.frame, (*store)->footer().channels_size(), met));
    }
    return report;
}

}  // namespace brickyard

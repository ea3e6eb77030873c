#include "tools/conversion.h"

#include <fmt/format.h>
#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <chrono>

#include "core/dataset.h"
#include "core/io_error.h"
#include "core/printable_name.h"
#include "tools/frame_plan.h"
#include "tools/importers/input_file.h"
#include "tools/progress_line.h"
#include "tools/worker_pool.h"

namespace brickyard {
namespace {

Result<SourceFile> describeSource(const std::filesystem::path& file) {
    struct stat status{};
    if (::stat(file.c_str(), &status) != 0) return ioError("open", file, errno);
    SourceFile source;
    source.set_name(validUtf8(file.filename().string()));
    source.set_bytes(std::uint64_t(status.st_size));
    source.set_modified_ns(std::int64_t(status.st_mtim.tv_sec) * 1'000'000'000 + status.st_mtim.tv_nsec);
    return source;
}

template <class Sources>
std::vector<std::string> sourceKeys(const Sources& sources) {
    std::vector<std::string> keys;
    for (const SourceFile& source : sources)
        keys.push_back(fmt::format("{} {} {}", source.name(), source.bytes(), source.modified_ns()));
    std::sort(keys.begin(), keys.end());
    return keys;
}

struct PlannedFrame {
    FrameInputs inputs;
    std::vector<SourceFile> sources;
    bool done = false;  // there already, from the same sources
};

// One frame's fields, and what stands beside them in its files.
struct FrameFields {
    std::vector<std::unique_ptr<FieldSource>> fields;
    std::vector<std::filesystem::path> files;  // beside `fields`: where each came from
};

class Conversion {
public:
    explicit Conversion(const ConversionOptions& options) : options_(options), pool_(options.jobs) {}

    Result<ConversionReport> run() {
        if (auto planned = plan(); !planned) return tl::unexpected(planned.error());
        auto writer = DatasetWriter::open(options_.output, settings(), options_.existing);
        if (!writer) return tl::unexpected(writer.error());
        if (auto checked = compareWithExisting((*writer)->manifest()); !checked)
            return tl::unexpected(checked.error());

        std::uint64_t done_bytes = 0;
        for (const PlannedFrame& frame : frames_) {
            if (!frame.done) {
                if (auto converted = convertFrame(frame, **writer, done_bytes); !converted)
                    return tl::unexpected(converted.error());
                ++report_.converted;
            }
            done_bytes += bytesOf(frame);
        }
        for (const PlannedFrame& frame : frames_)
            for (const FrameEntry& entry : (*writer)->manifest().frames())
                if (entry.frame() == frame.inputs.frame) report_.frames.push_back(entry);
        if (auto finished = (*writer)->finish(); !finished) return tl::unexpected(finished.error());
        report_.input_bytes = total_bytes_;
        report_.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started_).count();
        return report_;
    }

private:
    static std::uint64_t bytesOf(const PlannedFrame& frame) {
        std::uint64_t bytes = 0;
        for (const SourceFile& source : frame.sources) bytes += source.bytes();
        return bytes;
    }

    Result<void> plan() {
        auto planned = planInputs(options_.inputs);
        if (!planned) return tl::unexpected(planned.error());
        for (FrameInputs& inputs : *planned) {
            if (options_.frames && !options_.frames->contains(inputs.frame)) continue;
            PlannedFrame frame;
            for (const auto& file : inputs.files) {
                auto source = describeSource(file);
                if (!source) return tl::unexpected(source.error());
                frame.sources.push_back(std::move(*source));
            }
            frame.inputs = std::move(inputs);
            total_bytes_ += bytesOf(frame);
            frames_.push_back(std::move(frame));
        }
        if (frames_.empty())
            return fail(
                ErrorCode::kNotFound,
                fmt::format("{}: none of the {} frames that the inputs make is in --frames; name others",
                            options_.inputs[0], planned->size()));
        return {};
    }

    Manifest settings() const {
        Manifest manifest;
        manifest.set_format_major(kFormatMajor);
        manifest.set_format_minor(kFormatMinor);
        manifest.set_brick_edge(std::uint32_t(options_.brick_edge));
        manifest.set_writer("brickyard " BRICKYARD_VERSION);
        manifest.set_nonfinite(toString(options_.nonfinite));
        const auto addError = [&](const std::string& channel, double error) {
            ErrorRequest& request = *manifest.add_error_requests();
            request.set_channel(channel);
            request.set_max_error(error);
        };
        if (options_.max_error > 0) addError("", options_.max_error);
        for (const auto& [channel, error] : options_.channel_errors) addError(channel, error);
        for (const std::string& channel : options_.channels) manifest.add_channel_filter(channel);
        return manifest;
    }

    // The same command again goes on where it stopped; anything else has to be asked for.
    Result<void> compareWithExisting(const Manifest& manifest) {
        for (const FrameEntry& entry : manifest.frames()) {
            const auto frame = std::find_if(frames_.begin(), frames_.end(), [&](const PlannedFrame& planned) {
                return planned.inputs.frame == entry.frame();
            });
            const auto refuse = [&](const std::string& what) {
                return fail(ErrorCode::kInvalid, fmt::format("{}: {}", options_.output.string(), what));
            };
            if (frame == frames_.end()) {
                if (options_.existing == ExistingDataset::kAppend) continue;
                // Another run's, of the same farm.
                if (options_.frames && !options_.frames->contains(entry.frame())) continue;
                return refuse(fmt::format(
                    "exists with frame {}, which these inputs do not make; --append to add to it, "
                    "or --overwrite to start anew",
                    entry.frame()));
            }
            if (sourceKeys(entry.sources()) != sourceKeys(frame->sources))
                return refuse(fmt::format(
                    "frame {} was made of '{}' as it was then, not of this '{}'; --overwrite to "
                    "convert anew, or --append frames of other numbers",
                    entry.frame(), entry.sources().empty() ? "?" : printableName(entry.sources(0).name()),
                    frame->inputs.files[0].string()));
            frame->done = true;
        }
        return {};
    }

    // Notes about grids that are left out are held back until it is clear that the frame converts.
    Result<FrameFields> readFrame(const PlannedFrame& frame) {
        FrameFields result;
        std::map<std::string, std::filesystem::path> owners;
        std::vector<std::string> notes;
        std::string names, left_out;
        for (const auto& file : frame.inputs.files) {
            InputOptions input;
            input.channels = options_.channels;
            input.memory_bytes = options_.memory_bytes;
            input.raw = options_.raw;
            input.name = options_.name;
            input.raw_voxel_size = options_.raw_voxel_size;
            input.probe_program = options_.probe_program;
            auto contents = openInput(file, input);
            if (!contents) return tl::unexpected(contents.error());
            for (const std::string& name : contents->names)
                if (names.size() < 200) names += (names.empty() ? "" : ", ") + printableName(name);
            for (const SkippedGrid& grid : contents->skipped) {
                const std::string line = fmt::format("grid '{}' {}", printableName(grid.name), grid.reason);
                if (!options_.channels.empty())
                    return fail(ErrorCode::kUnsupported, fmt::format("{}: {}", file.string(), line));
                notes.push_back(fmt::format("{}: {}; it is left out", file.string(), line));
                if (left_out.empty()) left_out = line;
            }
            for (auto& field : contents->fields) {
                const std::string& name = field->info().name;
                if (const auto [owner, is_new] = owners.emplace(name, file); !is_new)
                    return fail(
                        ErrorCode::kInvalid,
                        fmt::format("frame {}: both {} and {} have a channel '{}'; leave one out, or give it "
                                    "another frame number",
                                    frame.inputs.frame, owner->second.string(), file.string(),
                                    printableName(name)));
                result.files.push_back(file);
                result.fields.push_back(std::move(field));
            }
        }
        const std::string first = frame.inputs.files[0].string();
        for (const std::string& wanted : options_.channels)
            if (!owners.contains(wanted))
                return fail(ErrorCode::kNotFound,
                            fmt::format("{}: no grid is named '{}'; {}", first, printableName(wanted),
                                        names.empty() ? "there are none" : "there are " + names));
        if (result.fields.empty())
            return fail(ErrorCode::kUnsupported,
                        left_out.empty() ? fmt::format("{}: holds no grids; nothing to convert", first)
                                         : fmt::format("{}: nothing to convert: {}", first, left_out));
        for (const auto& [channel, error] : options_.channel_errors)
            if (report_.converted == 0 && !owners.contains(channel))
                return fail(ErrorCode::kNotFound, fmt::format("{}: --error names '{}', but there are {}",
                                                              first, printableName(channel), names));
        if (options_.note)
            for (const std::string& note : notes) {
                progress_.clear();
                options_.note(note);
            }
        return result;
    }

    Result<void> convertFrame(const PlannedFrame& frame, DatasetWriter& writer, std::uint64_t done_bytes) {
        const std::string label = fmt::format("frame {}", frame.inputs.frame);
        const double share = double(bytesOf(frame)) / double(std::max<std::uint64_t>(total_bytes_, 1));
        const double before = double(done_bytes) / double(std::max<std::uint64_t>(total_bytes_, 1));
        progress_.show(label + ", reading", before, done_bytes);
        auto contents = readFrame(frame);
        if (!contents) return tl::unexpected(contents.error());

        std::vector<const FieldSource*> sources;
        std::vector<BuildOptions> options;
        for (const auto& field : contents->fields) {
            sources.push_back(field.get());
            BuildOptions& build = options.emplace_back();
            build.shape.edge_cells = options_.brick_edge;
            const auto error = options_.channel_errors.find(field->info().name);
            build.max_error = error == options_.channel_errors.end() ? options_.max_error : error->second;
            build.nonfinite = options_.nonfinite;
            build.parallel_for = pool_.parallelFor();
            build.progress = [&, this](std::size_t done, std::size_t total) {
                const double part = total > 0 ? double(done) / double(total) : 1;
                progress_.show(fmt::format("{}, brick {} of {}", label, done, total), before + share * part,
                               done_bytes + std::uint64_t(part * double(bytesOf(frame))));
            };
        }

        const auto temporary = writer.temporaryFrame(frame.inputs.frame);
        if (!temporary) return tl::unexpected(temporary.error());
        auto output = FrameWriter::create(*temporary);
        if (!output) return tl::unexpected(output.error());
        const auto footer = buildFrame(sources, options, **output);
        if (!footer) {
            // The builder knows channels, not files.
            if (footer.error().code != ErrorCode::kInvalid) return tl::unexpected(footer.error());
            return fail(footer.error().code,
                        fmt::format("{}: {}", frame.inputs.files[0].string(), footer.error().message));
        }
        const auto finished = (*output)->finish(*footer);
        if (!finished) return tl::unexpected(finished.error());

        FrameEntry entry;
        entry.set_frame(frame.inputs.frame);
        entry.set_file_bytes(finished->file_bytes);
        entry.set_footer_xxh64(finished->footer_checksum);
        for (const SourceFile& source : frame.sources) *entry.add_sources() = source;
        for (const ChannelFooter& channel : footer->channels())
            *entry.add_channels() = summarizeChannel(channel);
        return writer.commitFrame(*temporary, std::move(entry));
    }

    const ConversionOptions& options_;
    WorkerPool pool_;
    ProgressLine progress_;
    std::chrono::steady_clock::time_point started_ = std::chrono::steady_clock::now();
    std::vector<PlannedFrame> frames_;
    std::uint64_t total_bytes_ = 0;
    ConversionReport report_;
};

}  // namespace

const char* toString(NonFinite policy) {
    switch (policy) {
        case NonFinite::kReject: return "reject";
        case NonFinite::kZero: return "zero";
        case NonFinite::kClamp: return "clamp";
    }
    return "";
}

ChannelSummary summarizeChannel(const ChannelFooter& channel) {
    ChannelSummary summary;
    summary.set_name(channel.name());
    summary.set_sample_type(channel.sample_type());
    summary.set_components(channel.components());
    *summary.mutable_index_to_world() = channel.index_to_world();
    *summary.mutable_active_min() = channel.active_min();
    *summary.mutable_active_max() = channel.active_max();
    summary.set_active_voxels(channel.active_voxels());
    summary.set_bricks(channel.bricks());
    summary.set_levels(channel.levels());
    summary.set_value_min(channel.value_min());
    summary.set_value_max(channel.value_max());
    summary.set_error_bound(channel.error_bound());
    summary.set_error_made(channel.error_made());
    summary.set_payload_bytes(channel.payload_bytes());
    summary.set_saved_as_half(channel.saved_as_half());
    return summary;
}

Result<ConversionReport> convert(const ConversionOptions& options) { return Conversion(options).run(); }

}  // namespace brickyard

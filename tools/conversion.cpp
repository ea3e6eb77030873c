#include "tools/conversion.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <thread>

#include "core/dataset.h"
#include "core/printable_name.h"
#include "tools/channel_summary.h"
#include "tools/frame_forecast.h"
#include "tools/frame_plan.h"
#include "tools/importers/input_file.h"
#include "tools/progress_line.h"
#include "tools/source_identity.h"
#include "tools/stoppable_field.h"
#include "tools/worker_pool.h"

namespace brickyard {
namespace {

struct PlannedFrame {
    FrameInputs inputs;
    std::vector<SourceFile> sources;
    bool done = false;    // there already, from the same sources
    bool settled = true;  // nobody has changed it for a while
};

// One frame's fields, and what stands beside them in its files.
struct FrameFields {
    std::vector<std::unique_ptr<FieldSource>> fields;
    std::vector<std::filesystem::path> files;  // beside `fields`: where each came from
    std::vector<MetadataEntry> metadata;       // of the first file
};

// What the builder is given for a frame.
struct FrameBuild {
    std::vector<std::unique_ptr<StoppableField>> fields;
    std::vector<const FieldSource*> sources;
    std::vector<BuildOptions> options;
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

        for (const PlannedFrame& frame : frames_)
            if (!frame.done) todo_bytes_ += bytesOf(frame), ++todo_frames_;
        for (PlannedFrame& frame : frames_) {
            if (frame.done) continue;
            if (stopped()) break;
            if (auto settled = awaitSettled(frame); !settled) return tl::unexpected(settled.error());
            if (!frame.settled) continue;
            if (auto converted = convertFrame(frame, **writer); !converted) {
                // Whatever it says, it says because it was to stop.
                if (stopped()) break;
                return tl::unexpected(converted.error());
            }
            ++report_.converted;
            done_bytes_ += bytesOf(frame);
        }
        report_.stopped = stopped();
        report_.planned = std::uint32_t(frames_.size());
        for (const PlannedFrame& frame : frames_)
            for (const FrameEntry& entry : (*writer)->manifest().frames())
                if (entry.frame() == frame.inputs.frame) report_.frames.push_back(entry);
        if (!report_.stopped)
            if (auto finished = (*writer)->finish(); !finished) return tl::unexpected(finished.error());
        report_.input_bytes = total_bytes_;
        report_.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started_).count();
        return report_;
    }

    Result<ConversionForecast> forecast() {
        if (auto planned = plan(); !planned) return tl::unexpected(planned.error());
        if (options_.existing != ExistingDataset::kOverwrite)
            if (const auto dataset = Dataset::open(options_.output))
                if (auto checked = compareWithExisting(dataset->manifest()); !checked)
                    return tl::unexpected(checked.error());
        ConversionForecast result;
        std::vector<const PlannedFrame*> todo;
        for (const PlannedFrame& frame : frames_) {
            ++result.frames;
            result.frames_done += frame.done;
            if (frame.done) continue;
            todo.push_back(&frame);
            result.input_bytes += bytesOf(frame);
        }
        std::vector<std::size_t> chosen;
        for (const std::size_t i : {std::size_t(0), todo.size() / 2, todo.size() - 1})
            if (i < todo.size() && (chosen.empty() || chosen.back() < i)) chosen.push_back(i);
        std::uint64_t read_bytes = 0;
        for (const std::size_t i : chosen) {
            const PlannedFrame& frame = *todo[i];
            progress_.show(fmt::format("sampling frame {}", frame.inputs.frame), 0, read_bytes);
            const auto started = std::chrono::steady_clock::now();
            auto contents = readFrame(frame);
            if (!contents) return tl::unexpected(contents.error());
            result.seconds +=
                std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
            FrameBuild build = prepareBuild(*contents, nullptr);
            const auto frame_forecast = forecastFrame(build.sources, build.options);
            if (stopped()) return result;
            if (!frame_forecast) return tl::unexpected(frame_forecast.error());
            result.seconds += frame_forecast->seconds;
            result.bytes += frame_forecast->bytes;
            result.sampled += frame_forecast->sampled / double(chosen.size());
            result.sampled_frames.push_back(frame.inputs.frame);
            read_bytes += bytesOf(frame);
        }
        // Frames between them are like them, by the size of their files.
        const double scale = double(result.input_bytes) / double(std::max<std::uint64_t>(read_bytes, 1));
        result.bytes *= scale;
        result.seconds *= scale;
        return result;
    }

private:
    bool stopped() const { return options_.stop && options_.stop(); }

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
        manifest.set_without_drafts(!options_.drafts);
        manifest.set_writer("brickyard " BRICKYARD_VERSION);
        manifest.set_nonfinite(toString(options_.nonfinite));
        if (!options_.raw.empty()) {
            const auto& size = options_.raw_voxel_size;
            manifest.set_input_layout(
                fmt::format("{} --voxel-size {},{},{}", options_.raw, size[0], size[1], size[2]));
        }
        if (!options_.name.empty())
            manifest.set_input_layout(manifest.input_layout() + " --name " + validUtf8(options_.name));
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
            input.memory_bytes = options_.memory_bytes / 4;
            input.raw = options_.raw;
            input.name = options_.name;
            input.raw_voxel_size = options_.raw_voxel_size;
            input.probe_program = options_.probe_program;
            auto contents = openInput(file, input);
            if (!contents) return tl::unexpected(contents.error());
            if (&file == &frame.inputs.files.front()) result.metadata = std::move(contents->metadata);
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

    // Leaves a frame that somebody still writes for the next time, and takes note of it as it is now.
    Result<void> awaitSettled(PlannedFrame& frame) {
        using Clock = std::chrono::system_clock;
        if (options_.settle.count() <= 0) return {};
        const auto look = [&]() -> Result<std::vector<SourceFile>> {
            std::vector<SourceFile> sources;
            for (const auto& file : frame.inputs.files) {
                auto source = describeSource(file);
                if (!source) return tl::unexpected(source.error());
                sources.push_back(std::move(*source));
            }
            return sources;
        };
        auto before = look();
        if (!before) return tl::unexpected(before.error());
        // The file server's clock may differ from ours: an age is believed only where it is one.
        bool old = true;
        for (const SourceFile& source : *before) {
            const auto age = Clock::now().time_since_epoch() - std::chrono::nanoseconds(source.modified_ns());
            old = old && age > options_.settle;
        }
        if (!old) {
            progress_.show(fmt::format("frame {}, waiting whether it is complete", frame.inputs.frame), 0, 0);
            const auto begun = std::chrono::steady_clock::now();
            while (!stopped() && std::chrono::steady_clock::now() - begun < options_.settle)
                std::this_thread::sleep_for(std::chrono::milliseconds(20));
            const auto after = look();
            if (!after) return tl::unexpected(after.error());
            frame.settled = sourceKeys(*before) == sourceKeys(*after);
        }
        if (!frame.settled && options_.note)
            options_.note(fmt::format("frame {}: {} is still being written; it is left for the next run",
                                      frame.inputs.frame, frame.inputs.files[0].string()));
        frame.sources = std::move(*before);
        return {};
    }

    // A frame of two halves of different files must not be kept.
    static Result<void> checkUnchanged(const PlannedFrame& frame) {
        if (sourceKeys(frame.inputs.files) == sourceKeys(frame.sources)) return {};
        return fail(
            ErrorCode::kInvalid,
            fmt::format("{}: changed while it was read; run the same command again when it is complete",
                        frame.inputs.files[0].string()));
    }

    FrameBuild prepareBuild(const FrameFields& contents,
                            const std::function<void(std::size_t done, std::size_t total)>& progress) {
        FrameBuild frame;
        for (const auto& field : contents.fields) {
            frame.fields.push_back(std::make_unique<StoppableField>(*field, options_.stop));
            frame.sources.push_back(frame.fields.back().get());
            BuildOptions& build = frame.options.emplace_back();
            build.shape.edge_cells = options_.brick_edge;
            build.drafts = options_.drafts;
            const auto error = options_.channel_errors.find(field->info().name);
            build.max_error = error == options_.channel_errors.end() ? options_.max_error : error->second;
            build.nonfinite = options_.nonfinite;
            build.parallel_for = pool_.parallelFor();
            build.memory_bytes = options_.memory_bytes / 8 * 3;
            build.progress = progress;
        }
        return frame;
    }

    Result<void> convertFrame(const PlannedFrame& frame, DatasetWriter& writer) {
        const std::string label =
            fmt::format("frame {} ({} of {})", frame.inputs.frame, report_.converted + 1, todo_frames_);
        // Of what is to do: frames that were there already say nothing of the speed.
        const auto show = [&](const std::string& what, double part) {
            const double bytes = double(done_bytes_) + part * double(bytesOf(frame));
            progress_.show(label + what, bytes / double(std::max<std::uint64_t>(todo_bytes_, 1)),
                           std::uint64_t(bytes));
        };
        show(", reading", 0);
        auto contents = readFrame(frame);
        if (!contents) {
            // A file that changed under the reader is not broken.
            if (auto unchanged = checkUnchanged(frame); !unchanged) return unchanged;
            return tl::unexpected(contents.error());
        }
        FrameBuild build = prepareBuild(*contents, [&](std::size_t done, std::size_t total) {
            show(fmt::format(", chunk {} of {}", done, total), total > 0 ? double(done) / double(total) : 1);
        });

        const auto temporary = writer.temporaryFrame(frame.inputs.frame);
        if (!temporary) return tl::unexpected(temporary.error());
        auto output = FrameWriter::create(*temporary);
        if (!output) return tl::unexpected(output.error());
        for (BuildOptions& options : build.options) options.scratch_folder = temporary->parent_path();
        auto footer = buildFrame(build.sources, build.options, **output);
        if (auto unchanged = checkUnchanged(frame); !unchanged) return unchanged;
        if (!footer) {
            // The builder knows channels, not files.
            if (footer.error().code != ErrorCode::kInvalid) return tl::unexpected(footer.error());
            return fail(footer.error().code,
                        fmt::format("{}: {}", frame.inputs.files[0].string(), footer.error().message));
        }
        for (const MetadataEntry& entry : contents->metadata) {
            SourceMetadata& stored = *footer->add_metadata();
            stored.set_name(entry.name);
            stored.set_type(entry.type);
            stored.set_value(entry.value);
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
    std::uint64_t todo_bytes_ = 0, done_bytes_ = 0;  // of the frames that this run converts
    std::uint32_t todo_frames_ = 0;
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

Result<ConversionReport> convert(const ConversionOptions& options) { return Conversion(options).run(); }

Result<ConversionForecast> forecast(const ConversionOptions& options) {
    return Conversion(options).forecast();
}

}  // namespace brickyard

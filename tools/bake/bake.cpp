#include "tools/bake/bake.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <memory>
#include <set>

#include "client/local_source.h"
#include "client/world_settings.h"
#include "core/dataset.h"
#include "core/dataset_writer.h"
#include "core/frame_format.h"
#include "core/io_error.h"
#include "core/printable_name.h"
#include "tools/bake/baked_light_field.h"
#include "tools/bake/exact_light.h"
#include "tools/bake/lit_voxels.h"
#include "tools/bake/medium_depth.h"
#include "tools/channel_summary.h"
#include "tools/field_reader.h"
#include "tools/stoppable_field.h"
#include "tools/worker_pool.h"

namespace brickyard {
namespace {

std::string channelName(int light) { return fmt::format("light.{}", light); }

// Of the scene what takes light away: the lights do not say yet where they are baked, and surfaces throw no
// shadow here.
Scene bakedScene(const Scene& scene) {
    Scene bare = scene;
    bare.clear_surfaces();
    for (Light& light : *bare.mutable_lights()) {
        light.clear_baked();
        light.clear_shadows();
    }
    return bare;
}

Affine transformOf(const ChannelFooter& channel) {
    // An open store has checked it.
    return *Affine::fromColumns(
        {channel.index_to_world().data(), std::size_t(channel.index_to_world_size())});
}

Result<void> readAt(const BrickStore& store, std::uint64_t offset, std::span<std::byte> out) {
    while (!out.empty()) {
        const ssize_t got = ::pread(store.descriptor(), out.data(), out.size(), off_t(offset));
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return ioError("read", store.path(), errno);
        if (got == 0)
            return fail(ErrorCode::kCorrupt, fmt::format("{}: ends at byte {}; convert this frame again",
                                                         store.path().string(), offset));
        out = out.subspan(std::size_t(got));
        offset += std::uint64_t(got);
    }
    return {};
}

class Baking {
public:
    explicit Baking(const BakeOptions& options) : options_(options), pool_(options.jobs) {}

    Result<BakeReport> run() {
        const auto started = std::chrono::steady_clock::now();
        auto dataset = Dataset::open(options_.dataset);
        if (!dataset) return tl::unexpected(dataset.error());
        if (Result<void> chosen = chooseFrames(dataset->manifest()); !chosen)
            return tl::unexpected(chosen.error());
        if (Result<void> checked = check(*dataset); !checked) return tl::unexpected(checked.error());
        // Built aside: it is there when all of it is.
        auto writer = DatasetWriter::open(options_.output, settingsOf(dataset->manifest()),
                                          ExistingDataset::kOverwrite);
        if (!writer) return tl::unexpected(writer.error());
        for (const FrameEntry& entry : frames_) {
            if (Result<void> baked = bakeFrame(*dataset, entry, **writer); !baked)
                return tl::unexpected(baked.error());
            ++done_;
        }
        if (Result<void> finished = (*writer)->finish(); !finished) return tl::unexpected(finished.error());
        for (int light = 0; light < options_.scene.lights_size(); ++light)
            report_.channels.push_back(channelName(light));
        report_.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
        return report_;
    }

private:
    Result<void> chooseFrames(const Manifest& manifest) {
        std::set<std::uint32_t> there;
        for (const FrameEntry& entry : manifest.frames()) {
            there.insert(entry.frame());
            if (!options_.frames || options_.frames->contains(entry.frame())) frames_.push_back(entry);
        }
        const auto missing =
            options_.frames ? options_.frames->firstMissing(there) : std::optional<std::uint32_t>();
        if (!missing && !frames_.empty()) return {};
        return fail(ErrorCode::kNotFound,
                    missing
                        ? fmt::format("{}: has no frame {}; there are {}", options_.dataset.string(),
                                      *missing, describeFrames(manifest))
                        : fmt::format("{}: has no frames; convert some into it", options_.dataset.string()));
    }

    Result<void> check(const Dataset& dataset) const {
        const auto refuse = [](const std::filesystem::path& where, const std::string& what) {
            return fail(ErrorCode::kInvalid, fmt::format("{}: {}", where.string(), what));
        };
        if (options_.scene.lights_size() == 0)
            return refuse(dataset.folder(), "there is no light to bake; give a --scene with one");
        for (const FrameEntry& entry : frames_)
            for (const ChannelSummary& channel : entry.channels())
                for (int light = 0; light < options_.scene.lights_size(); ++light)
                    if (channel.name() == channelName(light))
                        return refuse(dataset.folder(),
                                      fmt::format("frame {} has a channel '{}'; bake the dataset that it was "
                                                  "made of",
                                                  entry.frame(), printableName(channel.name())));
        std::error_code ignored;
        if (!options_.overwrite && std::filesystem::exists(options_.output, ignored))
            return refuse(options_.output, "exists; --overwrite it, or name another with -o");
        return {};
    }

    Manifest settingsOf(const Manifest& manifest) const {
        Manifest settings = manifest;
        settings.clear_frames();
        settings.clear_checksum();
        settings.clear_generation();
        settings.set_writer("brickyard " BRICKYARD_VERSION);
        for (int light = 0; light < options_.scene.lights_size(); ++light) {
            // Where a filter names the channels, these are among them.
            if (settings.channel_filter_size() > 0) settings.add_channel_filter(channelName(light));
            ErrorRequest& request = *settings.add_error_requests();
            request.set_channel(channelName(light));
            request.set_max_error(options_.max_error);
        }
        return settings;
    }

    Result<void> bakeFrame(const Dataset& dataset, const FrameEntry& entry, DatasetWriter& writer) {
        auto store = dataset.openFrame(entry.frame());
        if (!store) return tl::unexpected(store.error());
        FrameFooter bound = (*store)->footer();
        BoundFrame frame{options_.scene.datasets_size() > 0 ? options_.scene.datasets(0).name() : "", &bound};
        const Result<WorldSettings> world =
            bindWorld(bakedScene(options_.scene), std::span(&frame, 1), options_.folder);
        if (!world) return tl::unexpected(world.error());
        if (world->media.empty())
            return fail(ErrorCode::kInvalid, fmt::format("{}: the scene has no medium that takes light away",
                                                         dataset.folder().string()));
        const MediumSettings& medium = world->media[0];
        if (options_.level > 0 && medium.sample_offset != glm::dvec3(0))
            return fail(
                ErrorCode::kUnsupported,
                "--level: voxels of a coarser level cannot follow the scene's sample_offset; leave one "
                "of them out");
        const FieldReader density(*store, medium.density.channel);
        LitVoxels voxels(density, options_.level);
        if (Result<void> counted = voxels.count(); !counted) return counted;

        auto source = LocalSource::open(options_.dataset);
        if (!source) return tl::unexpected(source.error());
        const auto depth = MediumDepth::load(**source, entry.frame(), bound, *world);
        if (!depth) return tl::unexpected(depth.error());
        std::vector<std::unique_ptr<BakedLightField>> fields;
        const Affine placed = transformOf(bound.channels(int(medium.density.channel)));
        for (std::size_t i = 0; i < world->lights.size(); ++i)
            fields.push_back(std::make_unique<BakedLightField>(
                channelName(int(i)), voxels, density.indexToWorld(), placed,
                exactLight(world->lights[i], **depth, pool_.parallelFor())));
        return writeFrame(**store, entry, fields, writer);
    }

    // The stored bytes, the light's behind them, and one footer for both.
    Result<void> writeFrame(const BrickStore& store, const FrameEntry& entry,
                            const std::vector<std::unique_ptr<BakedLightField>>& fields,
                            DatasetWriter& writer) {
        const auto temporary = writer.temporaryFrame(entry.frame());
        if (!temporary) return tl::unexpected(temporary.error());
        auto output = FrameWriter::create(*temporary);
        if (!output) return tl::unexpected(output.error());
        if (Result<void> copied = copyStored(store, **output); !copied) return copied;

        std::vector<StoppableField> stoppable;
        for (const auto& field : fields) stoppable.emplace_back(*field, options_.stop);
        std::vector<const FieldSource*> sources;
        for (const StoppableField& field : stoppable) sources.push_back(&field);
        BuildOptions build;
        build.shape.edge_cells = int(store.footer().brick_edge());
        build.max_error = options_.max_error;
        build.scratch_folder = temporary->parent_path();
        // Rays are what takes time, and each block of them is shared out already.
        build.parallel_for = serialFor;
        build.progress = [this](std::size_t done, std::size_t total) {
            if (options_.progress)
                options_.progress(done_, std::uint32_t(frames_.size()),
                                  total > 0 ? double(done) / double(total) : 1);
        };
        const std::vector<BuildOptions> all(sources.size(), build);
        const Result<FrameFooter> lit = buildFrame(sources, all, **output);
        if (!lit) return tl::unexpected(lit.error());
        FrameFooter footer = store.footer();
        // Finest levels of light stand behind this; a reader of the tail gets them as well.
        for (const ChannelFooter& channel : lit->channels()) *footer.add_channels() = channel;
        const auto finished = (*output)->finish(footer);
        if (!finished) return tl::unexpected(finished.error());

        FrameEntry baked = entry;
        baked.set_file_bytes(finished->file_bytes);
        baked.set_footer_xxh64(finished->footer_checksum);
        for (const ChannelFooter& channel : lit->channels())
            *baked.add_channels() = summarizeChannel(channel);
        report_.output_bytes += finished->file_bytes;
        report_.frames.push_back(baked);
        return writer.commitFrame(*temporary, std::move(baked));
    }

    // Everything between header and footer, to the same place: offsets in tree blocks stay what they are.
    static Result<void> copyStored(const BrickStore& store, FrameWriter& output) {
        constexpr std::uint64_t kPieceBytes = 4u << 20;
        using namespace frame_format;
        std::vector<std::byte> piece(kTrailerBytes);
        if (Result<void> read = readAt(store, store.fileBytes() - kTrailerBytes, piece); !read) return read;
        const auto trailer =
            decodeTrailer(std::span<const std::byte, kTrailerBytes>(piece.data(), kTrailerBytes));
        if (!trailer || trailer->footer_offset > store.fileBytes())
            return fail(ErrorCode::kCorrupt,
                        fmt::format("{}: changed while it was read; bake again", store.path().string()));
        for (std::uint64_t at = kHeaderBytes; at < trailer->footer_offset;) {
            piece.resize(std::size_t(std::min(kPieceBytes, trailer->footer_offset - at)));
            if (Result<void> read = readAt(store, at, piece); !read) return read;
            if (const auto written = output.append(piece); !written) return tl::unexpected(written.error());
            at += piece.size();
        }
        return {};
    }

    const BakeOptions& options_;
    WorkerPool pool_;
    std::vector<FrameEntry> frames_;  // to bake
    std::uint32_t done_ = 0;
    BakeReport report_;
};

}  // namespace

Result<BakeReport> bake(const BakeOptions& options) { return Baking(options).run(); }

}  // namespace brickyard

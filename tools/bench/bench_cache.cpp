#include "tools/bench/bench_cache.h"

#include <fmt/format.h>

#include <algorithm>
#include <glm/geometric.hpp>
#include <map>

#include "core/dataset.h"
#include "tools/conversion.h"

namespace brickyard {
namespace {

constexpr std::size_t kMaxOtherCaches = 4;

const BenchCache kKnownCaches[] = {
    {"plume_fire 24", "sim/plume_fire/fluid_data_0024.vdb", "density"},
    {"jets_256 3", "sim/jets_256/fluid_data_0003.vdb", "density"},
    {"smoke_houdini", "vdb/smoke_houdini.vdb", "density"},
    {"plume_fire_64 30", "sim/plume_fire_64/fluid_data_0030.vdb", "density"},
};

// "plume.0030" and "plume.0024" are one sequence.
std::string sequenceOf(const std::filesystem::path& file) {
    std::string stem = file.stem().string();
    stem.erase(stem.find_last_not_of("0123456789") + 1);
    return stem;
}

glm::dvec3 vectorOf(const google::protobuf::RepeatedField<double>& numbers) {
    return {numbers[0], numbers[1], numbers[2]};
}

Camera cameraFrom(const Camera& framing, const glm::dvec3& eye, const glm::dvec3& target) {
    Camera camera = framing;
    for (int a = 0; a < 3; ++a) {
        camera.set_eye(a, eye[a]);
        camera.set_target(a, target[a]);
    }
    return camera;
}

}  // namespace

Result<std::vector<BenchCache>> findCaches(const std::filesystem::path& data) {
    std::vector<BenchCache> caches;
    std::error_code error;
    for (BenchCache cache : kKnownCaches) {
        cache.file = data / cache.file;
        if (std::filesystem::is_regular_file(cache.file, error)) caches.push_back(cache);
    }
    if (!caches.empty()) return caches;

    std::map<std::string, std::filesystem::path> last;
    for (const auto& entry : std::filesystem::directory_iterator(data, error))
        if (entry.path().extension() == ".vdb")
            last[sequenceOf(entry.path())] = std::max(last[sequenceOf(entry.path())], entry.path());
    for (const auto& [name, file] : last)
        if (caches.size() < kMaxOtherCaches) caches.push_back({file.stem().string(), file, "density"});
    if (caches.empty())
        return fail(ErrorCode::kNotFound,
                    fmt::format("--data {}: holds no .vdb files; name a folder that does", data.string()));
    return caches;
}

Result<BenchDataset> convertCache(const BenchCache& cache, const std::filesystem::path& folder,
                                  double max_error, const std::vector<std::string>& channels) {
    ConversionOptions options;
    options.inputs = {cache.file.string()};
    options.output = folder;
    options.channels = channels;
    options.max_error = max_error;
    const Result<ConversionReport> report = convert(options);
    if (!report) return tl::unexpected(report.error());

    BenchDataset dataset;
    dataset.folder = folder;
    const Result<std::unique_ptr<BrickSource>> source = openSource(folder.string(), /*token=*/"");
    if (!source) return tl::unexpected(source.error());
    dataset.frame = (*source)->manifest().frames(0).frame();
    Result<FrameFooter> footer = (*source)->openFrame(dataset.frame);
    if (!footer) return tl::unexpected(footer.error());
    dataset.footer = std::move(*footer);
    for (const ChannelFooter& channel : dataset.footer.channels())
        if (channel.name() == cache.channel) dataset.density = channel;
    if (dataset.density.active_voxels() == 0)
        return fail(ErrorCode::kNotFound, fmt::format("{}: has nothing in a channel '{}' to draw",
                                                      cache.file.string(), cache.channel));
    return dataset;
}

std::vector<BenchView> benchViews(const ChannelFooter& density) {
    const Camera framing = frameChannel(density, /*aspect=*/1);
    const glm::dvec3 eye = vectorOf(framing.eye()), center = vectorOf(framing.target()), out = eye - center;
    // The frame's sphere has a radius of sin 20 degrees of the distance; a tenth lies well inside of the box.
    return {{"far", cameraFrom(framing, center + 4.0 * out, center)},
            {"framing", framing},
            {"inside", cameraFrom(framing, center + 0.1 * out, center - out)}};
}

Result<RenderOutcome> renderDataset(const BenchDataset& dataset, RenderRequest request) {
    const Result<std::unique_ptr<BrickSource>> source = openSource(dataset.folder.string(), /*token=*/"");
    if (!source) return tl::unexpected(source.error());
    request.frame = dataset.frame;
    return makeCpuRenderer()->render(**source, request);
}

}  // namespace brickyard

#include "tools/bench/bench_cache.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <map>

#include "core/camera_framing.h"
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

// Without a density that could be drawn as a cloud.
const BenchCache kSurfaceCaches[] = {
    {"liquid 6", "sim/liquid/fluid_data_0006.vdb", ""},
};

// "plume.0030" and "plume.0024" are one sequence.
std::string sequenceName(const std::filesystem::path& file) {
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

Result<std::vector<BenchCache>> findAllCaches(const std::filesystem::path& data) {
    Result<std::vector<BenchCache>> caches = findCaches(data);
    std::error_code error;
    for (BenchCache cache : kSurfaceCaches) {
        cache.file = data / cache.file;
        if (caches && std::filesystem::is_regular_file(cache.file, error)) caches->push_back(cache);
    }
    return caches;
}

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
            last[sequenceName(entry.path())] = std::max(last[sequenceName(entry.path())], entry.path());
    for (const auto& [name, file] : last)
        if (caches.size() < kMaxOtherCaches) caches.push_back({file.stem().string(), file, "density"});
    if (caches.empty())
        return fail(ErrorCode::kNotFound,
                    fmt::format("--data {}: holds no .vdb files; name a folder that does", data.string()));
    return caches;
}

std::vector<std::filesystem::path> sequenceOf(const BenchCache& cache) {
    std::vector<std::filesystem::path> files;
    std::error_code error;
    for (const auto& entry : std::filesystem::directory_iterator(cache.file.parent_path(), error))
        if (entry.path().extension() == ".vdb" && sequenceName(entry.path()) == sequenceName(cache.file))
            files.push_back(entry.path());
    std::sort(files.begin(), files.end());
    return files;
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

std::vector<BenchView> outsideViews(const ChannelFooter& density) {
    const Camera framing = frameChannel(density, /*aspect=*/1);
    const glm::dvec3 eye = vectorOf(framing.eye()), center = vectorOf(framing.target());
    return {{"far", cameraFrom(framing, center + 4.0 * (eye - center), center)}, {"framing", framing}};
}

std::vector<Camera> insideCameras(const ChannelFooter& density) {
    const Camera framing = frameChannel(density, /*aspect=*/1);
    const glm::dvec3 center = vectorOf(framing.target());
    const double distance = glm::length(vectorOf(framing.eye()) - center);
    std::vector<Camera> cameras;
    for (int i = 0; i < 6; ++i) {
        // Tilted: a ray along an axis would run in one plane of samples, which no camera of a user's does.
        glm::dvec3 along(0.13, 0.17, 0.11);
        along[i / 2] = i % 2 == 0 ? 1 : -1;
        Camera camera = cameraFrom(framing, center, center + distance * glm::normalize(along));
        // Up and down, the framing's up is parallel to the view.
        if (std::abs(vectorOf(camera.up())[i / 2]) > 0.5)
            for (int a = 0; a < 3; ++a) camera.set_up(a, a == (i / 2 + 1) % 3 ? 1 : 0);
        cameras.push_back(camera);
    }
    return cameras;
}

nlohmann::json cameraJson(const Camera& camera) {
    return {{"eye", std::vector<double>(camera.eye().begin(), camera.eye().end())},
            {"target", std::vector<double>(camera.target().begin(), camera.target().end())},
            {"up", std::vector<double>(camera.up().begin(), camera.up().end())},
            {"vertical_fov_degrees", camera.vertical_fov_degrees()}};
}

Result<RenderOutcome> renderDataset(const BenchDataset& dataset, RenderRequest request) {
    const Result<std::unique_ptr<BrickSource>> source = openSource(dataset.folder.string(), /*token=*/"");
    if (!source) return tl::unexpected(source.error());
    request.frame = dataset.frame;
    return makeCpuRenderer()->render(**source, request);
}

}  // namespace brickyard

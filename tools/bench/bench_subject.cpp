#include "tools/bench/bench_subject.h"

#include <fmt/format.h>

#include <algorithm>

#include "tools/bench/picture_error.h"

namespace brickyard {
namespace {

constexpr double kTypicalDepth = 1.5;
constexpr std::uint32_t kProbeEdge = 64;  // pixels; enough for a median

// Half of those above 0 are at most this; 0 where there are none.
double medianOfHits(std::vector<double> depths) {
    std::erase_if(depths, [](double depth) { return !(depth > 0); });
    if (depths.empty()) return 0;
    const auto middle = depths.begin() + std::ptrdiff_t(depths.size() / 2);
    std::nth_element(depths.begin(), middle, depths.end());
    return *middle;
}

}  // namespace

Result<BenchSubject> prepareSubject(const BenchCache& cache, const std::filesystem::path& folder,
                                    WorkerPool& pool) {
    Result<BenchDataset> dataset = convertCache(cache, folder, /*max_error=*/0, {cache.channel});
    if (!dataset) return tl::unexpected(dataset.error());
    const Result<SourceGrid> grid = SourceGrid::read(cache.file, cache.channel);
    if (!grid) return tl::unexpected(grid.error());
    const auto& numbers = dataset->density.index_to_world();
    const Result<Affine> transform = Affine::fromColumns(std::vector<double>(numbers.begin(), numbers.end()));
    if (!transform) return tl::unexpected(transform.error());
    BenchSubject subject{cache, std::move(*dataset), *transform, *grid, ScalarWalk(*grid), 1, {}};
    subject.views = benchViews(subject.dataset.density);

    for (const BenchView& view : subject.views) {
        if (view.name != "framing") continue;
        const Result<PinholeCamera> camera = PinholeCamera::create(view.camera, kProbeEdge, kProbeEdge);
        if (!camera) return tl::unexpected(camera.error());
        const double median = medianOfHits(subject.walk.depths(*camera, pool.parallelFor()));
        if (!(median > 0))
            return fail(ErrorCode::kInvalid, fmt::format("{}: its density is 0 wherever it is framed; choose "
                                                         "another cache",
                                                         cache.file.string()));
        subject.density_scale = kTypicalDepth / median;
    }
    return subject;
}

Result<ViewTruth> truthOf(const BenchSubject& subject, const BenchView& view, std::uint32_t size,
                          WorkerPool& pool) {
    const Result<PinholeCamera> camera = PinholeCamera::create(view.camera, size, size);
    if (!camera) return tl::unexpected(camera.error());
    const std::vector<double> depths = subject.walk.depths(*camera, pool.parallelFor());
    const auto hits = std::count_if(depths.begin(), depths.end(), [](double depth) { return depth > 0; });
    return ViewTruth{*camera, alphaOf(depths, subject.density_scale),
                     subject.density_scale * medianOfHits(depths), double(hits) / double(depths.size())};
}

RenderRequest requestOf(const BenchSubject& subject, const BenchView& view, std::uint32_t size,
                        const QualitySettings& quality) {
    RenderRequest request;
    request.width = request.height = size;
    request.camera = view.camera;
    request.density_scale = subject.density_scale;
    request.scene.mutable_medium()->set_density(subject.cache.channel);
    request.quality = quality;
    return request;
}

}  // namespace brickyard

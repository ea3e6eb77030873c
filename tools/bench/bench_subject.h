// A cache in every form that a comparison needs, and one camera's view of it with the truth.
#pragma once

#include <string>
#include <vector>

#include "core/affine.h"
#include "core/camera.h"
#include "core/result.h"
#include "tools/bench/bench_cache.h"
#include "tools/bench/scalar_walk.h"
#include "tools/worker_pool.h"

namespace brickyard {

struct BenchSubject {
    BenchCache cache;
    BenchDataset dataset;  // lossless, of the density alone
    Affine transform;      // of the density, index to world
    SourceGrid grid;
    ScalarWalk walk;
    // Chosen so that half of the rays of the framing view that meet something lose at least 78 % of their
    // light (an optical depth of 1.5): neither empty nor opaque.
    double density_scale = 1;
    std::vector<BenchView> views;
};

// Converts into `folder`, which does not exist.
Result<BenchSubject> prepareSubject(const BenchCache& cache, const std::filesystem::path& folder,
                                    WorkerPool& pool);

struct ViewTruth {
    PinholeCamera camera;
    std::vector<float> alpha;
    double median_depth = 0;  // optical depth of the pixels that meet something
    double hit_share = 0;     // of all pixels
};

Result<ViewTruth> truthOf(const BenchSubject& subject, const BenchView& view, std::uint32_t size,
                          WorkerPool& pool);

// A request for the view's picture, absorption alone, with the subject's density scale.
RenderRequest requestOf(const BenchSubject& subject, const BenchView& view, std::uint32_t size,
                        const QualitySettings& quality);

}  // namespace brickyard

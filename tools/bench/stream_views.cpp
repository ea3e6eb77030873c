#include "tools/bench/stream_views.h"

#include <algorithm>
#include <cmath>
#include <glm/vec3.hpp>

#include "core/affine.h"
#include "tools/bench/stream_table.h"

namespace brickyard {

Result<double> streamScale(const BrickStore& store, std::uint32_t channel, const PinholeCamera& camera,
                           double median_depth) {
    const Result<StreamTable> table = StreamTable::create(store, channel, camera, 1);
    if (!table) return tl::unexpected(table.error());
    std::vector<double> depth(table->rayCount(), 0.0);
    for (const StreamStretch& s : table->stretches()) depth[s.ray] += double(table->reference(s));
    std::erase_if(depth, [](double d) { return !(d > 0); });
    if (depth.empty()) return 1.0;
    std::nth_element(depth.begin(), depth.begin() + std::ptrdiff_t(depth.size() / 2), depth.end());
    return median_depth / depth[depth.size() / 2];
}

std::vector<BenchView> streamViews(const ChannelFooter& density) {
    std::vector<BenchView> views = outsideViews(density);
    const std::vector<double> columns(density.index_to_world().begin(), density.index_to_world().end());
    const Affine transform = *Affine::fromColumns(columns);  // the dataset was opened with it
    glm::dvec3 low, high;
    for (int a = 0; a < 3; ++a) low[a] = density.active_min(a), high[a] = density.active_max(a);
    const glm::dvec3 middle = transform.point(0.5 * (low + high)), extent = transform.vector(high - low);
    const double size = std::max({std::abs(extent.x), std::abs(extent.y), std::abs(extent.z)});
    const glm::dvec3 eye = middle + size * glm::dvec3(0.05, -0.15, 0);
    const glm::dvec3 target = middle + size * glm::dvec3(0.3, 0.2, 0.1);
    BenchView inside{"inside", views.back().camera};
    for (int a = 0; a < 3; ++a) inside.camera.set_eye(a, eye[a]), inside.camera.set_target(a, target[a]);
    views.push_back(inside);
    return views;
}

}  // namespace brickyard

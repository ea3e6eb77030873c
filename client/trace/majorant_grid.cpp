#include "client/trace/majorant_grid.h"

#include <algorithm>
#include <cmath>

namespace brickyard {

MajorantGrid::MajorantGrid(const glm::dvec3& low, const glm::dvec3& high, double cell_edge)
    : low_(glm::floor(low / cell_edge) * cell_edge), edge_(cell_edge) {
    std::size_t count = 1;
    for (int a = 0; a < 3; ++a) {
        size_[a] = std::max(1, int(std::ceil((high[a] - low_[a]) / edge_)));
        count *= std::size_t(size_[a]);
    }
    cells_.resize(count);
}

glm::dvec3 MajorantGrid::cellLow(std::size_t index) const {
    const std::size_t x = index % std::size_t(size_[0]), rest = index / std::size_t(size_[0]);
    return low_ + edge_ * glm::dvec3(double(x), double(rest % std::size_t(size_[1])),
                                     double(rest / std::size_t(size_[1])));
}

float MajorantGrid::mostExtinction() const {
    float most = 0;
    for (const MajorantCell& cell : cells_) most = std::max(most, cell.extinction);
    return most;
}

MajorantGrid::Place MajorantGrid::at(const IndexRay& ray, double t) const {
    const double nudge = 1e-7 * edge_ * ray.unitLength();
    Place place{{}, std::numeric_limits<double>::infinity()};
    std::size_t index = 0, stride = 1;
    bool inside = true;
    for (int a = 0; a < 3; ++a) {
        const double position = (ray.origin[a] + (t + nudge) * ray.direction[a] - low_[a]) / edge_;
        const double cell = std::floor(position);
        inside = inside && cell >= 0 && cell < size_[a];
        if (inside) index += std::size_t(cell) * stride;
        stride *= std::size_t(size_[a]);
        if (ray.parallel[a]) continue;
        const double plane = ray.direction[a] > 0 ? cell + 1 : cell;
        place.exit = std::min(place.exit, ray.planeAt(a, low_[a] + plane * edge_));
    }
    place.exit = std::max(place.exit, t + nudge);
    if (inside) place.cell = cells_[index];
    return place;
}

}  // namespace brickyard

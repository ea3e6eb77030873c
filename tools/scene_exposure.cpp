#include "tools/scene_exposure.h"

#include <algorithm>
#include <cmath>

namespace brickyard {

namespace {

// Tells `column` of every column along the two index axes across `up`: its first sample, the way to the next,
// how many, and their distance in world units.
template <class Column>
void forColumns(const SampledField& field, int up, Column&& column) {
    const std::int64_t steps[3] = {1, field.size(0), field.size(0) * field.size(1)};
    for (int axis = 0; axis < 3; ++axis) {
        if (axis == up) continue;
        const int u = (axis + 1) % 3, v = (axis + 2) % 3;
        for (std::int64_t j = 0; j < field.size(v); ++j)
            for (std::int64_t i = 0; i < field.size(u); ++i)
                column(i * steps[u] + j * steps[v], steps[axis], field.size(axis), field.spacing(axis));
    }
}

// REQUIRES: not empty.
double quantileOf(std::vector<double>& values, double part) {
    const auto place = values.begin() + std::ptrdiff_t(part * double(values.size() - 1));
    std::nth_element(values.begin(), place, values.end());
    return *place;
}

}  // namespace

double medianColumn(const SampledField& density, int up) {
    if (density.empty()) return 0;
    std::vector<double> columns;
    double most = 0;
    forColumns(density, up, [&](std::int64_t first, std::int64_t step, std::int64_t count, double spacing) {
        double sum = 0;
        for (std::int64_t i = 0; i < count; ++i)
            sum += std::max(0.0, double(density.value(first + i * step)));
        columns.push_back(sum * spacing);
        most = std::max(most, columns.back());
    });
    // Wisps at the edge say nothing of the middle.
    std::erase_if(columns, [&](double column) { return column <= 0.1 * most; });
    return columns.empty() ? 0 : quantileOf(columns, 0.5);
}

double brightestColumns(const SampledField& density, double density_scale, const Glow& glow, int up) {
    if (density.empty()) return 0;
    std::vector<double> columns;
    forColumns(density, up, [&](std::int64_t first, std::int64_t step, std::int64_t count, double spacing) {
        double seen = 0, passed = 1;
        for (std::int64_t i = 0; i < count; ++i) {
            const std::int64_t at = first + i * step;
            const double depth = density_scale * spacing * std::max(0.0, double(density.value(at)));
            seen += passed * std::exp(-0.5 * depth) * spacing * glow(at);
            passed *= std::exp(-depth);
        }
        if (seen > 0) columns.push_back(seen);
    });
    // Of those that glow at all a tenth of the brightest: a fire in a corner is as bright as one that fills
    // the box.
    if (columns.empty()) return 0;
    const double most = *std::max_element(columns.begin(), columns.end());
    std::erase_if(columns, [&](double column) { return column < 0.1 * most; });
    return quantileOf(columns, 0.98);
}

}  // namespace brickyard

// EnvironmentMap::distantLights: Debevec. A Median Cut Algorithm for Light Probe Sampling. 2005.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>
#include <queue>
#include <utility>
#include <vector>

#include "client/shading/environment_map.h"

namespace brickyard {

namespace {

// Texels [left, right) x [top, bottom).
struct Region {
    std::uint32_t left = 0, right = 0, top = 0, bottom = 0;
    double power = 0;

    bool operator<(const Region& other) const { return power < other.power; }
    bool whole() const { return right - left == 1 && bottom - top == 1; }
};

// The luminance of texels times their solid angle, from the sums within each row.
struct Powers {
    const double* sums = nullptr;
    std::uint32_t width = 0, height = 0;

    double texels(std::uint32_t row, std::uint32_t left, std::uint32_t right) const {
        const double* const begin = sums + std::size_t(row) * width;
        return begin[right - 1] - (left == 0 ? 0 : begin[left - 1]);
    }
    double of(const Region& region) const {
        double sum = 0;
        for (std::uint32_t row = region.top; row < region.bottom; ++row)
            sum += texels(row, region.left, region.right);
        return sum;
    }
    // Across its longer side, as it is on the sphere, where both parts come nearest to the same power.
    // REQUIRES: more than a texel.
    std::pair<Region, Region> split(const Region& region) const {
        const std::uint32_t columns = region.right - region.left, rows = region.bottom - region.top;
        const double middle = std::numbers::pi * 0.5 * (region.top + region.bottom) / height;
        const bool across =
            columns > 1 && (rows == 1 || 2.0 * columns / width * std::sin(middle) > double(rows) / height);
        std::vector<double> slices(across ? columns : rows, 0);
        for (std::uint32_t row = region.top; row < region.bottom; ++row) {
            if (!across) slices[row - region.top] = texels(row, region.left, region.right);
            for (std::uint32_t i = 0; across && i < columns; ++i)
                slices[i] += texels(row, region.left + i, region.left + i + 1);
        }
        std::size_t best = 1;
        double sum = 0, least = HUGE_VAL;
        for (std::size_t cut = 1; cut < slices.size(); ++cut) {
            sum += slices[cut - 1];
            const double difference = std::abs(2 * sum - region.power);
            if (difference < least) least = difference, best = cut;
        }
        Region first = region, second = region;
        if (across)
            first.right = second.left = region.left + std::uint32_t(best);
        else
            first.bottom = second.top = region.top + std::uint32_t(best);
        first.power = of(first);
        second.power = of(second);
        return {first, second};
    }
};

// Points spread evenly over the sphere: a Fibonacci lattice.
std::vector<EnvironmentMap::DistantLight> spread(const glm::dvec3& radiance, std::size_t count) {
    const double golden = std::numbers::pi * (3 - std::sqrt(5.0));
    std::vector<EnvironmentMap::DistantLight> lights(count);
    for (std::size_t i = 0; i < count; ++i) {
        const double z = 1 - (2 * double(i) + 1) / double(count), r = std::sqrt(std::max(0.0, 1 - z * z));
        const double angle = golden * double(i);
        lights[i].to_light = {r * std::cos(angle), r * std::sin(angle), z};
        lights[i].irradiance = radiance * (4 * std::numbers::pi / double(count));
    }
    return lights;
}

}  // namespace

std::vector<EnvironmentMap::DistantLight> EnvironmentMap::distantLights(std::size_t count) const {
    if (!(total_ > 0)) return {};
    count = std::max<std::size_t>(count, 1);
    if (width_ == 0) return spread(constant_, count);

    const Powers powers{texel_cdf_.data(), width_, height_};
    // The strongest is cut next: equal powers where the texels allow, and a sun of one texel takes one light.
    std::priority_queue<Region> regions;
    std::vector<Region> done;
    Region all{0, width_, 0, height_, 0};
    all.power = powers.of(all);
    regions.push(all);
    while (!regions.empty() && regions.size() + done.size() < count) {
        const Region strongest = regions.top();
        regions.pop();
        if (strongest.whole()) {
            done.push_back(strongest);
            continue;
        }
        const auto [first, second] = powers.split(strongest);
        for (const Region& part : {first, second})
            if (part.power > 0) regions.push(part);
    }
    for (; !regions.empty(); regions.pop()) done.push_back(regions.top());

    std::vector<DistantLight> lights;
    for (const Region& region : done) {
        glm::dvec3 irradiance(0), sum(0);
        for (std::uint32_t row = region.top; row < region.bottom; ++row) {
            const double cosine = 0.5 * (rowCosine(row) + rowCosine(row + 1)), solid = texelSolidAngle(row);
            for (std::uint32_t column = region.left; column < region.right; ++column) {
                const glm::dvec3 part = solid * glm::dvec3(texels_[std::size_t(row) * width_ + column]);
                irradiance += part;
                const double weight = 0.2126 * part.x + 0.7152 * part.y + 0.0722 * part.z;
                if (weight > 0) sum += weight * texelDirection(column + 0.5, cosine);
            }
        }
        // A region all around has no middle of its own.
        const glm::dvec3 middle = texelDirection(0.5 * (region.left + region.right),
                                                 0.5 * (rowCosine(region.top) + rowCosine(region.bottom)));
        lights.push_back({glm::length(sum) > 1e-9 * region.power ? glm::normalize(sum) : middle, irradiance});
    }
    return lights;
}

}  // namespace brickyard

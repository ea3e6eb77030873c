#include "dense_light.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <glm/common.hpp>

namespace brickyard {

DenseLight::DenseLight(const FieldSource& source) {
    IndexBox box = source.info().active_box;
    for (std::size_t a = 0; a < 3; ++a) {
        --box.begin[a], ++box.end[a];
        low_[int(a)] = double(box.begin[a]);
        edge_[a] = box.extent(int(a));
    }
    SampleBlock block;
    if (source.read(box, block)) {
        samples_.resize(block.values.size() / sizeof(float));
        std::memcpy(samples_.data(), block.values.data(), block.values.size());
    }
}

template <class Visit>
void DenseLight::walk(const WorldRay& ray, Visit&& visit) const {
    const glm::dvec3 origin = ray.origin - low_;
    double t = 0, end = std::numeric_limits<double>::infinity();
    for (int a = 0; a < 3; ++a) {
        const double p = (0 - origin[a]) / ray.direction[a],
                     q = (double(edge_[a] - 1) - origin[a]) / ray.direction[a];
        t = std::max(t, std::min(p, q));
        end = std::min(end, std::max(p, q));
    }
    if (!(t < end)) return;
    std::int64_t cell[3];
    for (int a = 0; a < 3; ++a)
        cell[a] = std::clamp(std::int64_t(std::floor(origin[a] + t * ray.direction[a])), std::int64_t(0),
                             edge_[a] - 2);
    while (t < end) {
        int axis = 0;
        double exit = end;
        for (int a = 0; a < 3; ++a) {
            const double plane = double(cell[a] + (ray.direction[a] > 0)) - origin[a];
            if (plane / ray.direction[a] < exit) exit = plane / ray.direction[a], axis = a;
        }
        const glm::dvec3 corner(cell[0], cell[1], cell[2]);
        const float* samples = &samples_[std::size_t(cell[0] + edge_[0] * (cell[1] + edge_[1] * cell[2]))];
        if (exit > t && !visit(Step{samples, origin + t * ray.direction - corner,
                                    origin + exit * ray.direction - corner, t, exit}))
            return;
        t = std::max(t, exit);
        cell[axis] += ray.direction[axis] > 0 ? 1 : -1;
        if (cell[axis] < 0 || cell[axis] > edge_[axis] - 2) return;
    }
}

double DenseLight::at(const float* corner, const glm::dvec3& inside) const {
    const std::int64_t row = edge_[0], slice = edge_[0] * edge_[1];
    auto along = [&](const float* c) { return double(c[0]) + (double(c[1]) - double(c[0])) * inside.x; };
    const double low = along(corner) + (along(corner + row) - along(corner)) * inside.y;
    const float* up = corner + slice;
    const double high = along(up) + (along(up + row) - along(up)) * inside.y;
    return low + (high - low) * inside.z;
}

double DenseLight::mean(const Step& step) const {
    constexpr double kGauss = 0.21132486540518711775;  // (1 - 1/sqrt(3)) / 2
    return 0.5 * (at(step.corner, glm::mix(step.from, step.to, kGauss)) +
                  at(step.corner, glm::mix(step.from, step.to, 1 - kGauss)));
}

double DenseLight::depth(const WorldRay& ray) const {
    double sum = 0;
    walk(ray, [&](const Step& step) {
        sum += mean(step) * (step.end - step.begin);
        return true;
    });
    return sum;
}

double DenseLight::scatteredWeight(const WorldRay& ray, double density_scale,
                                   const glm::dvec3& to_light) const {
    double passed = 1, weight = 0;
    walk(ray, [&](const Step& step) {
        const double amount = density_scale * mean(step) * (step.end - step.begin);
        if (!(amount > 0)) return true;
        // Two points in optical depth: shadows are smooth within a cell, and what is absorbed is linear
        // there.
        double lit = 0;
        for (const double s : {0.21132486540518711775, 0.78867513459481288225}) {
            const WorldRay shadow{ray.origin + (step.begin + (step.end - step.begin) * s) * ray.direction,
                                  to_light};
            lit += 0.5 * std::exp(-density_scale * depth(shadow));
        }
        weight += -passed * std::expm1(-amount) * lit;
        passed *= std::exp(-amount);
        return passed > 1e-9;
    });
    return weight;
}

}  // namespace brickyard

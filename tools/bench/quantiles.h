// The middle, the ninety-ninth of a hundred and the largest of many figures. Plain values.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <nlohmann/json.hpp>
#include <vector>

namespace brickyard {

struct Quantiles {
    std::size_t count = 0;
    double p50 = std::nan(""), p99 = std::nan(""), most = std::nan("");  // NaN where there is nothing
};

inline Quantiles quantilesOf(std::vector<float> figures) {
    Quantiles found;
    found.count = figures.size();
    if (figures.empty()) return found;
    std::sort(figures.begin(), figures.end());
    const auto at = [&](double part) {
        return double(figures[std::size_t(part * double(figures.size() - 1) + 0.5)]);
    };
    found.p50 = at(0.5);
    found.p99 = at(0.99);
    found.most = double(figures.back());
    return found;
}

inline nlohmann::json toJson(const Quantiles& quantiles) {
    return {
        {"count", quantiles.count}, {"p50", quantiles.p50}, {"p99", quantiles.p99}, {"max", quantiles.most}};
}

}  // namespace brickyard

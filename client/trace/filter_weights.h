// Reconstruction kernels over four neighbouring samples. Pure functions, any thread.
// Mitchell, Netravali. Reconstruction Filters in Computer Graphics. 1988.
#pragma once

#include <cmath>

#include "client/world_settings.h"

namespace brickyard {

// Weights of the samples at -1, 0, 1 and 2 for a position `t` in [0, 1) between 0 and 1; they add up to 1.
inline void filterWeights(FieldFilter filter, double t, double (&weights)[4]) {
    // The family of Mitchell and Netravali: (1, 0) is the B-spline, (0, 1/2) Catmull and Rom's.
    auto cubic = [&](double b, double c) {
        const double distance[4] = {1 + t, t, 1 - t, 2 - t};
        for (int i = 0; i < 4; ++i) {
            const double x = distance[i], x2 = x * x, x3 = x2 * x;
            weights[i] = (x < 1 ? (12 - 9 * b - 6 * c) * x3 + (-18 + 12 * b + 6 * c) * x2 + (6 - 2 * b)
                                : (-b - 6 * c) * x3 + (6 * b + 30 * c) * x2 + (-12 * b - 48 * c) * x +
                                      (8 * b + 24 * c)) /
                         6;
        }
    };
    switch (filter) {
        case FieldFilter::kBSpline: return cubic(1, 0);
        case FieldFilter::kCatmullRom: return cubic(0, 0.5);
        case FieldFilter::kMitchell: return cubic(1.0 / 3, 1.0 / 3);
        case FieldFilter::kGaussian: {
            double sum = 0;
            for (int i = 0; i < 4; ++i) {
                const double x = t - (i - 1);
                weights[i] = std::exp(-2 * x * x);
                sum += weights[i];
            }
            for (double& weight : weights) weight /= sum;
            return;
        }
        case FieldFilter::kNearest:
        case FieldFilter::kTrilinear:
            weights[0] = weights[3] = 0;
            weights[1] = filter == FieldFilter::kNearest ? double(t < 0.5) : 1 - t;
            weights[2] = 1 - weights[1];
    }
}

// Samples on either side that value() may reach beyond a cell.
inline int filterReach(FieldFilter filter) {
    return filter == FieldFilter::kNearest || filter == FieldFilter::kTrilinear ? 0 : 1;
}
// What values may exceed the range of the samples by, as a share of the range: negative lobes.
inline double filterOvershoot(FieldFilter filter) {
    // Sum of magnitudes of the weights at their worst, cubed, less one, halved: 1.25 for Catmull and Rom's,
    // 1.1389 for Mitchell's at t = 1/2.
    if (filter == FieldFilter::kCatmullRom) return 0.5 * (1.25 * 1.25 * 1.25 - 1);
    if (filter == FieldFilter::kMitchell) return 0.5 * (1.139 * 1.139 * 1.139 - 1);
    return 0;
}

}  // namespace brickyard

#include "core/level_reduction.h"

#include <cmath>
#include <cstddef>

namespace brickyard {

std::vector<double> reduceLevel(std::span<const double> fine, int edge_cells) {
    const std::size_t f = std::size_t(2 * edge_cells + 3), c = std::size_t(edge_cells + 1);
    auto weighted = [](double a, double b, double d) { return 0.25 * a + 0.5 * b + 0.25 * d; };

    // One axis after the other; each halves what the next has to read.
    std::vector<double> x(c * f * f);
    for (std::size_t row = 0; row < f * f; ++row)
        for (std::size_t i = 0; i < c; ++i) {
            const double* in = fine.data() + row * f + 2 * i;
            x[row * c + i] = weighted(in[0], in[1], in[2]);
        }
    std::vector<double> y(c * c * f);
    for (std::size_t k = 0; k < f; ++k)
        for (std::size_t j = 0; j < c; ++j)
            for (std::size_t i = 0; i < c; ++i) {
                const double* in = x.data() + (k * f + 2 * j) * c + i;
                y[(k * c + j) * c + i] = weighted(in[0], in[c], in[2 * c]);
            }
    std::vector<double> z(c * c * c);
    for (std::size_t k = 0; k < c; ++k)
        for (std::size_t i = 0; i < c * c; ++i) {
            const double* in = y.data() + 2 * k * c * c + i;
            z[k * c * c + i] = weighted(in[0], in[c * c], in[2 * c * c]);
        }
    return z;
}

double reductionRms(std::span<const double> fine, std::span<const double> coarse, int edge_cells,
                    double scale) {
    const std::size_t f = std::size_t(2 * edge_cells + 3), c = std::size_t(edge_cells + 1),
                      n = std::size_t(2 * edge_cells + 1);
    const double inverse = 1 / scale;
    double sum = 0;
    for (std::size_t k = 0; k < n; ++k)
        for (std::size_t j = 0; j < n; ++j)
            for (std::size_t i = 0; i < n; ++i) {
                // At a half-way position the neighbours average; at a lattice position both are the same
                // sample.
                double value = 0;
                for (std::size_t corner = 0; corner < 8; ++corner) {
                    const std::size_t ci = (i + (corner & 1)) / 2, cj = (j + (corner >> 1 & 1)) / 2;
                    const std::size_t ck = (k + (corner >> 2)) / 2;
                    value += 0.125 * coarse[(ck * c + cj) * c + ci];
                }
                const double d = (value - fine[((k + 1) * f + j + 1) * f + i + 1]) * inverse;
                sum += d * d;
            }
    return scale * std::sqrt(sum / double(n * n * n));
}

}  // namespace brickyard

#include "core/level_reduction.h"

#include <cmath>
#include <cstdint>
#include <type_traits>
#include <vector>

#include "core/vector_clones.h"

namespace brickyard {

namespace {

// Loops over plain arrays, written so that a compiler turns them into vectors.
BRICKYARD_VECTOR_CLONES
void weightRows(const double* a, const double* b, const double* c, std::size_t n, double* out) {
    for (std::size_t i = 0; i < n; ++i) out[i] = 0.25 * a[i] + 0.5 * b[i] + 0.25 * c[i];
}

BRICKYARD_VECTOR_CLONES
void weightFloatRows(const float* a, const float* b, const float* c, std::size_t n, double* out) {
    for (std::size_t i = 0; i < n; ++i)
        out[i] = 0.25 * double(a[i]) + 0.5 * double(b[i]) + 0.25 * double(c[i]);
}

BRICKYARD_VECTOR_CLONES
void weightPairs(const double* in, std::size_t n, double* out) {
    for (std::size_t i = 0; i < n; ++i)
        out[i] = 0.25 * in[2 * i] + 0.5 * in[2 * i + 1] + 0.25 * in[2 * i + 2];
}

template <class T>
void weightTypedRows(const T* a, const T* b, const T* c, std::size_t n, double* out) {
    if constexpr (std::is_same_v<T, float>)
        weightFloatRows(a, b, c, n, out);
    else if constexpr (std::is_same_v<T, double>)
        weightRows(a, b, c, n, out);
    else
        for (std::size_t i = 0; i < n; ++i)
            out[i] = 0.25 * double(a[i]) + 0.5 * double(b[i]) + 0.25 * double(c[i]);
}

// The deviations of one row of 2n + 1 fine samples from a coarse row of n + 1, squared and summed.
#define BRICKYARD_ROW_SQUARES(T)                                                                      \
    BRICKYARD_VECTOR_CLONES                                                                           \
    double squaresOf(const T* fine, const double* coarse, std::size_t n, double inverse) {            \
        /* Eight sums that do not depend on each other. */                                            \
        constexpr std::size_t kLanes = 4;                                                             \
        double even[kLanes]{}, odd[kLanes]{};                                                         \
        std::size_t i = 0;                                                                            \
        for (; i + kLanes <= n; i += kLanes)                                                          \
            for (std::size_t k = 0; k < kLanes; ++k) {                                                \
                const double d = (coarse[i + k] - double(fine[2 * (i + k)])) * inverse;               \
                const double e =                                                                      \
                    (0.5 * coarse[i + k] + 0.5 * coarse[i + k + 1] - double(fine[2 * (i + k) + 1])) * \
                    inverse;                                                                          \
                even[k] += d * d;                                                                     \
                odd[k] += e * e;                                                                      \
            }                                                                                         \
        const double last = (coarse[n] - double(fine[2 * n])) * inverse;                              \
        double sum = last * last;                                                                     \
        for (std::size_t k = 0; k < kLanes; ++k) sum += even[k] + odd[k];                             \
        return sum;                                                                                   \
    }
BRICKYARD_ROW_SQUARES(float)
BRICKYARD_ROW_SQUARES(double)
BRICKYARD_ROW_SQUARES(std::int32_t)
BRICKYARD_ROW_SQUARES(std::int64_t)
BRICKYARD_ROW_SQUARES(std::uint8_t)
#undef BRICKYARD_ROW_SQUARES

}  // namespace

template <class T>
void reduceLevel(SampleCube<T> fine, const std::array<std::size_t, 3>& extent, SampleTarget coarse) {
    const auto [nx, ny, nz] = extent;
    const std::size_t fx = 2 * nx + 1;
    // y first, because rows are read as they lie; then x; then z, over three planes that are kept.
    thread_local std::vector<double> scratch;
    scratch.resize(fx + 3 * nx * ny);
    double* const row = scratch.data();
    const auto planeAt = [&](std::size_t k) { return scratch.data() + fx + k % 3 * nx * ny; };
    for (std::size_t k = 0; k < 2 * nz + 1; ++k) {
        double* const plane = planeAt(k);
        for (std::size_t j = 0; j < ny; ++j) {
            weightTypedRows(fine.rowAt(2 * j, k), fine.rowAt(2 * j + 1, k), fine.rowAt(2 * j + 2, k), fx,
                            row);
            weightPairs(row, nx, plane + j * nx);
        }
        if (k < 2 || k % 2 != 0) continue;
        for (std::size_t j = 0; j < ny; ++j)
            weightRows(planeAt(k - 2) + j * nx, planeAt(k - 1) + j * nx, plane + j * nx, nx,
                       coarse.first + (k / 2 - 1) * coarse.plane + j * coarse.row);
    }
}

template <class T>
double reductionRms(SampleCube<T> fine, SampleCube<double> coarse, int edge_cells, double scale) {
    const std::size_t c = std::size_t(edge_cells), n = 2 * c + 1;
    const double inverse = 1 / scale;
    thread_local std::vector<double> middle;
    middle.resize(c + 1);
    double sum = 0;
    for (std::size_t k = 0; k < n; ++k)
        for (std::size_t j = 0; j < n; ++j) {
            // At a half-way position the neighbours average; at a lattice position both are the same sample.
            const double* row = coarse.rowAt(j / 2, k / 2);
            if (j % 2 != 0 || k % 2 != 0) {
                const double* const a = row;
                const double* const b = coarse.rowAt((j + 1) / 2, k / 2);
                const double* const p = coarse.rowAt(j / 2, (k + 1) / 2);
                const double* const q = coarse.rowAt((j + 1) / 2, (k + 1) / 2);
                for (std::size_t i = 0; i <= c; ++i)
                    middle[i] = 0.25 * a[i] + 0.25 * b[i] + 0.25 * p[i] + 0.25 * q[i];
                row = middle.data();
            }
            sum += squaresOf(fine.rowAt(j, k), row, c, inverse);
        }
    return scale * std::sqrt(sum / double(n * n * n));
}

#define BRICKYARD_INSTANTIATE(T)                                                                  \
    template void reduceLevel<T>(SampleCube<T>, const std::array<std::size_t, 3>&, SampleTarget); \
    template double reductionRms<T>(SampleCube<T>, SampleCube<double>, int, double);
BRICKYARD_INSTANTIATE(float)
BRICKYARD_INSTANTIATE(double)
BRICKYARD_INSTANTIATE(std::int32_t)
BRICKYARD_INSTANTIATE(std::int64_t)
BRICKYARD_INSTANTIATE(std::uint8_t)
#undef BRICKYARD_INSTANTIATE

}  // namespace brickyard

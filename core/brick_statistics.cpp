#include "core/brick_statistics.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/float_rounding.h"
#include "core/vector_clones.h"

namespace brickyard {

namespace {

// Loops over plain arrays, written so that a compiler turns them into vectors: eight comparisons side by
// side, because the order of floating-point operations may not be changed for us.
#define BRICKYARD_RANGE(T)                                                   \
    BRICKYARD_VECTOR_CLONES                                                  \
    void includeRange(const T* values, std::size_t n, T& min, T& max) {      \
        constexpr std::size_t kLanes = 8;                                    \
        std::size_t i = 0;                                                   \
        T low[kLanes], high[kLanes];                                         \
        std::fill_n(low, kLanes, min);                                       \
        std::fill_n(high, kLanes, max);                                      \
        for (; i + kLanes <= n; i += kLanes)                                 \
            for (std::size_t k = 0; k < kLanes; ++k) {                       \
                low[k] = values[i + k] < low[k] ? values[i + k] : low[k];    \
                high[k] = values[i + k] > high[k] ? values[i + k] : high[k]; \
            }                                                                \
        for (; i < n; ++i) {                                                 \
            min = std::min(min, values[i]);                                  \
            max = std::max(max, values[i]);                                  \
        }                                                                    \
        for (std::size_t k = 0; k < kLanes; ++k) {                           \
            min = std::min(min, low[k]);                                     \
            max = std::max(max, high[k]);                                    \
        }                                                                    \
    }
BRICKYARD_RANGE(float)
BRICKYARD_RANGE(double)
BRICKYARD_RANGE(std::int32_t)
BRICKYARD_RANGE(std::int64_t)
BRICKYARD_RANGE(std::uint8_t)
#undef BRICKYARD_RANGE

// Column by column over rows of n samples: low and high of each.
#define BRICKYARD_COLUMN_RANGES(T)                                                                  \
    BRICKYARD_VECTOR_CLONES                                                                         \
    void includeColumns(const T* samples, std::size_t row, std::size_t rows, std::size_t n, T* low, \
                        T* high) {                                                                  \
        for (std::size_t j = 0; j < rows; ++j, samples += row)                                      \
            for (std::size_t i = 0; i < n; ++i) {                                                   \
                low[i] = samples[i] < low[i] ? samples[i] : low[i];                                 \
                high[i] = samples[i] > high[i] ? samples[i] : high[i];                              \
            }                                                                                       \
    }
BRICKYARD_COLUMN_RANGES(float)
BRICKYARD_COLUMN_RANGES(double)
BRICKYARD_COLUMN_RANGES(std::int32_t)
BRICKYARD_COLUMN_RANGES(std::int64_t)
BRICKYARD_COLUMN_RANGES(std::uint8_t)
#undef BRICKYARD_COLUMN_RANGES

}  // namespace

template <class T>
OwnedRange describeSamples(SampleCube<T> samples, BrickShape shape, double background, bool first,
                           NodeRecord& record) {
    const int s = shape.edgeSamples(), n = shape.edge_cells;
    // Owned samples, and those on the far faces, which are not.
    std::array<T, kMaxBrickEdge> columns_low, columns_high;
    columns_low.fill(samples.at(0, 0, 0));
    columns_high.fill(samples.at(0, 0, 0));
    std::array<T, kMaxBrickEdge> face_low = columns_low, face_high = columns_high;
    T last_low = columns_low[0], last_high = last_low;
    const auto edge = std::size_t(n);
    for (std::size_t k = 0; k <= edge; ++k) {
        if (k < edge) {
            includeColumns(samples.rowAt(0, k), samples.row, edge, edge, columns_low.data(),
                           columns_high.data());
            includeColumns(samples.rowAt(edge, k), samples.row, 1, edge, face_low.data(), face_high.data());
        } else {
            includeColumns(samples.rowAt(0, k), samples.row, edge + 1, edge, face_low.data(),
                           face_high.data());
        }
        for (std::size_t j = 0; j <= edge; ++j) {
            last_low = std::min(last_low, samples.at(edge, j, k));
            last_high = std::max(last_high, samples.at(edge, j, k));
        }
    }
    const T owned_min = *std::min_element(columns_low.begin(), columns_low.begin() + n);
    const T owned_max = *std::max_element(columns_high.begin(), columns_high.begin() + n);
    const T min = std::min({owned_min, last_low, *std::min_element(face_low.begin(), face_low.begin() + n)});
    const T max =
        std::max({owned_max, last_high, *std::max_element(face_high.begin(), face_high.begin() + n)});
    const float rounded_min = roundDown(double(min)), rounded_max = roundUp(double(max));
    record.value_min = first ? rounded_min : std::min(record.value_min, rounded_min);
    record.value_max = first ? rounded_max : std::max(record.value_max, rounded_max);

    std::array<int, 3> low{s, s, s}, high{-1, -1, -1};
    for (int k = 0; k < s; ++k)
        for (int j = 0; j < s; ++j) {
            const T* const row = samples.rowAt(std::size_t(j), std::size_t(k));
            int begin = 0, end = s;
            while (begin < s && double(row[begin]) == background) ++begin;
            if (begin == s) continue;
            while (double(row[end - 1]) == background) --end;
            low = {std::min(low[0], begin), std::min(low[1], j), std::min(low[2], k)};
            high = {std::max(high[0], end - 1), std::max(high[1], j), std::max(high[2], k)};
        }
    const OwnedRange owned{double(owned_min), double(owned_max)};
    if (high[0] < 0) return owned;
    const bool empty = record.box_end[0] <= record.box_begin[0];
    for (std::size_t a = 0; a < 3; ++a) {
        // A sample touches the cells on both sides of it.
        const int begin = std::max(low[a] - 1, 0), end = std::min(high[a] + 1, n);
        record.box_begin[a] = std::uint8_t(empty ? begin : std::min<int>(record.box_begin[a], begin));
        record.box_end[a] = std::uint8_t(empty ? end : std::max<int>(record.box_end[a], end));
    }
    return owned;
}

template <class T>
bool oneValue(SampleCube<T> samples, BrickShape shape) {
    const std::size_t s = std::size_t(shape.edgeSamples());
    const T* const first = samples.first;
    if (std::memcmp(first, first + 1, (s - 1) * sizeof(T)) != 0) return false;
    for (std::size_t k = 0; k < s; ++k)
        for (std::size_t j = 0; j < s; ++j)
            if (std::memcmp(first, samples.rowAt(j, k), s * sizeof(T)) != 0) return false;
    return true;
}

template <class T>
void includeActive(SampleCube<T> samples, SampleCube<std::uint8_t> active, BrickShape shape, bool& any,
                   double& min, double& max) {
    const std::size_t n = std::size_t(shape.edge_cells);
    bool found = false;
    T low{}, high{};
    for (std::size_t k = 0; k < n; ++k)
        for (std::size_t j = 0; j < n; ++j) {
            const T* const row = samples.rowAt(j, k);
            const std::uint8_t* const states = active.rowAt(j, k);
            const std::size_t count = std::size_t(std::count(states, states + n, std::uint8_t(1)));
            if (count == n) {
                if (!found) low = high = row[0];
                found = true;
                includeRange(row, n, low, high);
            } else if (count > 0) {
                for (std::size_t i = 0; i < n; ++i) {
                    if (states[i] == 0) continue;
                    low = found ? std::min(low, row[i]) : row[i];
                    high = found ? std::max(high, row[i]) : row[i];
                    found = true;
                }
            }
        }
    if (!found) return;
    min = any ? std::min(min, double(low)) : double(low);
    max = any ? std::max(max, double(high)) : double(high);
    any = true;
}

ActiveVoxels countActive(SampleCube<std::uint8_t> active, BrickShape shape) {
    const int n = shape.edge_cells;
    ActiveVoxels found;
    std::array<int, 3> low{n, n, n}, high{-1, -1, -1};
    for (int k = 0; k < n; ++k)
        for (int j = 0; j < n; ++j) {
            const std::uint8_t* const row = active.rowAt(std::size_t(j), std::size_t(k));
            int begin = 0, end = n;
            while (begin < n && row[begin] == 0) ++begin;
            if (begin == n) continue;
            while (row[end - 1] == 0) --end;
            found.count += std::size_t(std::count(row + begin, row + end, std::uint8_t(1)));
            low = {std::min(low[0], begin), std::min(low[1], j), std::min(low[2], k)};
            high = {std::max(high[0], end - 1), std::max(high[1], j), std::max(high[2], k)};
        }
    if (found.count == 0) return found;
    found.begin = low;
    for (std::size_t a = 0; a < 3; ++a) found.end[a] = high[a] + 1;
    return found;
}

#define BRICKYARD_INSTANTIATE(T)                                                                        \
    template OwnedRange describeSamples<T>(SampleCube<T>, BrickShape, double, bool, NodeRecord&);       \
    template bool oneValue<T>(SampleCube<T>, BrickShape);                                               \
    template void includeActive<T>(SampleCube<T>, SampleCube<std::uint8_t>, BrickShape, bool&, double&, \
                                   double&);
BRICKYARD_INSTANTIATE(float)
BRICKYARD_INSTANTIATE(double)
BRICKYARD_INSTANTIATE(std::int32_t)
BRICKYARD_INSTANTIATE(std::int64_t)
BRICKYARD_INSTANTIATE(std::uint8_t)
#undef BRICKYARD_INSTANTIATE

}  // namespace brickyard

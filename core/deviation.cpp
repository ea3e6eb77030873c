#include "core/deviation.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "core/vector_clones.h"

namespace brickyard {

namespace {

// One axis of a part, in cells of the node: from the position of its first sample.
struct Axis {
    double begin = 0;  // in [0, N)
    int first_cell = 0;
};

struct Placement {
    std::array<Axis, 3> axis;
    double step = 1;  // node cells per level-0 sample
};

Placement place(const NodeKey& node, const NodeKey& part, BrickShape shape) {
    Placement p;
    p.step = std::ldexp(1.0, -node.level);
    const int down = node.level - part.level;
    const std::array<std::int64_t, 3> node_at{node.x, node.y, node.z}, part_at{part.x, part.y, part.z};
    for (std::size_t a = 0; a < 3; ++a) {
        const std::int64_t bricks_in = part_at[a] - (node_at[a] << down);  // in [0, 2^down)
        p.axis[a].begin = std::ldexp(double(bricks_in) * shape.edge_cells, -down);
        p.axis[a].first_cell = std::min(int(p.axis[a].begin), shape.edge_cells - 1);
    }
    return p;
}

int gridIndex(int x, int y, int z) { return x + kErrorGridEdge * (y + kErrorGridEdge * z); }

// The loops below are over plain arrays, written so that a compiler turns them into vectors. `below` and
// `above` are planes of (n + 1)^2 values, between which the field is interpolated at `t`.
#define BRICKYARD_BAND_DEVIATION(T)                                                                       \
    BRICKYARD_VECTOR_CLONES                                                                               \
    void bandDeviation(const double* below, const double* above, double t, const T* samples,              \
                       std::size_t row, std::size_t n, std::size_t rows, double inverse, double* largest, \
                       double* squares) {                                                                 \
        for (std::size_t j = 0; j <= rows; ++j) {                                                         \
            const double* const a = below + j * (n + 1);                                                  \
            const double* const b = above + j * (n + 1);                                                  \
            const T* const s = samples + j * row;                                                         \
            if (squares && j < rows) {                                                                    \
                for (std::size_t i = 0; i < n; ++i) {                                                     \
                    const double d = std::abs(a[i] + (b[i] - a[i]) * t - double(s[i]));                   \
                    largest[i] = d > largest[i] ? d : largest[i];                                         \
                    squares[i] += (d * inverse) * (d * inverse);                                          \
                }                                                                                         \
            } else {                                                                                      \
                for (std::size_t i = 0; i < n; ++i) {                                                     \
                    const double d = std::abs(a[i] + (b[i] - a[i]) * t - double(s[i]));                   \
                    largest[i] = d > largest[i] ? d : largest[i];                                         \
                }                                                                                         \
            }                                                                                             \
            const double d = std::abs(a[n] + (b[n] - a[n]) * t - double(s[n]));                           \
            largest[n] = d > largest[n] ? d : largest[n];                                                 \
        }                                                                                                 \
    }
BRICKYARD_BAND_DEVIATION(float)
BRICKYARD_BAND_DEVIATION(double)
BRICKYARD_BAND_DEVIATION(std::int32_t)
BRICKYARD_BAND_DEVIATION(std::int64_t)
BRICKYARD_BAND_DEVIATION(std::uint8_t)
#undef BRICKYARD_BAND_DEVIATION

// One row of residuals into the sums of its cells: `sums` holds four arrays of n, for the corners (y, z)
// below and above.
BRICKYARD_VECTOR_CLONES
void addResidualRow(const double* residual, std::size_t n, const double* weights, double* sums,
                    double* squares) {
    for (std::size_t i = 0; i < n; ++i) {
        const double r = residual[i];
        sums[i] += weights[0] * r;
        sums[n + i] += weights[1] * r;
        sums[2 * n + i] += weights[2] * r;
        sums[3 * n + i] += weights[3] * r;
        squares[i] += r * r;
    }
}

BRICKYARD_VECTOR_CLONES
void mixRows(const double* a, const double* b, double t, std::size_t n, double* out) {
    for (std::size_t i = 0; i < n; ++i) out[i] = a[i] + (b[i] - a[i]) * t;
}

// The node's field at the level-0 samples of a brick below it, interpolated along x and y: planes at the
// node's own lattice positions along z, of which two at a time are asked for.
class ExpandedPlanes {
public:
    // `first`: the node's sample at the brick's first corner; `factor`: level-0 samples per cell of the node.
    ExpandedPlanes(SampleCube<double> first, int n, int factor)
        : first_(first), n_(std::size_t(n)), factor_(std::size_t(factor)), cells_(n_ / factor_) {
        thread_local std::vector<double> buffer;
        const std::size_t plane = (n_ + 1) * (n_ + 1), rows = (cells_ + 1) * (n_ + 1);
        buffer.resize(2 * plane + rows);
        planes_ = {buffer.data(), buffer.data() + plane};
        rows_ = buffer.data() + 2 * plane;
        expand(0, planes_[0]);
    }
    std::size_t cells() const { return cells_; }
    // Planes z and z + 1. Called with rising z, each once.
    std::pair<const double*, const double*> between(std::size_t z) {
        if (z > 0) std::swap(planes_[0], planes_[1]);
        expand(z + 1, planes_[1]);
        return {planes_[0], planes_[1]};
    }

private:
    void expand(std::size_t z, double* out) {
        for (std::size_t j = 0; j <= cells_; ++j) {
            const double* const in = first_.rowAt(j, z);
            double* const row = rows_ + j * (n_ + 1);
            for (std::size_t c = 0; c < cells_; ++c)
                for (std::size_t i = 0; i < factor_; ++i)
                    row[c * factor_ + i] = in[c] + (in[c + 1] - in[c]) * (double(i) / double(factor_));
            row[n_] = in[cells_];
        }
        for (std::size_t j = 0; j <= n_; ++j) {
            const std::size_t cell = std::min(j / factor_, cells_ - 1);
            const double* const a = rows_ + cell * (n_ + 1);
            if (j == n_)
                std::copy_n(a + n_ + 1, n_ + 1, out + j * (n_ + 1));
            else
                mixRows(a, a + n_ + 1, double(j % factor_) / double(factor_), n_ + 1, out + j * (n_ + 1));
        }
    }

    SampleCube<double> first_;
    std::size_t n_, factor_, cells_;
    std::array<double*, 2> planes_{};
    double* rows_ = nullptr;
};

// Sums over the m^3 level-0 samples of a cell (half-open), of products of two corner weights: c^T W d.
class CellProducts {
public:
    explicit CellProducts(int level) {
        // Sums over i in [0, m) of the products of the two hat weights (1 - i/m) and i/m.
        const double m = std::ldexp(1.0, level);
        const double s1 = (m - 1) / 2, s2 = (m - 1) * (2 * m - 1) / (6 * m);
        axis_ = {{{m - 2 * s1 + s2, s1 - s2}, {s1 - s2, s2}}};
    }
    // W d, axis by axis.
    std::array<double, 8> applied(std::array<double, 8> d) const {
        for (const int bit : {1, 2, 4})
            for (int q = 0; q < 8; ++q) {
                if ((q & bit) != 0) continue;
                const double low = d[std::size_t(q)], high = d[std::size_t(q | bit)];
                d[std::size_t(q)] = axis_[0][0] * low + axis_[0][1] * high;
                d[std::size_t(q | bit)] = axis_[1][0] * low + axis_[1][1] * high;
            }
        return d;
    }

private:
    std::array<std::array<double, 2>, 2> axis_{};
};

double dot(const std::array<double, 8>& a, const std::array<double, 8>& b) {
    double sum = 0;
    for (std::size_t q = 0; q < 8; ++q) sum += a[q] * b[q];
    return sum;
}

// Trilinear interpolation between 8 corners, corner q at (q & 1, q >> 1 & 1, q >> 2).
double between(const std::array<double, 8>& corners, const std::array<double, 3>& t) {
    double sum = 0;
    for (std::size_t q = 0; q < 8; ++q) {
        const double weight =
            ((q & 1) ? t[0] : 1 - t[0]) * ((q & 2) ? t[1] : 1 - t[1]) * ((q & 4) ? t[2] : 1 - t[2]);
        if (weight != 0) sum += weight * corners[q];
    }
    return sum;
}

// The node's field less `value` at the corners of a piece of one of its cells, and the largest of them.
std::pair<std::array<double, 8>, double> deviationsOf(SampleCube<double> samples,
                                                      const std::array<int, 3>& cell,
                                                      const std::array<double, 3>& from, double piece,
                                                      double value) {
    std::array<double, 8> corners, deviations;
    for (int q = 0; q < 8; ++q)
        corners[std::size_t(q)] =
            samples.at(std::size_t(cell[0] + (q & 1)), std::size_t(cell[1] + (q >> 1 & 1)),
                       std::size_t(cell[2] + (q >> 2)));
    double largest = 0;
    for (int q = 0; q < 8; ++q) {
        std::array<double, 3> t;
        for (std::size_t a = 0; a < 3; ++a) t[a] = from[a] + ((q >> a & 1) ? piece : 0);
        deviations[std::size_t(q)] = between(corners, t) - value;
        largest = std::max(largest, std::abs(deviations[std::size_t(q)]));
    }
    return {deviations, largest};
}

// The parts of a region of one value as cells of the node, or as one piece of a cell.
template <class Visit>
void forPieces(const NodeKey& node, const NodeKey& part, BrickShape shape, Visit&& visit) {
    const Placement placed = place(node, part, shape);
    const double extent = std::ldexp(double(shape.edge_cells), part.level - node.level);
    const int cells = std::max(1, int(extent));
    const double piece = std::min(1.0, extent);  // in cells of the node
    std::array<double, 3> from{};
    if (extent < 1)
        for (std::size_t a = 0; a < 3; ++a) from[a] = placed.axis[a].begin - placed.axis[a].first_cell;
    for (int z = 0; z < cells; ++z)
        for (int y = 0; y < cells; ++y)
            for (int x = 0; x < cells; ++x)
                visit(std::array<int, 3>{placed.axis[0].first_cell + x, placed.axis[1].first_cell + y,
                                         placed.axis[2].first_cell + z},
                      from, piece);
}

// The cells of a measured brick: for each, the cell of the node it lies in, where in it, and the deviation of
// the node's field from the brick's at its corners, in units of `scale`.
template <class Visit>
void forMeasuredCells(const NodeKey& node, SampleCube<double> node_samples, const MeasuredBrick& part,
                      BrickShape shape, double scale, Visit&& visit) {
    const Placement placed = place(node, part.key, shape);
    const int n = shape.edge_cells, factor = 1 << (node.level - part.key.level);
    const double inverse = 1 / scale;
    std::vector<double> deviations((std::size_t(n) + 1) * (std::size_t(n) + 1) * (std::size_t(n) + 1));
    ExpandedPlanes planes(
        node_samples.from(std::size_t(placed.axis[0].first_cell), std::size_t(placed.axis[1].first_cell),
                          std::size_t(placed.axis[2].first_cell)),
        n, factor);
    const std::size_t edge = std::size_t(n) + 1;
    for (std::size_t cell = 0; cell < planes.cells(); ++cell) {
        const auto [below, above] = planes.between(cell);
        const bool last = cell + 1 == planes.cells();
        for (int step = 0; step < factor + (last ? 1 : 0); ++step) {
            const std::size_t k = cell * std::size_t(factor) + std::size_t(step);
            for (std::size_t j = 0; j < edge; ++j)
                for (std::size_t i = 0; i < edge; ++i) {
                    const double a = below[j * edge + i], b = above[j * edge + i];
                    const double field = step == factor ? b : a + (b - a) * (double(step) / factor);
                    deviations[(k * edge + j) * edge + i] = (field - part.samples.at(i, j, k)) * inverse;
                }
        }
    }
    const double piece = 1.0 / factor;
    for (int k = 0; k < n; ++k)
        for (int j = 0; j < n; ++j)
            for (int i = 0; i < n; ++i) {
                std::array<double, 8> corners;
                for (int q = 0; q < 8; ++q)
                    corners[std::size_t(q)] =
                        deviations[shape.sampleAt(i + (q & 1), j + (q >> 1 & 1), k + (q >> 2))];
                const std::array<int, 3> at{i, j, k};
                std::array<int, 3> cell;
                std::array<double, 3> from;
                for (std::size_t a = 0; a < 3; ++a) {
                    cell[a] = placed.axis[a].first_cell + at[a] / factor;
                    from[a] = (at[a] % factor) * piece;
                }
                visit(cell, from, piece, corners, shape.cellAt(i, j, k));
            }
}

// Adds the residual of a piece of a cell of the node to that cell: `moments` and `squares` are of the piece,
// for the deviation r = level 0 - the node's field, against the piece's own corners.
void addPiece(const std::array<double, 8>& moments, double squares, double largest,
              const std::array<double, 3>& from, double piece, CellResidual& out) {
    for (int corner = 0; corner < 8; ++corner) {
        // The node's weight of `corner` at the corners of the piece.
        for (int q = 0; q < 8; ++q) {
            double weight = 1;
            for (int a = 0; a < 3; ++a) {
                const double t = from[std::size_t(a)] + ((q >> a & 1) ? piece : 0);
                weight *= (corner >> a & 1) ? t : 1 - t;
            }
            out.moments[std::size_t(corner)] += weight * moments[std::size_t(q)];
        }
    }
    out.squares += squares;
    out.largest = std::max(out.largest, largest);
}

}  // namespace

bool hasOneValue(const NodeKey& node, SampleCube<double> samples, const NodeKey& part, double value,
                 BrickShape shape) {
    const Placement placed = place(node, part, shape);
    const int cells = std::max(1, int(std::ldexp(double(shape.edge_cells), part.level - node.level)));
    for (int k = 0; k <= cells; ++k)
        for (int j = 0; j <= cells; ++j)
            for (int i = 0; i <= cells; ++i)
                if (samples.at(std::size_t(placed.axis[0].first_cell + i),
                               std::size_t(placed.axis[1].first_cell + j),
                               std::size_t(placed.axis[2].first_cell + k)) != value)
                    return false;
    return true;
}

DeviationPart::SubBox& DeviationPart::at(int index) {
    for (int i = 0; i < count; ++i)
        if (boxes[std::size_t(i)].index == index) return boxes[std::size_t(i)];
    boxes[std::size_t(count)] = {index, 0, 0};
    return boxes[std::size_t(count++)];
}

template <class T>
void addBrickDeviation(const NodeKey& node, std::span<const double> node_samples, const NodeKey& part,
                       SampleCube<T> part_samples, BrickShape shape, double scale, DeviationPart& out) {
    const int n = shape.edge_cells, factor = 1 << (node.level - part.level);
    const Placement placed = place(node, part, shape);
    const SampleCube<double> own = wholeCube(node_samples.data(), std::size_t(shape.edgeSamples()));
    ExpandedPlanes planes(
        own.from(std::size_t(placed.axis[0].first_cell), std::size_t(placed.axis[1].first_cell),
                 std::size_t(placed.axis[2].first_cell)),
        n, factor);
    // A brick spans one or more whole sub-boxes per axis, or lies in one. Per pair of runs along y and z the
    // rows are added up column by column; along x they are told apart at the end.
    const int box_cells = n / kErrorGridEdge;
    const int runs = std::max(1, int(planes.cells()) / box_cells), span = n / runs;
    const std::size_t width = std::size_t(n) + 1;
    std::vector<double> largest(std::size_t(runs * runs) * width), squares(std::size_t(runs * runs) * width);
    const double inverse = 1 / scale;
    const auto addPlane = [&](int k, int run_z, const double* below, const double* above, double t) {
        // On the face between two sub-boxes a sample bounds both; it is owned by the one behind it.
        const bool owned = k < (run_z + 1) * span;
        for (int run_y = 0; run_y < runs; ++run_y) {
            const std::size_t at = std::size_t(run_z * runs + run_y) * width, row = std::size_t(run_y * span);
            bandDeviation(below + row * width, above + row * width, t,
                          part_samples.rowAt(row, std::size_t(k)), part_samples.row, std::size_t(n),
                          std::size_t(span), inverse, largest.data() + at,
                          owned ? squares.data() + at : nullptr);
        }
    };
    for (std::size_t cell = 0; cell < planes.cells(); ++cell) {
        const auto [below, above] = planes.between(cell);
        for (int step = 0; step < factor; ++step) {
            const int k = int(cell) * factor + step, run = k / span;
            const double t = double(step) / factor;
            if (k % span == 0 && k > 0) addPlane(k, run - 1, below, above, t);
            addPlane(k, run, below, above, t);
        }
        if (cell + 1 == planes.cells()) addPlane(n, runs - 1, above, above, 0);
    }

    const auto boxOf = [&](std::size_t axis, int run) {
        return (placed.axis[axis].first_cell + run * box_cells) / box_cells;
    };
    for (int z = 0; z < runs; ++z)
        for (int y = 0; y < runs; ++y)
            for (int x = 0; x < runs; ++x) {
                const std::size_t at = std::size_t(z * runs + y) * width + std::size_t(x * span);
                DeviationPart::SubBox& box = out.at(gridIndex(boxOf(0, x), boxOf(1, y), boxOf(2, z)));
                for (std::size_t i = 0; i <= std::size_t(span); ++i)
                    box.largest = std::max(box.largest, largest[at + i]);
                for (std::size_t i = 0; i < std::size_t(span); ++i) box.squares += squares[at + i];
            }
}

void addUniformDeviation(const NodeKey& node, std::span<const double> node_samples, const NodeKey& part,
                         double value, BrickShape shape, double scale, DeviationPart& out) {
    const SampleCube<double> own = wholeCube(node_samples.data(), std::size_t(shape.edgeSamples()));
    if (hasOneValue(node, own, part, value, shape)) return;
    const double inverse = 1 / scale;
    const int box_cells = shape.edge_cells / kErrorGridEdge;
    const CellProducts products(
        std::min(node.level, part.level + std::countr_zero(unsigned(shape.edge_cells))));
    forPieces(node, part, shape,
              [&](const std::array<int, 3>& cell, const std::array<double, 3>& from, double piece) {
                  auto [d, largest] = deviationsOf(own, cell, from, piece, value);
                  for (double& corner : d) corner *= inverse;
                  DeviationPart::SubBox& box =
                      out.at(gridIndex(cell[0] / box_cells, cell[1] / box_cells, cell[2] / box_cells));
                  box.largest = std::max(box.largest, largest);
                  box.squares += std::max(0.0, dot(d, products.applied(d)));
              });
}

template <class T>
void addBrickResidual(const NodeKey& node, SampleCube<double> node_samples, const NodeKey& part,
                      SampleCube<T> part_samples, BrickShape shape, double scale,
                      std::span<CellResidual> out) {
    const int n = shape.edge_cells, factor = 1 << (node.level - part.level);
    const Placement placed = place(node, part, shape);
    ExpandedPlanes planes(
        node_samples.from(std::size_t(placed.axis[0].first_cell), std::size_t(placed.axis[1].first_cell),
                          std::size_t(placed.axis[2].first_cell)),
        n, factor);
    const int cells = int(planes.cells());
    const double inverse = 1 / scale;
    const std::size_t width = std::size_t(n);
    // Four weighted sums and the squares of each column, for one row of cells along x; reset for the next.
    std::vector<double> sums(5 * width), row(width + 1), field(width + 1);
    std::vector<double> largest(width + 1);
    for (int cz = 0; cz < cells; ++cz) {
        const auto [below, above] = planes.between(std::size_t(cz));
        for (int cy = 0; cy < cells; ++cy) {
            std::fill(sums.begin(), sums.end(), 0.0);
            std::fill(largest.begin(), largest.end(), 0.0);
            for (int k = 0; k <= factor; ++k)
                for (int j = 0; j <= factor; ++j) {
                    const std::size_t y = std::size_t(cy * factor + j), z = std::size_t(cz * factor + k);
                    const double ty = double(j) / factor, tz = double(k) / factor;
                    const double* const a = below + y * (width + 1);
                    const double* const b = above + y * (width + 1);
                    mixRows(a, b, tz, width + 1, field.data());
                    const T* const samples = part_samples.rowAt(y, z);
                    for (std::size_t i = 0; i <= width; ++i) {
                        row[i] = (double(samples[i]) - field[i]) * inverse;
                        largest[i] = std::max(largest[i], std::abs(row[i]));
                    }
                    if (j == factor || k == factor) continue;
                    const double weights[4] = {(1 - ty) * (1 - tz), ty * (1 - tz), (1 - ty) * tz, ty * tz};
                    addResidualRow(row.data(), width, weights, sums.data(), sums.data() + 4 * width);
                }
            for (int cx = 0; cx < cells; ++cx) {
                CellResidual& cell =
                    out[shape.cellAt(placed.axis[0].first_cell + cx, placed.axis[1].first_cell + cy,
                                     placed.axis[2].first_cell + cz)];
                for (int i = 0; i < factor; ++i) {
                    const std::size_t at = std::size_t(cx * factor + i);
                    const double t = double(i) / factor;
                    for (std::size_t yz = 0; yz < 4; ++yz) {
                        cell.moments[2 * yz] += (1 - t) * sums[yz * width + at];
                        cell.moments[2 * yz + 1] += t * sums[yz * width + at];
                    }
                    cell.squares += sums[4 * width + at];
                }
                for (int i = 0; i <= factor; ++i)
                    cell.largest = std::max(cell.largest, largest[std::size_t(cx * factor + i)]);
            }
        }
    }
}

void addMeasuredDeviation(const NodeKey& node, std::span<const double> node_samples,
                          const MeasuredBrick& part, BrickShape shape, double scale, DeviationPart& out) {
    const CellProducts products(part.key.level);
    const int box_cells = shape.edge_cells / kErrorGridEdge;
    const SampleCube<double> own = wholeCube(node_samples.data(), std::size_t(shape.edgeSamples()));
    forMeasuredCells(node, own, part, shape, scale,
                     [&](const std::array<int, 3>& cell, const std::array<double, 3>&, double,
                         const std::array<double, 8>& d, std::size_t index) {
                         static const CellResidual kNone;
                         const CellResidual& r = part.residual.empty() ? kNone : part.residual[index];
                         double largest = 0;
                         for (double corner : d) largest = std::max(largest, std::abs(corner));
                         DeviationPart::SubBox& box =
                             out.at(gridIndex(cell[0] / box_cells, cell[1] / box_cells, cell[2] / box_cells));
                         box.largest = std::max(box.largest, (largest + r.largest) * scale);
                         // |d - r|^2 over the cell's samples.
                         box.squares +=
                             std::max(0.0, dot(d, products.applied(d)) - 2 * dot(d, r.moments) + r.squares);
                     });
}

void addMeasuredResidual(const NodeKey& node, SampleCube<double> node_samples, const MeasuredBrick& part,
                         BrickShape shape, double scale, std::span<CellResidual> out) {
    const CellProducts products(part.key.level);
    forMeasuredCells(node, node_samples, part, shape, scale,
                     [&](const std::array<int, 3>& cell, const std::array<double, 3>& from, double piece,
                         const std::array<double, 8>& d, std::size_t index) {
                         static const CellResidual kNone;
                         const CellResidual& r = part.residual.empty() ? kNone : part.residual[index];
                         // Level 0 less the node's field is r - d.
                         const std::array<double, 8> applied = products.applied(d);
                         std::array<double, 8> moments;
                         double largest = 0;
                         for (std::size_t q = 0; q < 8; ++q) {
                             moments[q] = r.moments[q] - applied[q];
                             largest = std::max(largest, std::abs(d[q]));
                         }
                         const double squares =
                             std::max(0.0, r.squares - 2 * dot(d, r.moments) + dot(d, applied));
                         addPiece(moments, squares, largest + r.largest, from, piece,
                                  out[shape.cellAt(cell[0], cell[1], cell[2])]);
                     });
}

void addUniformResidual(const NodeKey& node, SampleCube<double> node_samples, const NodeKey& part,
                        double value, BrickShape shape, double scale, std::span<CellResidual> out) {
    if (hasOneValue(node, node_samples, part, value, shape)) return;
    const double inverse = 1 / scale;
    const CellProducts products(
        std::min(node.level, part.level + std::countr_zero(unsigned(shape.edge_cells))));
    forPieces(node, part, shape,
              [&](const std::array<int, 3>& cell, const std::array<double, 3>& from, double piece) {
                  auto [d, largest] = deviationsOf(node_samples, cell, from, piece, value);
                  for (double& corner : d) corner *= inverse;
                  largest *= inverse;
                  const std::array<double, 8> applied = products.applied(d);
                  std::array<double, 8> moments;
                  for (std::size_t q = 0; q < 8; ++q) moments[q] = -applied[q];
                  addPiece(moments, std::max(0.0, dot(d, applied)), largest, from, piece,
                           out[shape.cellAt(cell[0], cell[1], cell[2])]);
              });
}

#define BRICKYARD_INSTANTIATE(T)                                                                         \
    template void addBrickDeviation<T>(const NodeKey&, std::span<const double>, const NodeKey&,          \
                                       SampleCube<T>, BrickShape, double, DeviationPart&);               \
    template void addBrickResidual<T>(const NodeKey&, SampleCube<double>, const NodeKey&, SampleCube<T>, \
                                      BrickShape, double, std::span<CellResidual>);
BRICKYARD_INSTANTIATE(float)
BRICKYARD_INSTANTIATE(double)
BRICKYARD_INSTANTIATE(std::int32_t)
BRICKYARD_INSTANTIATE(std::int64_t)
BRICKYARD_INSTANTIATE(std::uint8_t)
#undef BRICKYARD_INSTANTIATE

void NodeDeviation::merge(const DeviationPart& part) {
    for (int i = 0; i < part.count; ++i) {
        const DeviationPart::SubBox& box = part.boxes[std::size_t(i)];
        largest_[std::size_t(box.index)] = std::max(largest_[std::size_t(box.index)], box.largest);
        squares_[std::size_t(box.index)] += box.squares;
    }
}

void NodeDeviation::merge(const NodeDeviation& other) {
    for (std::size_t i = 0; i < std::size_t(kErrorGridCells); ++i) {
        largest_[i] = std::max(largest_[i], other.largest_[i]);
        squares_[i] += other.squares_[i];
    }
}

double NodeDeviation::largest() const { return *std::max_element(largest_.begin(), largest_.end()); }

double NodeDeviation::rms(const NodeKey& node, BrickShape shape, double scale) const {
    double sum = 0;
    for (double s : squares_) sum += s;
    return scale * std::sqrt(sum / std::pow(std::ldexp(double(shape.edge_cells), node.level), 3));
}

ErrorGrid NodeDeviation::grid(const NodeKey& node, BrickShape shape, double scale, float bound) const {
    const double samples = std::pow(std::ldexp(double(shape.edge_cells / kErrorGridEdge), node.level), 3);
    ErrorGrid grid;
    for (std::size_t i = 0; i < std::size_t(kErrorGridCells); ++i) {
        const double rms = scale * std::sqrt(squares_[i] / samples);
        grid.bound[i] = errorToCode(std::min(largest_[i], double(bound)), bound);
        grid.rms[i] = errorToCode(std::min(rms, double(bound)), bound);
    }
    return grid;
}

}  // namespace brickyard

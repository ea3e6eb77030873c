#include "core/deviation.h"

#include <algorithm>
#include <cmath>
#include <vector>

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

// Linear interpolation of one axis at every level-0 sample of a brick: which cell, and where in it.
struct Lerp {
    int cell = 0;  // relative to the axis' first cell
    double t = 0;
};

std::vector<Lerp> lerps(const Axis& axis, double step, int n, int last_cell) {
    std::vector<Lerp> out(std::size_t(n) + 1);
    for (int i = 0; i <= n; ++i) {
        const double u = axis.begin + i * step;
        const int cell = std::min(int(u), last_cell);
        out[std::size_t(i)] = {cell - axis.first_cell, u - cell};
    }
    return out;
}

}  // namespace

DeviationPart::SubBox& DeviationPart::at(int index) {
    for (int i = 0; i < count; ++i)
        if (boxes[std::size_t(i)].index == index) return boxes[std::size_t(i)];
    boxes[std::size_t(count)] = {index, 0, 0};
    return boxes[std::size_t(count++)];
}

void addBrickDeviation(const NodeKey& node, std::span<const double> node_samples, const NodeKey& part,
                       std::span<const double> part_samples, BrickShape shape, double scale,
                       DeviationPart& out) {
    const int n = shape.edge_cells, s = shape.edgeSamples();
    const Placement place_in = place(node, part, shape);
    std::array<std::vector<Lerp>, 3> lerp;
    std::array<int, 3> span{};  // node samples needed per axis
    for (std::size_t a = 0; a < 3; ++a) {
        lerp[a] = lerps(place_in.axis[a], place_in.step, n, n - 1);
        span[a] = lerp[a].back().cell + 2;
    }
    auto mix = [](double a, double b, double t) { return a + (b - a) * t; };

    // x, then y, then z: each pass reads what the one before interpolated.
    std::vector<double> x(std::size_t(s * span[1] * span[2]));
    for (int k = 0; k < span[2]; ++k)
        for (int j = 0; j < span[1]; ++j) {
            const double* row = node_samples.data() + shape.sampleAt(place_in.axis[0].first_cell,
                                                                     place_in.axis[1].first_cell + j,
                                                                     place_in.axis[2].first_cell + k);
            double* to = x.data() + std::size_t((k * span[1] + j) * s);
            for (int i = 0; i < s; ++i) {
                const Lerp& l = lerp[0][std::size_t(i)];
                to[i] = mix(row[l.cell], row[l.cell + 1], l.t);
            }
        }
    std::vector<double> y(std::size_t(s * s * span[2]));
    for (int k = 0; k < span[2]; ++k)
        for (int j = 0; j < s; ++j) {
            const Lerp& l = lerp[1][std::size_t(j)];
            const double* row = x.data() + std::size_t((k * span[1] + l.cell) * s);
            double* to = y.data() + std::size_t((k * s + j) * s);
            for (int i = 0; i < s; ++i) to[i] = mix(row[i], row[i + s], l.t);
        }

    // A sample on the face between two sub-boxes bounds both; it is owned by the one behind it.
    const int box_cells = n / kErrorGridEdge;
    auto boxOf = [&](std::size_t a, int i, bool before) {
        const Lerp& l = lerp[a][std::size_t(i)];
        const int cell = place_in.axis[a].first_cell + l.cell;
        const double u = cell + l.t;
        int box = cell / box_cells;
        if (l.t == 1) box = std::min(int(u) / box_cells, kErrorGridEdge - 1);  // the node's far face
        if (before && u == double(box) * box_cells && i > 0) --box;
        return std::max(box, 0);
    };
    const double inverse = 1 / scale;
    for (int k = 0; k < s; ++k) {
        const Lerp& lk = lerp[2][std::size_t(k)];
        const std::array<int, 2> bz{boxOf(2, k, true), boxOf(2, k, false)};
        for (int j = 0; j < s; ++j) {
            const std::array<int, 2> by{boxOf(1, j, true), boxOf(1, j, false)};
            const double* row = y.data() + std::size_t((lk.cell * s + j) * s);
            const double* source = part_samples.data() + std::size_t((k * s + j) * s);
            for (int begin = 0; begin < s;) {
                // A run of samples in one sub-box, closed at both ends for the largest, half-open for the
                // squares.
                const int bx = boxOf(0, begin, false);
                double largest = 0, squares = 0;
                int i = begin;
                for (; i < s; ++i) {
                    const double d = std::abs(mix(row[i], row[i + s * s], lk.t) - source[i]);
                    largest = std::max(largest, d);
                    if (i > begin && (i == n || boxOf(0, i, false) != bx)) break;
                    squares += (d * inverse) * (d * inverse);
                }
                for (int zz : {0, 1})
                    for (int yy : {0, 1}) {
                        if ((zz && bz[1] == bz[0]) || (yy && by[1] == by[0])) continue;
                        DeviationPart::SubBox& box =
                            out.at(gridIndex(bx, by[std::size_t(yy)], bz[std::size_t(zz)]));
                        box.largest = std::max(box.largest, largest);
                    }
                if (j < n && k < n) out.at(gridIndex(bx, by[1], bz[1])).squares += squares;
                if (i >= n) break;
                begin = i;
            }
        }
    }
}

void addUniformDeviation(const NodeKey& node, std::span<const double> node_samples, const NodeKey& part,
                         double value, BrickShape shape, double scale, DeviationPart& out) {
    const int n = shape.edge_cells;
    const Placement place_in = place(node, part, shape);
    // The part is either whole cells of the node, or lies inside one of them.
    const double extent = std::ldexp(double(n), part.level - node.level);
    const int cells = std::max(1, int(extent));
    const double piece = std::min(1.0, extent);      // in cells of the node
    const double m = std::ldexp(piece, node.level);  // level-0 samples per axis of a piece

    // Sums over i in [0, m) of the products of the two hat weights (1 - i/m) and i/m.
    const double s1 = (m - 1) / 2, s2 = (m - 1) * (2 * m - 1) / (6 * m);
    const double w[2][2] = {{m - 2 * s1 + s2, s1 - s2}, {s1 - s2, s2}};
    const double inverse = 1 / scale;
    const int box_cells = n / kErrorGridEdge;

    for (int cz = 0; cz < cells; ++cz)
        for (int cy = 0; cy < cells; ++cy)
            for (int cx = 0; cx < cells; ++cx) {
                const std::array<int, 3> cell{place_in.axis[0].first_cell + cx,
                                              place_in.axis[1].first_cell + cy,
                                              place_in.axis[2].first_cell + cz};
                double d[2][2][2];
                double largest = 0;
                for (int c = 0; c < 8; ++c) {
                    std::array<double, 3> t;
                    for (std::size_t a = 0; a < 3; ++a) {
                        const double from =
                            extent < 1 ? place_in.axis[a].begin - place_in.axis[a].first_cell : 0;
                        t[a] = from + ((c >> a & 1) ? piece : 0);
                    }
                    double v = 0;
                    for (int q = 0; q < 8; ++q) {
                        const double weight = ((q & 1) ? t[0] : 1 - t[0]) * ((q & 2) ? t[1] : 1 - t[1]) *
                                              ((q & 4) ? t[2] : 1 - t[2]);
                        if (weight != 0)
                            v += weight * node_samples[shape.sampleAt(
                                              cell[0] + (q & 1), cell[1] + (q >> 1 & 1), cell[2] + (q >> 2))];
                    }
                    d[c & 1][c >> 1 & 1][c >> 2] = (v - value) * inverse;
                    largest = std::max(largest, std::abs(v - value));
                }
                double squares = 0;
                for (int p = 0; p < 8; ++p)
                    for (int q = 0; q < 8; ++q)
                        squares += d[p & 1][p >> 1 & 1][p >> 2] * d[q & 1][q >> 1 & 1][q >> 2] *
                                   w[p & 1][q & 1] * w[p >> 1 & 1][q >> 1 & 1] * w[p >> 2][q >> 2];
                DeviationPart::SubBox& box =
                    out.at(gridIndex(cell[0] / box_cells, cell[1] / box_cells, cell[2] / box_cells));
                box.largest = std::max(box.largest, largest);
                box.squares += std::max(0.0, squares);
            }
}

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

#include "client/cpu/light_lattice.h"

#include <algorithm>
#include <cmath>
#include <deque>

#include "client/cpu/shadow_beam.h"

namespace brickyard {

namespace {

// Lattice cells along a node's edge: at first, and at most (a point for each sample of a brick of 16 cells).
constexpr int kFirstCells = 2, kMostCells = 16;
// And no wider than so many voxels at first: what lies between its points, a lattice and its half both miss.
// Measured on lit clouds in bricks of 32: without it a tenth of the pixels was beyond three estimates.
constexpr int kFirstVoxels = 4;
// Interpolation errs in proportion to the square of the spacing, so a lattice is off by a third of what it
// differs from its half.
constexpr double kOfHalf = 1.0 / 3;
// A ray along the edge of a shadow sees more than its mean: the worst point counts with this power, as in
// node_error.h. tests/client/beam_tile_test.cpp measures both.
constexpr double kTailShare = 0.3;
// Share of the allowed variance of a shadow that levels and drafts on the light's way may take.
constexpr double kLevelShare = 0.5;
// A ray meets several bricks, whose interpolation errs independently.
constexpr double kSpacingAllowance = 2;

}  // namespace

double LightLattice::transmittance(double x, double y, double z) const {
    const double place[3] = {x, y, z};
    int cell[3];
    double inside[3];
    for (int a = 0; a < 3; ++a) {
        const double p = std::clamp((place[a] - box_begin[a]) * double(per_cell[a]), 0.0, points[a] - 1.0);
        cell[a] = std::min(int(p), std::max(0, points[a] - 2));
        inside[a] = p - cell[a];
    }
    const float* quad = quads.data() + 4 * (cell[0] + points[0] * (cell[1] + points[1] * cell[2]));
    double plane[2];
    for (int k = 0; k < 2; ++k, quad += 4 * points[0] * points[1]) {
        const double low = double(quad[0]) + (double(quad[1]) - double(quad[0])) * inside[0];
        const double high = double(quad[2]) + (double(quad[3]) - double(quad[2])) * inside[0];
        plane[k] = low + (high - low) * inside[1];
    }
    return std::exp(-(plane[0] + (plane[1] - plane[0]) * inside[2]));
}

// A lattice while it is made.
struct LightField::Entry {
    std::mutex mutex;
    bool done = false;
    LightLattice lattice;
    int cells = kFirstCells;  // along a whole edge
    std::deque<ShadowBeam> beams;
    std::size_t beams_done = 0;

    void start(const RenderPlan& plan, double deviation, const ResidentTree* resident,
               const WalkedNode& node);
    void gather(double& difference, double& worst, double& variance);
};

void LightField::Entry::start(const RenderPlan& plan, double deviation, const ResidentTree* resident,
                              const WalkedNode& node) {
    const NodeRecord& record = node.record();
    const int edge = plan.density->shape().edge_cells;
    const glm::dvec3 low = nodeLow(node.key, plan.density->shape());
    const double cell = cellEdge(node.key.level);
    glm::dvec3 first, step;
    for (int a = 0; a < 3; ++a) {
        const int begin = record.hasBrick() ? record.box_begin[std::size_t(a)] : 0;
        const int end = record.hasBrick() ? record.box_end[std::size_t(a)] : edge;
        const int extent = std::max(1, end - begin);
        // An even number, so that every second point is a lattice too.
        const int count = std::max(2, (extent * cells + edge - 1) / edge + 1) / 2 * 2;
        lattice.points[a] = count + 1;
        lattice.box_begin[a] = begin;
        lattice.per_cell[a] = float(count) / float(extent);
        first[a] = low[a] + cell * begin;
        step[a] = cell * extent / count;
    }
    std::vector<glm::dvec3> points;
    beams.clear();
    beams_done = 0;
    auto flush = [&] {
        if (!points.empty()) beams.emplace_back(plan, deviation, points, resident);
        points.clear();
    };
    for (int z = 0; z < lattice.points[2]; ++z)
        for (int y = 0; y < lattice.points[1]; ++y)
            for (int x = 0; x < lattice.points[0]; ++x) {
                points.push_back(first + step * glm::dvec3(x, y, z));
                if (points.size() == ShadowBeam::kMostPoints) flush();
            }
    flush();
}

// Fills in the quads from the beams. `difference`: mean square of what every second point
// misses of the others, as a transmittance.
void LightField::Entry::gather(double& difference, double& worst, double& variance) {
    const int nx = lattice.points[0], ny = lattice.points[1], nz = lattice.points[2];
    std::vector<float> values;
    variance = 0;
    for (int i = 0; i < nx * ny * nz; ++i) {
        const ShadowBeam& beam = beams[std::size_t(i) / ShadowBeam::kMostPoints];
        const std::size_t point = std::size_t(i) % ShadowBeam::kMostPoints;
        values.push_back(float(beam.depth(point)));
        variance = std::max(variance, std::exp(-2 * beam.depth(point)) * beam.variance(point));
    }
    auto at = [&](int x, int y, int z) {
        return values[std::size_t(std::min(x, nx - 1) +
                                  nx * (std::min(y, ny - 1) + ny * std::min(z, nz - 1)))];
    };
    lattice.quads.resize(4 * values.size());
    double squares = 0;
    worst = 0;
    for (int z = 0; z < nz; ++z)
        for (int y = 0; y < ny; ++y)
            for (int x = 0; x < nx; ++x) {
                float* quad = lattice.quads.data() + 4 * (x + nx * (y + ny * z));
                for (int k = 0; k < 4; ++k) quad[k] = at(x + (k & 1), y + (k >> 1), z);
                double mean = 0;
                for (int k = 0; k < 8; ++k)
                    mean += 0.125 * double(at((k & 1) ? (x + 1) / 2 * 2 : x / 2 * 2,
                                              (k & 2) ? (y + 1) / 2 * 2 : y / 2 * 2,
                                              (k & 4) ? (z + 1) / 2 * 2 : z / 2 * 2));
                const double off = std::exp(-mean) - std::exp(-double(at(x, y, z)));
                squares += off * off;
                worst = std::max(worst, std::abs(off));
            }
    // The points of the half itself differ by nothing: the rest is what tells.
    const int half = (nx / 2 + 1) * (ny / 2 + 1) * (nz / 2 + 1);
    difference = squares / std::max(1, nx * ny * nz - half);
}

LightField::LightField(const RenderPlan& plan, double deviation, const ResidentTree* resident)
    : plan_(plan), deviation_(deviation), resident_(resident) {}
LightField::~LightField() = default;

LightField::Entry& LightField::entryOf(const NodeRef& node) {
    const std::lock_guard lock(mutex_);
    std::unique_ptr<Entry>& entry = entries_[std::uint64_t(node.block) << 32 | node.node];
    if (!entry) entry = std::make_unique<Entry>();
    return *entry;
}

const LightLattice* LightField::of(const WalkedNode& node, double worth, const RayContext& context) {
    Entry& entry = entryOf(node.ref);
    const std::lock_guard lock(entry.mutex);
    if (entry.done) return &entry.lattice;
    const double levels = deviation_ * std::sqrt(kLevelShare);
    const double spacing = deviation_ > 0 ? kSpacingAllowance * deviation_ : kReferenceDeviation;
    const int most = std::min(kMostCells, plan_.density->shape().edge_cells);
    if (entry.beams.empty())
        entry.cells = std::clamp(plan_.density->shape().edge_cells / kFirstVoxels, kFirstCells, most);
    if (entry.beams.empty()) entry.start(plan_, levels, resident_, node);
    for (;;) {
        while (entry.beams_done < entry.beams.size()) {
            if (!entry.beams[entry.beams_done].advance(worth, context)) return nullptr;
            ++entry.beams_done;
        }
        double difference = 0, worst = 0, variance = 0;
        entry.gather(difference, worst, variance);
        const double interpolated = kOfHalf * std::sqrt(difference);
        entry.lattice.deviation = float(std::min(1.0, std::sqrt(variance)));
        entry.lattice.spacing_deviation = float(
            std::min(1.0, std::pow(interpolated, 1 - kTailShare) * std::pow(kOfHalf * worst, kTailShare)));
        if (interpolated <= spacing || entry.cells >= most) break;
        entry.cells *= 2;
        entry.start(plan_, levels, resident_, node);
    }
    entry.beams.clear();
    entry.beams.shrink_to_fit();
    entry.done = true;
    return &entry.lattice;
}

std::uint64_t LightField::bytes() const {
    const std::lock_guard lock(mutex_);
    std::uint64_t sum = 0;
    for (const auto& [key, entry] : entries_) sum += entry->lattice.quads.size() * sizeof(float);
    return sum;
}

}  // namespace brickyard

#include "tools/bench/synthetic_cloud.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <glm/mat4x4.hpp>
#include <random>

#include "core/dataset.h"
#include "core/dataset_writer.h"
#include "core/frame_writer.h"
#include "tools/worker_pool.h"

namespace brickyard {

namespace {

constexpr int kTile = 16;
constexpr int kLattice = 64;
constexpr int kOctaves = 6;
constexpr double kFirstWeight = 0.5, kGain = 0.55;
constexpr double kFirstWavelength = 0.23;  // of the box's edge
// Density is what the sum of envelope and noise has above this.
constexpr double kThreshold = 0.62;

// Where the billows are, in units of the box.
struct Billow {
    double x, y, z, radius;
};
constexpr Billow kBillows[] = {{0.30, 0.40, 0.30, 0.24}, {0.52, 0.46, 0.36, 0.28}, {0.70, 0.56, 0.30, 0.20},
                               {0.44, 0.62, 0.52, 0.20}, {0.60, 0.40, 0.62, 0.18}, {0.26, 0.66, 0.24, 0.14},
                               {0.80, 0.36, 0.24, 0.12}, {0.54, 0.54, 0.80, 0.12}};

}  // namespace

SyntheticCloud::SyntheticCloud(int edge, const ParallelFor& parallel_for)
    : edge_(edge), tiles_(edge / kTile) {
    std::mt19937 random(5);  // its sequence is fixed by the standard
    lattice_.resize(std::size_t(kLattice) * kLattice * kLattice);
    for (float& value : lattice_) value = float(random() >> 8) / float(1 << 24);

    std::vector<Tile> tiles(tileAt(0, 0, tiles_));
    parallel_for(std::size_t(tiles_), [&](std::size_t tz) {
        for (int ty = 0; ty < tiles_; ++ty)
            for (int tx = 0; tx < tiles_; ++tx)
                tiles[tileAt(tx, ty, std::int64_t(tz))] = look(tx, ty, int(tz));
    });
    info_.name = "density";
    info_.index_to_world = *Affine::fromColumns(
        std::vector<double>{1.0 / edge, 0, 0, 0, 0, 1.0 / edge, 0, 0, 0, 0, 1.0 / edge, 0, 0, 0, 0, 1});
    info_.grid_class = "fog volume";
    info_.active_box = {{edge, edge, edge}, {0, 0, 0}};
    for (const Tile& tile : tiles) {
        occupied_.push_back(tile.dense > 0);
        if (tile.dense == 0) continue;
        info_.active_voxels += tile.dense;
        for (std::size_t a = 0; a < 3; ++a) {
            info_.active_box.begin[a] = std::min(info_.active_box.begin[a], tile.box.begin[a]);
            info_.active_box.end[a] = std::max(info_.active_box.end[a], tile.box.end[a]);
        }
    }
}

SyntheticCloud::Tile SyntheticCloud::look(int tx, int ty, int tz) const {
    Tile tile;
    // Noise adds at most 1.1 to the envelope, which changes by at most 1 / radius per unit: many tiles are
    // known to be empty from their middle.
    const double half = 0.5 * kTile / edge_, steepest = 1 / 0.12;
    auto middle = [&](int t) { return (t + 0.5) * kTile / edge_; };
    if (envelope(middle(tx), middle(ty), middle(tz)) + std::sqrt(3.0) * half * steepest + 1.1 <= kThreshold)
        return tile;
    tile.box = {{edge_, edge_, edge_}, {0, 0, 0}};
    for (std::int64_t z = tz * kTile; z < (tz + 1) * kTile; ++z)
        for (std::int64_t y = ty * kTile; y < (ty + 1) * kTile; ++y)
            for (std::int64_t x = tx * kTile; x < (tx + 1) * kTile; ++x) {
                if (at(x, y, z) <= 0) continue;
                ++tile.dense;
                const Index3 p{x, y, z};
                for (std::size_t a = 0; a < 3; ++a) {
                    tile.box.begin[a] = std::min(tile.box.begin[a], p[a]);
                    tile.box.end[a] = std::max(tile.box.end[a], p[a] + 1);
                }
            }
    return tile;
}

double SyntheticCloud::envelope(double x, double y, double z) const {
    double best = -1e9;
    for (const Billow& b : kBillows) {
        const double dx = x - b.x, dy = y - b.y, dz = z - b.z;
        best = std::max(best, 1 - std::sqrt(dx * dx + dy * dy + dz * dz) / b.radius);
    }
    return best;
}

double SyntheticCloud::noise(double x, double y, double z) const {
    int cell[3], next[3];
    double part[3];
    const double at[3] = {x, y, z};
    for (int a = 0; a < 3; ++a) {
        const double floor = std::floor(at[a]);
        const double t = at[a] - floor;
        part[a] = t * t * (3 - 2 * t);
        cell[a] = int(std::int64_t(floor) & (kLattice - 1));
        next[a] = (cell[a] + 1) & (kLattice - 1);
    }
    auto value = [&](int i, int j, int k) {
        return double(lattice_[std::size_t(i + kLattice * (j + kLattice * k))]);
    };
    auto mix = [](double a, double b, double t) { return a + (b - a) * t; };
    auto row = [&](int j, int k) { return mix(value(cell[0], j, k), value(next[0], j, k), part[0]); };
    auto plane = [&](int k) { return mix(row(cell[1], k), row(next[1], k), part[1]); };
    return mix(plane(cell[2]), plane(next[2]), part[2]);
}

float SyntheticCloud::at(std::int64_t x, std::int64_t y, std::int64_t z) const {
    if (x < 0 || y < 0 || z < 0 || x >= edge_ || y >= edge_ || z >= edge_) return 0;
    const double p[3] = {(double(x) + 0.5) / edge_, (double(y) + 0.5) / edge_, (double(z) + 0.5) / edge_};
    const double shape = envelope(p[0], p[1], p[2]);
    // What the octaves to come can add at most; most samples are known to be empty after the first.
    double rest = 0, weight = kFirstWeight;
    for (int o = 0; o < kOctaves; ++o, weight *= kGain) rest += weight;
    double sum = 0, frequency = 1 / kFirstWavelength;
    weight = kFirstWeight;
    for (int o = 0; o < kOctaves; ++o) {
        if (shape + sum + rest <= kThreshold) return 0;
        rest -= weight;
        sum += weight * noise(p[0] * frequency, p[1] * frequency + o * 7.3, p[2] * frequency + o * 3.1);
        weight *= kGain;
        frequency *= 2.07;
    }
    return float(std::max(0.0, std::min(0.35, shape) + sum - kThreshold));
}

std::optional<UniformRegion> SyntheticCloud::uniformOver(const IndexBox& box) const {
    const IndexBox inside = intersect(box, {{0, 0, 0}, {edge_, edge_, edge_}});
    const UniformRegion empty{{0}, false};
    if (inside.empty()) return empty;
    for (std::int64_t z = inside.begin[2] / kTile; z <= (inside.end[2] - 1) / kTile; ++z)
        for (std::int64_t y = inside.begin[1] / kTile; y <= (inside.end[1] - 1) / kTile; ++y)
            for (std::int64_t x = inside.begin[0] / kTile; x <= (inside.end[0] - 1) / kTile; ++x)
                if (occupied_[tileAt(x, y, z)]) return std::nullopt;
    return empty;
}

Result<void> SyntheticCloud::read(const IndexBox& box, SampleBlock& out) const {
    const std::size_t count = std::size_t(box.extent(0) * box.extent(1) * box.extent(2));
    out.values.resize(count * sizeof(float));
    out.active.resize(count);
    std::size_t i = 0;
    for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
        for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y)
            for (std::int64_t x = box.begin[0]; x < box.end[0]; ++x, ++i) {
                const float value = at(x, y, z);
                std::memcpy(out.values.data() + i * sizeof(float), &value, sizeof(float));
                out.active[i] = value > 0;
            }
    return {};
}

Result<void> storeSyntheticCloud(int edge, const std::filesystem::path& folder) {
    WorkerPool pool(/*jobs=*/0);
    const SyntheticCloud cloud(edge, pool.parallelFor());
    BuildOptions build;
    build.parallel_for = pool.parallelFor();
    Manifest settings;
    settings.set_format_major(kFormatMajor);
    settings.set_format_minor(kFormatMinor);
    settings.set_brick_edge(std::uint32_t(build.shape.edge_cells));
    settings.set_nonfinite("reject");
    auto writer = DatasetWriter::open(folder, settings, ExistingDataset::kContinue);
    if (!writer) return tl::unexpected(writer.error());
    const auto temporary = (*writer)->temporaryFrame(0);
    if (!temporary) return tl::unexpected(temporary.error());
    auto frame = FrameWriter::create(*temporary);
    if (!frame) return tl::unexpected(frame.error());
    const FieldSource* field = &cloud;
    auto footer = buildFrame({&field, 1}, {&build, 1}, **frame);
    if (!footer) return tl::unexpected(footer.error());
    auto finished = (*frame)->finish(*footer);
    if (!finished) return tl::unexpected(finished.error());
    FrameEntry entry;
    entry.set_frame(0);
    entry.set_file_bytes(finished->file_bytes);
    entry.set_footer_xxh64(finished->footer_checksum);
    if (auto done = (*writer)->commitFrame(*temporary, entry); !done) return done;
    return (*writer)->finish();
}

}  // namespace brickyard

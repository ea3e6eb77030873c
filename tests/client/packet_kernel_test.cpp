// The packet kernels against the same sums in long double: random bricks of every size, rays of every awkward
// kind. Nothing outside a brick's box may matter: samples there are NaN, and behind the last one lies a page
// that cannot be read.
#include "client/cpu/packet_kernel.h"

#include <gtest/gtest.h>
#include <hwy/targets.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cmath>
#include <cstring>
#include <random>

#include "reference_field.h"

namespace brickyard {
namespace {

constexpr int kLanes = RayPacket::kRays;
constexpr double kNever = std::numeric_limits<double>::infinity();

double uniform(std::mt19937& random, double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
}
int below(std::mt19937& random, int count) { return int(random() % unsigned(count)); }

// Floats between two pages that cannot be read. Sanitizers do not look into gathers; the processor does.
class GuardedFloats {
public:
    // The last float, or else the first, touches such a page.
    GuardedFloats(std::size_t count, bool at_end) {
        const std::size_t page = std::size_t(sysconf(_SC_PAGESIZE)), bytes = count * sizeof(float);
        const std::size_t inner = (bytes + page - 1) / page * page;
        bytes_ = inner + 2 * page;
        base_ = static_cast<std::byte*>(
            mmap(nullptr, bytes_, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, /*fd=*/-1, 0));
        EXPECT_NE(base_, MAP_FAILED);
        EXPECT_EQ(mprotect(base_ + page, inner, PROT_READ | PROT_WRITE), 0);
        data_ = reinterpret_cast<float*>(base_ + page + (at_end ? inner - bytes : 0));
        std::fill_n(data_, count, std::numeric_limits<float>::quiet_NaN());
    }
    ~GuardedFloats() { munmap(base_, bytes_); }
    GuardedFloats(const GuardedFloats&) = delete;
    GuardedFloats& operator=(const GuardedFloats&) = delete;
    float* data() { return data_; }
    float& operator[](std::size_t i) { return data_[i]; }

private:
    std::byte* base_ = nullptr;
    std::size_t bytes_ = 0;
    float* data_ = nullptr;
};

enum class Content { kRough, kSigned, kSmooth, kSpikes, kConstant };
constexpr Content kContents[] = {Content::kRough, Content::kSigned, Content::kSmooth, Content::kSpikes,
                                 Content::kConstant};

double contentAt(Content content, std::mt19937& random, int x, int y, int z) {
    switch (content) {
        case Content::kRough: return uniform(random, 0.1, 1);
        case Content::kSigned: return uniform(random, -0.6, 1);
        case Content::kSmooth: return 1 + 0.5 * std::sin(0.2 * x) * std::cos(0.15 * y + 0.1 * z);
        case Content::kSpikes: return below(random, 20) == 0 ? 1 : 0;
        case Content::kConstant: return 0.7;
    }
    return 0;
}

// A brick anywhere in index space, with quads of its own.
struct TestBrick {
    int cells_along = 0;
    GuardedFloats samples, quads;
    BrickCells cells;
    double most = 0, steepness = 0;

    TestBrick(std::mt19937& random, int edge, Content content, bool tight, double size)
        : cells_along(edge),
          samples(std::size_t(edge + 1) * std::size_t(edge + 1) * std::size_t(edge + 1), random() % 2 == 0),
          quads(4 * std::size_t(edge + 1) * std::size_t(edge + 1) * std::size_t(edge + 1),
                random() % 2 == 0) {
        cells.samples = samples.data();
        cells.edge_samples = edge + 1;
        cells.cell_edge = std::exp2(below(random, 6));
        cells.negative = content == Content::kSigned;
        for (int a = 0; a < 3; ++a) {
            cells.low[a] = cells.cell_edge * edge * (below(random, 9) - 4);
            cells.box_begin[a] = tight ? below(random, edge) : 0;
            cells.box_end[a] =
                tight ? cells.box_begin[a] + 1 + below(random, edge - cells.box_begin[a]) : edge;
        }
        fill(random, content, size);
        measure();
    }

    std::size_t at(int x, int y, int z) const {
        const int row = cells.edge_samples;
        return std::size_t(x) + std::size_t(row) * (std::size_t(y) + std::size_t(row) * std::size_t(z));
    }
    BrickCells withQuads() {
        BrickCells with = cells;
        with.quads = quads.data();
        return with;
    }

private:
    template <class Visit>
    void forEachSample(Visit&& visit) const {
        for (int z = cells.box_begin[2]; z <= cells.box_end[2]; ++z)
            for (int y = cells.box_begin[1]; y <= cells.box_end[1]; ++y)
                for (int x = cells.box_begin[0]; x <= cells.box_end[0]; ++x) visit(x, y, z);
    }
    void fill(std::mt19937& random, Content content, double size) {
        forEachSample([&](int x, int y, int z) {
            samples[at(x, y, z)] = float(size * contentAt(content, random, x, y, z));
        });
        forEachSample([&](int x, int y, int z) {
            if (x == cells.box_end[0] || y == cells.box_end[1]) return;
            for (int k = 0; k < 4; ++k)
                quads[4 * at(x, y, z) + std::size_t(k)] = samples[at(x + (k & 1), y + (k >> 1), z)];
        });
    }
    void measure() {
        double steps[3] = {};
        forEachSample([&](int x, int y, int z) {
            const double here = double(samples[at(x, y, z)]);
            most = std::max(most, std::abs(here));
            const int next[3] = {x + 1, y + 1, z + 1};
            for (int a = 0; a < 3; ++a)
                if (next[a] <= cells.box_end[a])
                    steps[a] = std::max(
                        steps[a],
                        std::abs(double(samples[at(x + (a == 0), y + (a == 1), z + (a == 2))]) - here));
        });
        steepness = steps[0] + steps[1] + steps[2];
    }
};

// A ray through the brick's box, of a kind that walks get wrong.
IndexRay awkwardRay(std::mt19937& random, const TestBrick& brick) {
    glm::dvec3 through, way;
    for (int a = 0; a < 3; ++a) {
        through[a] = uniform(random, brick.cells.box_begin[a], brick.cells.box_end[a]);
        way[a] = uniform(random, -1, 1);
    }
    const int kind = below(random, 6), axis = below(random, 3);
    auto tiny = [&] {
        const double least[] = {1e-3, 1e-7, 1e-12, 1e-17, 1e-30, 1e-100, 1e-200};
        return (random() % 2 ? 1 : -1) * least[below(random, 7)];
    };
    double away = std::exp2(uniform(random, -3, 16));
    if (kind == 1 || kind == 2) way[axis] = tiny();
    if (kind == 2) way[(axis + 1) % 3] = tiny();
    if (kind == 3) {  // along a plane between cells, or along a face
        through[axis] = brick.cells.box_begin[axis] +
                        below(random, brick.cells.box_end[axis] - brick.cells.box_begin[axis] + 1);
        way[axis] = tiny();
    }
    if (kind == 4) {  // from corner to corner, each position exact
        for (int a = 0; a < 3; ++a) {
            through[a] = brick.cells.box_begin[a] +
                         below(random, brick.cells.box_end[a] - brick.cells.box_begin[a] + 1);
            way[a] = (random() % 2 ? 1 : -1) * (1 + below(random, 2));
        }
        away = std::floor(away);
    }
    if (kind == 5) away = 0;  // begins inside
    const double speed = kind == 4 ? 1 : std::exp2(uniform(random, -6, 6));
    IndexRay ray;
    for (int a = 0; a < 3; ++a) {
        ray.origin[a] = brick.cells.low[a] + brick.cells.cell_edge * (through[a] - away * way[a]);
        ray.direction[a] = speed * way[a];
        ray.inverse[a] = 1 / ray.direction[a];
    }
    return ray;
}

// Spans as the renderer has them: what a ray has inside the brick, or a part of it.
struct TestRays {
    RayPacket packet;
    PacketSpans spans;

    TestRays(std::mt19937& random, const TestBrick& brick) {
        double high[3];
        for (int a = 0; a < 3; ++a) high[a] = brick.cells.low[a] + brick.cells.cell_edge * brick.cells_along;
        for (int lane = 0; lane < kLanes; ++lane) packet.set(lane, awkwardRay(random, brick), {0, kNever});
        clipPacket(packet, brick.cells.low, high, spans);
        for (int lane = 0; lane < kLanes; ++lane) {
            const double begin = spans.begin[lane], length = spans.end[lane] - begin;
            if (below(random, 4) > 0 || !(length > 0)) continue;
            spans.begin[lane] = begin + 0.3 * uniform(random, 0, 1) * length;
            spans.end[lane] = begin + uniform(random, 0.3, 1) * length;
        }
    }
    bool inSpan(int lane) const { return spans.begin[lane] < spans.end[lane]; }
    double length(int lane) const { return inSpan(lane) ? spans.end[lane] - spans.begin[lane] : 0; }
    // An axis hardly moves: where it crosses a plane is then a matter of rounding. The integral hardly minds,
    // since the field is continuous; what is said of single cells does.
    bool grazes(int lane) const {
        for (const auto& direction : packet.direction)
            if (std::abs(direction[lane]) * unit(lane) < 5e-3) return true;
        return false;
    }
    // World length of an index unit.
    double unit(int lane) const {
        return 1 /
               std::hypot(packet.direction[0][lane], packet.direction[1][lane], packet.direction[2][lane]);
    }
};

// One cell that a ray crosses: world distances, and the field between them.
struct ReferenceCell {
    int cell[3];
    long double begin, end;
    Bernstein cubic{};
    long double amount() const { return (end - begin) * positiveMean(cubic); }
};

// Calls visit(cell, begin, end) for the cells of a grid that a lane's span meets, in order.
template <class Visit>
void forEachCell(const TestRays& rays, int lane, const double low[3], double cell_edge, const int first[3],
                 const int last[3], Visit&& visit) {
    if (!rays.inSpan(lane)) return;
    long double begin = (long double)rays.spans.begin[lane], end = (long double)rays.spans.end[lane];
    long double origin[3], direction[3];
    std::vector<long double> planes;
    for (int a = 0; a < 3; ++a) {
        origin[a] = ((long double)rays.packet.origin[a][lane] - (long double)low[a]) / (long double)cell_edge;
        direction[a] = (long double)rays.packet.direction[a][lane] / (long double)cell_edge;
        const long double p = ((long double)first[a] - origin[a]) / direction[a],
                          q = ((long double)last[a] - origin[a]) / direction[a];
        begin = std::max(begin, std::min(p, q));
        end = std::min(end, std::max(p, q));
        for (int k = first[a] + 1; k < last[a]; ++k)
            planes.push_back(((long double)k - origin[a]) / direction[a]);
    }
    if (!(begin < end)) return;
    planes.push_back(begin);
    planes.push_back(end);
    std::sort(planes.begin(), planes.end());
    for (std::size_t i = 0; i + 1 < planes.size(); ++i) {
        const long double from = planes[i], to = planes[i + 1];
        if (from < begin || to > end || !(from < to)) continue;
        int cell[3];
        for (int a = 0; a < 3; ++a) {
            const long double middle = origin[a] + (from + to) / 2 * direction[a];
            cell[a] = std::clamp(int(std::floor(middle)), first[a], last[a] - 1);
        }
        visit(cell, from, to);
    }
}

std::vector<ReferenceCell> cellsAlong(TestBrick& brick, const TestRays& rays, int lane) {
    std::vector<ReferenceCell> out;
    const BrickCells& cells = brick.cells;
    forEachCell(
        rays, lane, cells.low, cells.cell_edge, cells.box_begin, cells.box_end,
        [&](const int* cell, long double from, long double to) {
            ReferenceCell& step = out.emplace_back();
            std::copy_n(cell, 3, step.cell);
            step.begin = from, step.end = to;
            // Positions of both ends within the cell, blended: the cubic's control points.
            long double ends[2][3];
            for (int a = 0; a < 3; ++a)
                for (int e = 0; e < 2; ++e)
                    ends[e][a] = ((long double)rays.packet.origin[a][lane] - (long double)cells.low[a] +
                                  (e ? to : from) * (long double)rays.packet.direction[a][lane]) /
                                     (long double)cells.cell_edge -
                                 (long double)cell[a];
            for (unsigned which = 0; which < 8; ++which) {
                long double value = 0;
                for (unsigned i = 0; i < 8; ++i) {
                    long double weight = 1;
                    for (unsigned a = 0; a < 3; ++a) {
                        const long double x = ends[which >> a & 1][a];
                        weight *= (i >> a & 1) ? x : 1 - x;
                    }
                    value +=
                        weight * (long double)brick.samples[brick.at(
                                     cell[0] + int(i & 1), cell[1] + int(i >> 1 & 1), cell[2] + int(i >> 2))];
                }
                const int k = __builtin_popcount(which);
                step.cubic[std::size_t(k)] += k == 0 || k == 3 ? value : value / 3;
            }
        });
    return out;
}

// What the header states of an integral's error.
double statedBound(const TestBrick& brick, const TestRays& rays, int lane) {
    return (kPositionRounding * brick.cells_along * brick.steepness + kSampleRounding * brick.most) *
               rays.length(lane) +
           (brick.most + brick.steepness) * kLostLength * brick.cells.cell_edge * rays.unit(lane);
}

// A lattice over a brick's box, as CornerQuads has samples.
struct TestLight {
    GuardedFloats quads;
    LightCells cells;
    std::vector<float> values;
    int cells_along = 1;  // of the longest axis

    TestLight(std::mt19937& random, const TestBrick& brick, double most_depth, bool constant)
        : TestLight(random, brick, pointsOf(random), most_depth, constant) {}

    double depthAt(const TestBrick& brick, const double position[3]) const {
        double inside[3];
        int cell[3];
        for (int a = 0; a < 3; ++a) {
            const double at = std::clamp((position[a] - brick.cells.box_begin[a]) * double(cells.per_cell[a]),
                                         0.0, cells.points[a] - 1.0);
            cell[a] = std::min(int(at), cells.points[a] - 2);
            inside[a] = at - cell[a];
        }
        double depth = 0;
        for (int k = 0; k < 8; ++k) {
            double weight = 1;
            for (int a = 0; a < 3; ++a) weight *= (k >> a & 1) ? inside[a] : 1 - inside[a];
            depth +=
                weight * double(values[at(cell[0] + (k & 1), cell[1] + (k >> 1 & 1), cell[2] + (k >> 2))]);
        }
        return depth;
    }

private:
    using Points = std::array<int, 3>;
    static Points pointsOf(std::mt19937& random) {
        Points points;
        for (int& along : points) along = 1 + 2 * (1 + below(random, kMostLightCells / 2));
        return points;
    }
    std::size_t at(int x, int y, int z) const {
        return std::size_t(x + cells.points[0] * (y + cells.points[1] * z));
    }
    TestLight(std::mt19937& random, const TestBrick& brick, const Points& points, double most_depth,
              bool constant)
        : quads(4 * std::size_t(points[0]) * std::size_t(points[1]) * std::size_t(points[2]), true) {
        for (std::size_t a = 0; a < 3; ++a) {
            cells.points[a] = points[a];
            cells.per_cell[a] =
                float(points[a] - 1) / float(brick.cells.box_end[a] - brick.cells.box_begin[a]);
            cells_along = std::max(cells_along, points[a] - 1);
        }
        cells.quads = quads.data();
        const double same = uniform(random, 0, most_depth);
        for (int i = 0; i < points[0] * points[1] * points[2]; ++i)
            values.push_back(float(constant ? same : uniform(random, 0, most_depth)));
        for (int z = 0; z < points[2]; ++z)
            for (int y = 0; y < points[1]; ++y)
                for (int x = 0; x < points[0]; ++x)
                    for (int k = 0; k < 4; ++k)
                        quads[4 * at(x, y, z) + std::size_t(k)] = values[at(
                            std::min(x + (k & 1), points[0] - 1), std::min(y + (k >> 1), points[1] - 1), z)];
    }
};

// Calls body(brick, rays) for bricks of every edge, content and box.
template <class Body>
void forRandomBricks(unsigned seed, int packets, Body&& body) {
    std::mt19937 random(seed);
    for (const int edge : {8, 16, 32, 64})
        for (const Content content : kContents)
            for (const bool tight : {false, true}) {
                TestBrick brick(random, edge, content, tight, std::exp2(below(random, 80) - 40));
                for (int i = 0; i < packets; ++i) {
                    SCOPED_TRACE(testing::Message() << "edge " << edge << ", content " << int(content)
                                                    << (tight ? ", tight" : "") << ", packet " << i);
                    body(brick, TestRays(random, brick), random);
                }
            }
}

void expectIntegralsWithinTheirBounds() {
    double worst = 0;
    std::size_t tested = 0;
    forRandomBricks(1, 12, [&](TestBrick& brick, const TestRays& rays, std::mt19937&) {
        double sums[kLanes] = {};
        integrateBrick(rays.packet, brick.cells, rays.spans, sums);
        for (int lane = 0; lane < kLanes; ++lane) {
            long double truth = 0;
            for (const ReferenceCell& cell : cellsAlong(brick, rays, lane)) truth += cell.amount();
            const double error = std::abs(double((long double)sums[lane] - truth));
            const double bound = statedBound(brick, rays, lane);
            EXPECT_LE(error, bound) << "lane " << lane << ": " << sums[lane] << " instead of " << truth;
            if (truth > 0) worst = std::max(worst, error / bound), ++tested;
        }
    });
    EXPECT_GT(tested, 3000u);
    testing::Test::RecordProperty(std::string("worst_share_of_bound_") + kernelTarget(),
                                  std::to_string(worst));
}

TEST(PacketKernelTest, ABricksIntegralIsWithinItsStatedBoundOnEveryInstructionSet) {
    const std::int64_t all = hwy::SupportedTargets();
    for (const std::int64_t target : {HWY_AVX3, HWY_AVX2, HWY_EMU128}) {
        if (!(all & target)) continue;
        hwy::GetChosenTarget().Update(target);
        SCOPED_TRACE(kernelTarget());
        expectIntegralsWithinTheirBounds();
    }
    hwy::GetChosenTarget().Update(all);
}

TEST(PacketKernelTest, QuadsGiveTheBitsThatSamplesGive) {
    forRandomBricks(2, 8, [&](TestBrick& brick, const TestRays& rays, std::mt19937&) {
        double from_samples[kLanes] = {}, from_quads[kLanes] = {}, as_made[kLanes] = {};
        integrateBrick(rays.packet, brick.cells, rays.spans, from_samples);
        integrateBrick(rays.packet, brick.withQuads(), rays.spans, from_quads);
        EXPECT_EQ(std::memcmp(from_samples, from_quads, sizeof from_samples), 0);
        CornerQuads maker;
        BrickCells made = brick.cells;
        made.quads = maker.of(brick.cells);
        integrateBrick(rays.packet, made, rays.spans, as_made);
        EXPECT_EQ(std::memcmp(from_samples, as_made, sizeof from_samples), 0);
    });
}

// Of `rays`, lane `lane` and no other, as lane `to`.
TestRays alone(const TestRays& rays, int lane, int to) {
    TestRays out = rays;
    for (int i = 0; i < kLanes; ++i) out.spans.begin[i] = out.spans.end[i] = kNever;
    for (int a = 0; a < 3; ++a) {
        out.packet.origin[a][to] = rays.packet.origin[a][lane];
        out.packet.direction[a][to] = rays.packet.direction[a][lane];
        out.packet.inverse[a][to] = rays.packet.inverse[a][lane];
    }
    out.spans.begin[to] = rays.spans.begin[lane];
    out.spans.end[to] = rays.spans.end[lane];
    return out;
}

TEST(PacketKernelTest, WhatARayScattersDoesNotDependOnItsNeighbours) {
    forRandomBricks(10, 1, [&](TestBrick& brick, const TestRays& rays, std::mt19937& random) {
        const TestLight light(random, brick, 2, /*constant=*/false);
        const double scale = std::exp(uniform(random, -3, 3)) / (brick.cells.cell_edge * brick.most);
        PacketScatter together;
        scatterInBrick(rays.packet, brick.cells, light.cells, rays.spans, scale, together);
        for (int lane = 0; lane < kLanes; ++lane) {
            const int to = below(random, kLanes);
            const TestRays one = alone(rays, lane, to);
            PacketScatter out;
            scatterInBrick(one.packet, brick.cells, light.cells, one.spans, scale, out);
            EXPECT_EQ(out.depth[to], together.depth[lane]) << "lane " << lane << " moved to " << to;
            EXPECT_EQ(out.weight[to], together.weight[lane]) << "lane " << lane << " moved to " << to;
            EXPECT_EQ(out.passed[to], together.passed[lane]) << "lane " << lane << " moved to " << to;
            EXPECT_EQ(out.last[to], together.last[lane]) << "lane " << lane << " moved to " << to;
        }
    });
}

TEST(PacketKernelTest, ARaysIntegralDoesNotDependOnItsNeighbours) {
    forRandomBricks(3, 4, [&](TestBrick& brick, const TestRays& rays, std::mt19937& random) {
        double together[kLanes] = {};
        integrateBrick(rays.packet, brick.cells, rays.spans, together);
        for (int lane = 0; lane < kLanes; ++lane) {
            const int other = below(random, kLanes);
            const TestRays one = alone(rays, lane, other);
            double sums[kLanes] = {};
            integrateBrick(one.packet, brick.cells, one.spans, sums);
            EXPECT_EQ(sums[other], together[lane]) << "lane " << lane << " moved to " << other;
            for (int i = 0; i < kLanes; ++i)
                if (i != other) EXPECT_EQ(sums[i], 0) << "a ray that is not there";
        }
    });
}

TEST(PacketKernelTest, RaysThatMissTheBoxAddNothing) {
    std::mt19937 random(4);
    TestBrick brick(random, 16, Content::kConstant, /*tight=*/false, 1);
    RayPacket packet;
    PacketSpans spans;
    for (int lane = 0; lane < kLanes; ++lane) {
        IndexRay ray = awkwardRay(random, brick);
        ray.origin[lane % 3] += 1e7;
        packet.set(lane, ray, {0, kNever});
        // The kernel clips to the box itself: spans may be wider.
        spans.begin[lane] = lane % 4 == 0 ? kNever : 0;
        spans.end[lane] = lane % 4 == 1 ? -kNever : lane % 4 == 2 ? 1e-3 : 1;
    }
    double sums[kLanes] = {};
    integrateBrick(packet, brick.cells, spans, sums);
    for (double sum : sums) EXPECT_EQ(sum, 0);
}

// The rule of the header: linear within a cell.
TEST(PacketKernelTest, WhatIsFoundIsWhereTheIntegralReachesItsTarget) {
    constexpr double kUntouched = -7;
    std::size_t reached = 0;
    forRandomBricks(5, 6, [&](TestBrick& brick, const TestRays& rays, std::mt19937& random) {
        double targets[kLanes], sums[kLanes], found[kLanes];
        std::vector<ReferenceCell> cells[kLanes];
        for (int lane = 0; lane < kLanes; ++lane) {
            cells[lane] = cellsAlong(brick, rays, lane);
            double whole = 0;
            for (const ReferenceCell& cell : cells[lane]) whole += double(cell.amount());
            sums[lane] = uniform(random, 0, 1) * whole;
            targets[lane] = sums[lane] + whole * (below(random, 4) == 0 ? 1.01 : uniform(random, 0.01, 0.99));
            if (whole == 0) targets[lane] = 1;
            found[lane] = kUntouched;
        }
        double before[kLanes];
        std::copy_n(sums, kLanes, before);
        findInBrick(rays.packet, brick.cells, rays.spans, targets, sums, found);
        for (int lane = 0; lane < kLanes; ++lane) {
            if (rays.grazes(lane)) continue;
            long double sum = (long double)before[lane];
            const long double target = (long double)targets[lane];
            // No better than the sum is: between where a little less and a little more would be reached.
            // Without Kahan's sum, each cell adds a rounding of its own.
            const long double slack =
                (long double)(statedBound(brick, rays, lane) +
                              double(cells[lane].size()) * 0x1p-24 * brick.most * rays.length(lane));
            long double least = -1, most = -1;
            for (const ReferenceCell& cell : cells[lane]) {
                const long double amount = cell.amount();
                const auto where = [&](long double wanted) {
                    const long double part = amount > 0 ? (wanted - sum) / amount : 1;
                    return cell.begin + std::clamp(part, 0.0L, 1.0L) * (cell.end - cell.begin);
                };
                if (least < 0 && sum + amount >= target - slack) least = where(target - slack);
                if (most < 0 && sum + amount > target + slack) most = where(target + slack);
                sum += amount;
            }
            const double place = 1e-6 * brick.cells.cell_edge * brick.cells_along * rays.unit(lane);
            if (found[lane] == kUntouched) {
                EXPECT_LT(most, 0) << "lane " << lane << ": the target is reached at " << most;
                continue;
            }
            ++reached;
            ASSERT_GE(least, 0) << "lane " << lane << " never reaches its target";
            EXPECT_GE(found[lane], double(least) - place) << "lane " << lane;
            if (most >= 0) EXPECT_LE(found[lane], double(most) + place) << "lane " << lane;
        }
    });
    EXPECT_GT(reached, 1000u);
}

TEST(PacketKernelTest, AGridOfSubBoxesIsSummedToFloatRounding) {
    std::mt19937 random(6);
    std::size_t tested = 0;
    for (int trial = 0; trial < 200; ++trial) {
        TestBrick brick(random, 8, Content::kConstant, /*tight=*/false, 1);
        const TestRays rays(random, brick);
        float first[64], second[64];
        for (int i = 0; i < 64; ++i) {
            first[i] = random() % 3 ? float(uniform(random, 0, 1)) : 0.0f;
            second[i] = float(uniform(random, 0, 1) * std::exp2(-below(random, 60)));
        }
        const double edge = brick.cells.cell_edge * brick.cells_along;
        double one[kLanes], two[kLanes];
        std::fill_n(one, kLanes, 0.25);  // is added to
        std::fill_n(two, kLanes, 0.0);
        integrateGrid(rays.packet, brick.cells.low, edge, rays.spans, first, second, one, two);
        constexpr int kBegin[3] = {0, 0, 0}, kEnd[3] = {4, 4, 4};
        for (int lane = 0; lane < kLanes; ++lane) {
            long double truth_one = 0, truth_two = 0;
            forEachCell(rays, lane, brick.cells.low, edge / 4, kBegin, kEnd,
                        [&](const int* cell, long double from, long double to) {
                            const std::size_t at = std::size_t(cell[0] + 4 * (cell[1] + 4 * cell[2]));
                            truth_one += (to - from) * (long double)first[at];
                            truth_two += (to - from) * (long double)second[at];
                        });
            if (rays.grazes(lane)) continue;
            ++tested;
            const double slack = 1e-6 * double(truth_one) + 1e-4 * edge * rays.unit(lane);
            EXPECT_NEAR(one[lane] - 0.25, double(truth_one), slack) << "lane " << lane;
            EXPECT_NEAR(two[lane], double(truth_two), slack) << "lane " << lane;
        }
    }
    EXPECT_GT(tested, 1000u);
}

// Closed form: S (1 - T), however thin the haze is.
TEST(PacketKernelTest, AHomogeneousBrickInHomogeneousLightScattersByTheFormula) {
    std::mt19937 random(7);
    std::size_t tested = 0;
    for (const int edge : {8, 16, 32, 64})
        for (int trial = 0; trial < 40; ++trial) {
            TestBrick brick(random, edge, Content::kConstant, trial % 2 == 0, 1);
            const TestLight light(random, brick, 3, /*constant=*/true);
            const TestRays rays(random, brick);
            // From a haze that nobody sees to a wall.
            double scale = 0;
            for (int lane = 0; lane < kLanes; ++lane) scale = std::max(scale, rays.length(lane));
            scale = scale > 0 ? std::exp(uniform(random, -18, 3)) / scale : 1;
            PacketScatter out;
            scatterInBrick(rays.packet, trial % 3 ? brick.cells : brick.withQuads(), light.cells, rays.spans,
                           scale, out);
            double sums[kLanes] = {};
            integrateBrick(rays.packet, brick.cells, rays.spans, sums);
            const double lit = std::exp(-double(light.values[0]));
            for (int lane = 0; lane < kLanes; ++lane) {
                const double opacity = -std::expm1(-scale * sums[lane]);
                EXPECT_EQ(out.depth[lane], sums[lane]) << "lane " << lane;
                EXPECT_NEAR(out.weight[lane], lit * opacity, 3e-6 * opacity) << "lane " << lane;
                EXPECT_NEAR(out.passed[lane], 1 - opacity, 3e-6 * opacity + 1e-7) << "lane " << lane;
                EXPECT_NEAR(out.last[lane], sums[lane] > 0 ? lit : 1, 1e-6) << "lane " << lane;
                tested += opacity > 0;
            }
        }
    EXPECT_GT(tested, 1000u);
}

// The same rule in double: a cell's light is that of its middle, on the line between two points of the span.
TEST(PacketKernelTest, WhatABrickScattersIsTheSumOverItsCells) {
    forRandomBricks(8, 3, [&](TestBrick& brick, const TestRays& rays, std::mt19937& random) {
        const TestLight light(random, brick, 2, /*constant=*/false);
        double longest = 1e-30;
        for (int lane = 0; lane < kLanes; ++lane) longest = std::max(longest, rays.length(lane));
        const double scale = std::exp(uniform(random, -8, 3)) / (longest * brick.most);
        PacketScatter out, with_quads;
        scatterInBrick(rays.packet, brick.cells, light.cells, rays.spans, scale, out);
        scatterInBrick(rays.packet, brick.withQuads(), light.cells, rays.spans, scale, with_quads);
        EXPECT_EQ(std::memcmp(&out, &with_quads, sizeof out), 0) << "quads give other bits";
        for (int lane = 0; lane < kLanes; ++lane) {
            const std::vector<ReferenceCell> cells = cellsAlong(brick, rays, lane);
            double depth = 0, weight = 0, passed = 1;
            for (const ReferenceCell& cell : cells) {
                const auto begin = double(cells.front().begin), end = double(cells.back().end);
                const double at =
                    (double(cell.begin + cell.end) / 2 - begin) / (end - begin) * light.cells_along;
                const double row = std::min(std::floor(at), light.cells_along - 1.0);
                double ends[2];
                for (int e = 0; e < 2; ++e) {
                    const double t = begin + (end - begin) * (row + e) / light.cells_along;
                    double position[3];
                    for (int a = 0; a < 3; ++a)
                        position[a] = (rays.packet.origin[a][lane] + t * rays.packet.direction[a][lane] -
                                       brick.cells.low[a]) /
                                      brick.cells.cell_edge;
                    ends[e] = light.depthAt(brick, position);
                }
                const auto amount = double(cell.amount());
                const double absorbed = -passed * std::expm1(-amount * scale);
                weight += absorbed * std::exp(-(ends[0] + (ends[1] - ends[0]) * (at - row)));
                passed -= absorbed;
                depth += amount;
            }
            const double slack = 2 * scale * statedBound(brick, rays, lane) + 1e-5;
            EXPECT_NEAR(out.depth[lane], depth, statedBound(brick, rays, lane)) << "lane " << lane;
            if (!rays.grazes(lane)) EXPECT_NEAR(out.weight[lane], weight, slack) << "lane " << lane;
            EXPECT_NEAR(out.passed[lane], passed, slack) << "lane " << lane;
        }
    });
}

// Boxes that share a face tile a ray, and the list keeps its order.
TEST(PacketKernelTest, ClippingAgreesWithEachRayAlone) {
    std::mt19937 random(9);
    TestBrick brick(random, 16, Content::kConstant, /*tight=*/false, 1);
    std::vector<RayPacket> packets;
    std::vector<std::uint16_t> all;
    for (int i = 0; i < 50; ++i) {
        all.push_back(std::uint16_t(i));
        RayPacket& packet = packets.emplace_back(TestRays(random, brick).packet);
        for (int lane = 0; lane < kLanes; ++lane) {
            if (i % 2 && lane != i % kLanes) packet.begin[lane] = kNever;  // one ray in most
            if (i % 5 == 0) packet.origin[0][lane] += 3 * brick.cells.cell_edge * uniform(random, 0, 16);
        }
    }
    std::size_t outside = 0;
    for (int trial = 0; trial < 50; ++trial) {
        glm::dvec3 low, high;
        for (int a = 0; a < 3; ++a) {
            low[a] = brick.cells.low[a] + brick.cells.cell_edge * below(random, 16);
            high[a] = low[a] + brick.cells.cell_edge * (1 + below(random, 4));
        }
        std::vector<std::uint16_t> kept(all.size()), expected;
        for (std::uint16_t place : all) {
            PacketSpans spans;
            clipPacket(packets[place], &low[0], &high[0], spans);
            bool any = false;
            for (int lane = 0; lane < kLanes; ++lane) {
                IndexRay ray;
                for (int a = 0; a < 3; ++a) {
                    ray.origin[a] = packets[place].origin[a][lane];
                    ray.inverse[a] = packets[place].inverse[a][lane];
                }
                const RaySpan alone =
                    ray.clip(low, high, {packets[place].begin[lane], packets[place].end[lane]});
                EXPECT_EQ(spans.begin[lane], alone.begin);
                EXPECT_EQ(spans.end[lane], alone.end);
                any |= !alone.empty();
            }
            if (any) expected.push_back(place);
        }
        kept.resize(clipPackets(packets.data(), all.data(), all.size(), &low[0], &high[0], kept.data()));
        EXPECT_EQ(kept, expected);
        outside += all.size() - kept.size();
    }
    EXPECT_GT(outside, 100u) << "every box meets every packet";
}

}  // namespace
}  // namespace brickyard

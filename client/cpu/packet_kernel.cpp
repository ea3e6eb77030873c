// Built once per instruction set by Highway's foreach_target; the functions at the end choose at run time.
// AVX-512 and AVX2 are what servers and workstations have; anything else runs the baseline.
#include <hwy/detect_targets.h>
#undef HWY_DISABLED_TARGETS
#define HWY_DISABLED_TARGETS (HWY_SSSE3 | HWY_SSE4 | HWY_AVX3_DL)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "client/cpu/packet_kernel.cpp"
// clang-format off: foreach_target.h includes this file again, so it comes first
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
#include <hwy/contrib/math/math-inl.h>
// clang-format on
#include "client/cpu/cell_walk.h"
#include "client/cpu/packet_kernel.h"

#ifndef BRICKYARD_PACKET_KERNEL_SCALAR  // once, not once per target
#define BRICKYARD_PACKET_KERNEL_SCALAR
namespace brickyard {
namespace {

// Mean of max(0, field) from `from` to `to` in the cell that begins at sample `at`; `otherwise` where no
// corner is negative.
double meanOfCell(const BrickCells& brick, std::int32_t at, const glm::dvec3& from, const glm::dvec3& to,
                  double otherwise) {
    const float* c = brick.samples + at;
    const int sy = brick.edge_samples, sz = sy * sy;
    const Cell cell{{c[0], c[1], c[sy], c[sy + 1], c[sz], c[sz + 1], c[sz + sy], c[sz + sy + 1]}};
    for (double corner : cell.corner)
        if (corner < 0) return meanPositive(cell, glm::clamp(from, 0.0, 1.0), glm::clamp(to, 0.0, 1.0));
    return otherwise;
}

}  // namespace
}  // namespace brickyard
#endif

HWY_BEFORE_NAMESPACE();
namespace brickyard {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

constexpr std::size_t kRays = RayPacket::kRays;
using D = hn::CappedTag<double, kRays>;
using V = hn::Vec<D>;
using F = hn::CappedTag<float, kRays>;
using VF = hn::Vec<F>;
using MF = hn::Mask<F>;
using I = hn::RebindToSigned<F>;
using VI = hn::Vec<I>;
constexpr D kD;
constexpr F kF;
constexpr I kI;

// The live part of rays [i, i + lanes) inside a box.
HWY_ATTR HWY_INLINE void clip(const RayPacket& p, std::size_t i, const double* low, const double* high,
                              V& begin, V& end) {
    begin = hn::Load(kD, p.begin + i);
    end = hn::Load(kD, p.end + i);
    for (int a = 0; a < 3; ++a) {
        const V origin = hn::Load(kD, p.origin[a] + i), inverse = hn::Load(kD, p.inverse[a] + i);
        const V t0 = hn::Mul(hn::Sub(hn::Set(kD, low[a]), origin), inverse);
        const V t1 = hn::Mul(hn::Sub(hn::Set(kD, high[a]), origin), inverse);
        begin = hn::Max(begin, hn::Min(t0, t1));
        end = hn::Min(end, hn::Max(t0, t1));
    }
}

HWY_ATTR std::size_t ClipPackets(const RayPacket* packets, const std::uint16_t* in, std::size_t count,
                                 const double* low, const double* high, std::uint16_t* out) {
    std::size_t kept = 0;
    for (std::size_t k = 0; k < count; ++k) {
        const RayPacket& p = packets[in[k]];
        bool any = false;
        for (std::size_t i = 0; i < kRays && !any; i += hn::Lanes(kD)) {
            V begin, end;
            clip(p, i, low, high, begin, end);
            any = !hn::AllFalse(kD, hn::Lt(begin, end));
        }
        out[kept] = in[k];
        kept += any;
    }
    return kept;
}

HWY_ATTR void ClipPacket(const RayPacket& packet, const double* low, const double* high, PacketSpans& spans) {
    for (std::size_t i = 0; i < kRays; i += hn::Lanes(kD)) {
        V begin, end;
        clip(packet, i, low, high, begin, end);
        hn::Store(begin, kD, spans.begin + i);
        hn::Store(end, kD, spans.end + i);
    }
}

// A packet's rays within a regular grid of cells, in floats: positions are in cells from the grid's middle, s
// is a ray's length in cells from the middle of its span. So both stay small, and a float's rounding with
// them.
struct alignas(64) LocalRays {
    float position[3][kRays];   // at s = 0
    float direction[3][kRays];  // unit
    float inverse[3][kRays];    // finite
    float begin[kRays], end[kRays];
    double middle[kRays];   // world distance of s = 0
    double unit[kRays];     // world length of s = 1
    double centre;          // of the grid, in cells from its low corner
    int first[3], last[3];  // cells to walk
    int most;               // no ray has more of them
};

// Where an axis moves by less than this over a cell's length, it counts as still: the plane that it never
// reaches then lies far away instead of at infinity, where it would make a NaN.
constexpr float kLeastSlope = 1e-18f;

// False where no ray has anything to walk.
HWY_ATTR bool localRays(const RayPacket& p, const double* low, double cell_edge, double centre,
                        const int* first, const int* last, const PacketSpans& spans, LocalRays& out) {
    using H = hn::Rebind<float, D>;
    constexpr H kH;
    out.centre = centre;
    out.most = 1;
    for (int a = 0; a < 3; ++a) {
        out.first[a] = first[a];
        out.last[a] = last[a];
        out.most += last[a] - first[a];
    }
    bool any = false;
    const V per_cell = hn::Set(kD, 1 / cell_edge);
    for (std::size_t i = 0; i < kRays; i += hn::Lanes(kD)) {
        V t = hn::Load(kD, spans.begin + i), end = hn::Load(kD, spans.end + i);
        V square = hn::Zero(kD);
        V direction[3], origin[3];
        for (int a = 0; a < 3; ++a) {
            const V inverse = hn::Load(kD, p.inverse[a] + i);
            origin[a] = hn::Sub(hn::Load(kD, p.origin[a] + i), hn::Set(kD, low[a]));
            const V t0 = hn::Mul(hn::Sub(hn::Set(kD, first[a] * cell_edge), origin[a]), inverse);
            const V t1 = hn::Mul(hn::Sub(hn::Set(kD, last[a] * cell_edge), origin[a]), inverse);
            t = hn::Max(t, hn::Min(t0, t1));
            end = hn::Min(end, hn::Max(t0, t1));
            direction[a] = hn::Mul(hn::Load(kD, p.direction[a] + i), per_cell);
            square = hn::MulAdd(direction[a], direction[a], square);
        }
        const auto there = hn::Lt(t, end);
        any |= !hn::AllFalse(kD, there);
        const V speed = hn::Sqrt(square), unit = hn::Div(hn::Set(kD, 1.0), speed);
        const V middle = hn::IfThenElse(there, hn::Mul(hn::Set(kD, 0.5), hn::Add(t, end)), t);
        hn::Store(middle, kD, out.middle + i);
        hn::Store(unit, kD, out.unit + i);
        const V half = hn::IfThenElseZero(there, hn::Mul(hn::Mul(hn::Set(kD, 0.5), hn::Sub(end, t)), speed));
        hn::Store(hn::DemoteTo(kH, hn::Neg(half)), kH, out.begin + i);
        hn::Store(hn::DemoteTo(kH, half), kH, out.end + i);
        for (int a = 0; a < 3; ++a) {
            const V slope = hn::Mul(direction[a], unit);
            const V steep = hn::CopySign(hn::Max(hn::Abs(slope), hn::Set(kD, double(kLeastSlope))), slope);
            const V at =
                hn::Sub(hn::Mul(hn::MulAdd(middle, hn::Load(kD, p.direction[a] + i), origin[a]), per_cell),
                        hn::Set(kD, centre));
            hn::Store(hn::DemoteTo(kH, hn::IfThenElseZero(there, at)), kH, out.position[a] + i);
            hn::Store(hn::DemoteTo(kH, steep), kH, out.direction[a] + i);
            hn::Store(hn::DemoteTo(kH, hn::Div(hn::Set(kD, 1.0), steep)), kH, out.inverse[a] + i);
        }
    }
    return any;
}

// One axis of a walk: the cell that each ray is in and the plane where it leaves it.
struct Axis {
    VF position, direction, inverse;
    VF cell;   // its low plane, from the grid's middle
    VF step;   // +1 or -1
    VF plane;  // that ends the cell; `beyond` all distances once that is a face of the grid
    VF last, beyond;

    // Begins at `s`.
    HWY_ATTR HWY_INLINE void start(const LocalRays& rays, int a, std::size_t i, VF s) {
        position = hn::Load(kF, rays.position[a] + i);
        direction = hn::Load(kF, rays.direction[a] + i);
        inverse = hn::Load(kF, rays.inverse[a] + i);
        const VF lowest = hn::Set(kF, float(rays.first[a] - rays.centre));
        const VF outer = hn::Set(kF, float(rays.last[a] - rays.centre));
        const VF highest = hn::Sub(outer, hn::Set(kF, 1.0f));
        // The grid's middle may lie within a cell: planes are at lowest + k.
        cell = hn::Add(hn::Floor(hn::Sub(hn::MulAdd(s, direction, position), lowest)), lowest);
        // A NaN becomes the first cell: an index is never taken from it.
        cell = hn::IfThenElse(hn::Ge(cell, lowest), hn::Min(cell, highest), lowest);
        const MF forward = hn::Gt(direction, hn::Zero(kF));
        step = hn::IfThenElse(forward, hn::Set(kF, 1.0f), hn::Set(kF, -1.0f));
        last = hn::IfThenElse(forward, outer, lowest);
        beyond = hn::Mul(step, hn::Set(kF, 1e30f));
        setPlane(hn::Add(cell, hn::IfThenElseZero(forward, hn::Set(kF, 1.0f))));
    }
    // The ray's end says where it leaves the grid, not this: where an axis hardly moves, the rounding of a
    // position would be a long way.
    HWY_ATTR HWY_INLINE void setPlane(VF to) { plane = hn::IfThenElse(hn::Eq(to, last), beyond, to); }
    HWY_ATTR HWY_INLINE VF next() const { return hn::Mul(hn::Sub(plane, position), inverse); }
    HWY_ATTR HWY_INLINE VF inCell(VF s) const { return hn::Sub(hn::MulAdd(s, direction, position), cell); }
    HWY_ATTR HWY_INLINE void advance(MF where) {
        const VF by = hn::IfThenElseZero(where, step);
        setPlane(hn::Add(plane, by));
        cell = hn::Add(cell, by);
    }
    // Number of the cell from the grid's low corner.
    HWY_ATTR HWY_INLINE VI number(float centre) const {
        return hn::ConvertTo(kI, hn::Add(cell, hn::Set(kF, centre)));
    }
};

// Walks rays [i, i + lanes) through the cells. visit(step) is told of each step, and returns the rays that
// may go on.
struct Step {
    const Axis &x, &y, &z;
    VF begin, end, length;  // of the step, as s; length 0 for rays that are done
    VI index;               // of the cell: x + y * row + z * slice
};
template <class Visit>
HWY_ATTR HWY_INLINE void walk(const LocalRays& rays, std::size_t i, int row, int slice, const Visit& visit) {
    VF s = hn::Load(kF, rays.begin + i);
    const VF end = hn::Load(kF, rays.end + i);
    MF going = hn::Lt(s, end);
    if (hn::AllFalse(kF, going)) return;
    Axis x, y, z;
    x.start(rays, 0, i, s);
    y.start(rays, 1, i, s);
    z.start(rays, 2, i, s);
    const float centre = float(rays.centre);
    VI index = hn::Add(x.number(centre), hn::Add(hn::Mul(y.number(centre), hn::Set(kI, row)),
                                                 hn::Mul(z.number(centre), hn::Set(kI, slice))));
    const VI step_x = hn::ConvertTo(kI, x.step);
    const VI step_y = hn::ConvertTo(kI, hn::Mul(y.step, hn::Set(kF, float(row))));
    const VI step_z = hn::ConvertTo(kI, hn::Mul(z.step, hn::Set(kF, float(slice))));
    // A rounding or a NaN must not make it a long walk.
    for (int k = 0; k < rays.most; ++k) {
        const VF next_x = x.next(), next_y = y.next(), next_z = z.next();
        const VF exit = hn::Min(hn::Min(next_x, next_y), hn::Min(next_z, end));
        const VF length = hn::IfThenElseZero(going, hn::Max(hn::Sub(exit, s), hn::Zero(kF)));
        going = hn::And(going, visit(Step{x, y, z, s, exit, length, index}));
        // No ray goes over the last plane of an axis, so nobody leaves the grid.
        going = hn::And(going, hn::Lt(exit, end));
        if (hn::AllFalse(kF, going)) break;
        const MF over_x = hn::And(going, hn::Le(next_x, exit));
        const MF over_y = hn::And(going, hn::Le(next_y, exit));
        const MF over_z = hn::And(going, hn::Le(next_z, exit));
        index = hn::Add(index, hn::IfThenElseZero(hn::RebindMask(kI, over_x), step_x));
        index = hn::Add(index, hn::IfThenElseZero(hn::RebindMask(kI, over_y), step_y));
        index = hn::Add(index, hn::IfThenElseZero(hn::RebindMask(kI, over_z), step_z));
        s = hn::Max(s, exit);
        x.advance(over_x);
        y.advance(over_y);
        z.advance(over_z);
    }
}

// The eight corners of each ray's cell.
struct Corners {
    VF c000, c100, c010, c110, c001, c101, c011, c111;
};

#if HWY_TARGET == HWY_SCALAR || HWY_TARGET == HWY_EMU128
// No blocks of four lanes to load: corners are gathered, and this is never called.
constexpr bool kHasBlocks = false;
[[maybe_unused]] HWY_ATTR HWY_INLINE void transposeQuads(const float*, const std::int32_t*, VF&, VF&, VF&,
                                                         VF&) {}
#else
constexpr bool kHasBlocks = true;

// Block b of the result is the four floats at base + 4 * index[4 b].
template <class T>
[[maybe_unused]] HWY_ATTR HWY_INLINE hn::Vec<T> loadBlocks(T tag, const float* base,
                                                           const std::int32_t* index) {
    if constexpr (hn::MaxLanes(tag) <= 4) {
        return hn::LoadU(tag, base + 4 * std::ptrdiff_t(index[0]));
    } else {
        const hn::Half<T> half;
        return hn::Combine(tag, loadBlocks(half, base, index + hn::MaxLanes(half)),
                           loadBlocks(half, base, index));
    }
}

// Four rays' quads side by side become four corners of all rays: a 4 x 4 transpose in each block.
[[maybe_unused]] HWY_ATTR HWY_INLINE void transposeQuads(const float* base, const std::int32_t* index, VF& q0,
                                                         VF& q1, VF& q2, VF& q3) {
    const hn::RepartitionToWide<F> wide;
    const VF r0 = loadBlocks(kF, base, index), r1 = loadBlocks(kF, base, index + 1);
    const VF r2 = loadBlocks(kF, base, index + 2), r3 = loadBlocks(kF, base, index + 3);
    const auto a = hn::BitCast(wide, hn::InterleaveLower(kF, r0, r1)),
               b = hn::BitCast(wide, hn::InterleaveLower(kF, r2, r3));
    const auto c = hn::BitCast(wide, hn::InterleaveUpper(kF, r0, r1)),
               d = hn::BitCast(wide, hn::InterleaveUpper(kF, r2, r3));
    q0 = hn::BitCast(kF, hn::InterleaveLower(wide, a, b));
    q1 = hn::BitCast(kF, hn::InterleaveUpper(wide, a, b));
    q2 = hn::BitCast(kF, hn::InterleaveLower(wide, c, d));
    q3 = hn::BitCast(kF, hn::InterleaveUpper(wide, c, d));
}
#endif

template <bool kQuads>
HWY_ATTR HWY_INLINE Corners cornersOf(const BrickCells& brick, VI index) {
    Corners c;
    const int row = brick.edge_samples, slice = row * row;
    if constexpr (kQuads && kHasBlocks) {
        alignas(64) std::int32_t at[kRays];
        hn::Store(index, kI, at);
        transposeQuads(brick.quads, at, c.c000, c.c100, c.c010, c.c110);
        transposeQuads(brick.quads + 4 * std::ptrdiff_t(slice), at, c.c001, c.c101, c.c011, c.c111);
    } else {
        const float* s = brick.samples;
        c.c000 = hn::GatherIndex(kF, s, index);
        c.c100 = hn::GatherIndex(kF, s + 1, index);
        c.c010 = hn::GatherIndex(kF, s + row, index);
        c.c110 = hn::GatherIndex(kF, s + row + 1, index);
        c.c001 = hn::GatherIndex(kF, s + slice, index);
        c.c101 = hn::GatherIndex(kF, s + slice + 1, index);
        c.c011 = hn::GatherIndex(kF, s + slice + row, index);
        c.c111 = hn::GatherIndex(kF, s + slice + row + 1, index);
    }
    return c;
}

HWY_ATTR HWY_INLINE VF lerp(VF from, VF way, VF at) { return hn::MulAdd(way, at, from); }

// Mean of the trilinear field on a straight way of `length` around a middle point: the two-point Gauss rule,
// exact for a cubic, written as the value in the middle plus what the mixed derivatives add. `pairs` holds
// the products of the direction's components, over 12.
HWY_ATTR HWY_INLINE VF meanOfField(const Corners& c, VF x, VF y, VF z, VF length, const VF* pairs) {
    const VF d00 = hn::Sub(c.c100, c.c000), d10 = hn::Sub(c.c110, c.c010);
    const VF d01 = hn::Sub(c.c101, c.c001), d11 = hn::Sub(c.c111, c.c011);
    const VF a00 = lerp(c.c000, d00, x), a10 = lerp(c.c010, d10, x);
    const VF a01 = lerp(c.c001, d01, x), a11 = lerp(c.c011, d11, x);
    const VF way0 = hn::Sub(a10, a00), way1 = hn::Sub(a11, a01);
    const VF b0 = lerp(a00, way0, y), b1 = lerp(a01, way1, y);
    const VF value = lerp(b0, hn::Sub(b1, b0), z);
    const VF xy0 = hn::Sub(d10, d00), xz0 = hn::Sub(d01, d00);
    const VF xy = lerp(xy0, hn::Sub(hn::Sub(d11, d01), xy0), z);
    const VF xz = lerp(xz0, hn::Sub(hn::Sub(d11, d10), xz0), y);
    const VF yz = hn::Sub(way1, way0);
    const VF mixed = hn::MulAdd(yz, pairs[2], hn::MulAdd(xz, pairs[1], hn::Mul(xy, pairs[0])));
    return hn::MulAdd(hn::Mul(length, length), mixed, value);
}

// Cells with a negative corner, few in most bricks: the field is cut off at zero there, ray by ray in double.
HWY_ATTR HWY_NOINLINE VF meanOfSigned(const BrickCells& brick, const Step& step, VF mean) {
    alignas(64) float means[kRays], length[kRays], from[3][kRays], to[3][kRays];
    alignas(64) std::int32_t index[kRays];
    hn::Store(mean, kF, means);
    hn::Store(step.length, kF, length);
    hn::Store(step.index, kI, index);
    const Axis* axes[3] = {&step.x, &step.y, &step.z};
    for (int a = 0; a < 3; ++a) {
        hn::Store(axes[a]->inCell(step.begin), kF, from[a]);
        hn::Store(axes[a]->inCell(step.end), kF, to[a]);
    }
    for (std::size_t lane = 0; lane < hn::Lanes(kF); ++lane)
        if (length[lane] > 0)
            means[lane] = float(meanOfCell(brick, index[lane], {from[0][lane], from[1][lane], from[2][lane]},
                                           {to[0][lane], to[1][lane], to[2][lane]}, double(means[lane])));
    return hn::Load(kF, means);
}

HWY_ATTR HWY_INLINE bool anyNegative(const Corners& c) {
    const VF least = hn::Min(hn::Min(hn::Min(c.c000, c.c100), hn::Min(c.c010, c.c110)),
                             hn::Min(hn::Min(c.c001, c.c101), hn::Min(c.c011, c.c111)));
    return !hn::AllFalse(kF, hn::Lt(least, hn::Zero(kF)));
}

// take(step, integral over it) for each cell of the brick that rays [i, i + lanes) meet.
template <bool kQuads, class Take>
HWY_ATTR HWY_INLINE void walkBrick(const LocalRays& rays, std::size_t i, const BrickCells& brick,
                                   const Take& take) {
    const VF dx = hn::Load(kF, rays.direction[0] + i), dy = hn::Load(kF, rays.direction[1] + i),
             dz = hn::Load(kF, rays.direction[2] + i);
    const VF twelfth = hn::Set(kF, 1.0f / 12);
    const VF pairs[3] = {hn::Mul(hn::Mul(dx, dy), twelfth), hn::Mul(hn::Mul(dx, dz), twelfth),
                         hn::Mul(hn::Mul(dy, dz), twelfth)};
    const VF half = hn::Set(kF, 0.5f);
    walk(rays, i, brick.edge_samples, brick.edge_samples * brick.edge_samples,
         [&](const Step& step) HWY_ATTR {
             const VF middle = hn::MulAdd(step.length, half, step.begin);
             const Corners corners = cornersOf<kQuads>(brick, step.index);
             VF mean = meanOfField(corners, step.x.inCell(middle), step.y.inCell(middle),
                                   step.z.inCell(middle), step.length, pairs);
             if (brick.negative && anyNegative(corners)) mean = meanOfSigned(brick, step, mean);
             return take(step, hn::Mul(step.length, mean));
         });
}

template <class Body>
HWY_ATTR HWY_INLINE void forBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                                  Body body) {
    LocalRays rays;
    const double centre = 0.5 * (brick.edge_samples - 1);
    if (!localRays(packet, brick.low, brick.cell_edge, centre, brick.box_begin, brick.box_end, spans, rays))
        return;
    for (std::size_t i = 0; i < kRays; i += hn::Lanes(kF)) body(rays, i);
}

template <bool kQuads>
HWY_ATTR void integrate(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                        double* sums) {
    forBrick(packet, brick, spans, [&](const LocalRays& rays, std::size_t i) HWY_ATTR {
        // Kahan's sum: the rounding of some fifty additions would be the largest error of all.
        VF sum = hn::Zero(kF), lost = hn::Zero(kF);
        walkBrick<kQuads>(rays, i, brick, [&](const Step&, VF amount) HWY_ATTR {
            const VF add = hn::Sub(amount, lost);
            const VF total = hn::Add(sum, add);
            lost = hn::Sub(hn::Sub(total, sum), add);
            sum = total;
            return hn::Eq(sum, sum);
        });
        // What is lost belongs to the sum: which of the two holds it depends on how long the neighbours walk.
        alignas(64) float partial[kRays], rest[kRays];
        hn::Store(sum, kF, partial);
        hn::Store(lost, kF, rest);
        for (std::size_t k = 0; k < hn::Lanes(kF); ++k)
            sums[i + k] += (double(partial[k]) - double(rest[k])) * rays.unit[i + k];
    });
}
HWY_ATTR void IntegrateBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                             double* sums) {
    if (brick.quads)
        integrate<true>(packet, brick, spans, sums);
    else
        integrate<false>(packet, brick, spans, sums);
}

// Points of each ray's span where the light is looked up, and the optical depth to it from there: a table
// with a row for each point.
struct alignas(64) LightTable {
    float value[kMostLightCells + 1][kRays];
};
HWY_ATTR HWY_INLINE void lookUpLight(const LocalRays& rays, std::size_t i, const LightCells& light, int cells,
                                     LightTable& table) {
    const VF begin = hn::Load(kF, rays.begin + i), end = hn::Load(kF, rays.end + i);
    const VF step = hn::Mul(hn::Sub(end, begin), hn::Set(kF, 1.0f / float(cells)));
    const std::ptrdiff_t slice = std::ptrdiff_t(light.points[0]) * light.points[1];
    for (int k = 0; k <= cells; ++k) {
        const VF s = hn::MulAdd(hn::Set(kF, float(k)), step, begin);
        VF inside[3];
        VI index = hn::Zero(kI);
        for (int a = 2; a >= 0; --a) {
            const VF from_box = hn::Sub(
                hn::MulAdd(s, hn::Load(kF, rays.direction[a] + i), hn::Load(kF, rays.position[a] + i)),
                hn::Set(kF, float(rays.first[a] - rays.centre)));
            const VF most = hn::Set(kF, float(light.points[a] - 2));
            const VF at = hn::Max(hn::Mul(from_box, hn::Set(kF, light.per_cell[a])), hn::Zero(kF));
            const VF cell = hn::Min(hn::Floor(at), most);
            inside[a] = hn::Min(hn::Sub(at, cell), hn::Set(kF, 1.0f));
            index = hn::Add(hn::ConvertTo(kI, cell), hn::Mul(index, hn::Set(kI, light.points[a])));
        }
        Corners c;
        if constexpr (kHasBlocks) {
            alignas(64) std::int32_t places[kRays];
            hn::Store(index, kI, places);
            transposeQuads(light.quads, places, c.c000, c.c100, c.c010, c.c110);
            transposeQuads(light.quads + 4 * slice, places, c.c001, c.c101, c.c011, c.c111);
        } else {
            const VI four = hn::Mul(index, hn::Set(kI, 4));
            c.c000 = hn::GatherIndex(kF, light.quads, four);
            c.c100 = hn::GatherIndex(kF, light.quads + 1, four);
            c.c010 = hn::GatherIndex(kF, light.quads + 2, four);
            c.c110 = hn::GatherIndex(kF, light.quads + 3, four);
            c.c001 = hn::GatherIndex(kF, light.quads + 4 * slice, four);
            c.c101 = hn::GatherIndex(kF, light.quads + 4 * slice + 1, four);
            c.c011 = hn::GatherIndex(kF, light.quads + 4 * slice + 2, four);
            c.c111 = hn::GatherIndex(kF, light.quads + 4 * slice + 3, four);
        }
        const VF x00 = lerp(c.c000, hn::Sub(c.c100, c.c000), inside[0]),
                 x10 = lerp(c.c010, hn::Sub(c.c110, c.c010), inside[0]);
        const VF x01 = lerp(c.c001, hn::Sub(c.c101, c.c001), inside[0]),
                 x11 = lerp(c.c011, hn::Sub(c.c111, c.c011), inside[0]);
        const VF y0 = lerp(x00, hn::Sub(x10, x00), inside[1]), y1 = lerp(x01, hn::Sub(x11, x01), inside[1]);
        hn::Store(lerp(y0, hn::Sub(y1, y0), inside[2]), kF, table.value[k] + i);
    }
}

template <bool kQuads>
HWY_ATTR void scatter(const RayPacket& packet, const BrickCells& brick, const LightCells& light,
                      const PacketSpans& spans, double scale, PacketScatter& out) {
    for (std::size_t k = 0; k < kRays; ++k) {
        out.depth[k] = out.weight[k] = 0;
        out.passed[k] = out.last[k] = 1;
    }
    int cells = 1;
    for (int points : light.points) cells = points - 1 > cells ? points - 1 : cells;
    forBrick(packet, brick, spans, [&](const LocalRays& rays, std::size_t i) HWY_ATTR {
        LightTable table;
        lookUpLight(rays, i, light, cells, table);
        alignas(64) float factors[kRays], partial[kRays];
        for (std::size_t k = 0; k < hn::Lanes(kF); ++k) factors[k] = float(-scale * rays.unit[i + k]);
        const VF factor = hn::Load(kF, factors), begin = hn::Load(kF, rays.begin + i);
        const VF span = hn::Max(hn::Sub(hn::Load(kF, rays.end + i), begin), hn::Set(kF, 1e-20f));
        const VF per_s = hn::Div(hn::Set(kF, float(cells)), span);
        const VF half = hn::Set(kF, 0.5f), most = hn::Set(kF, float(cells - 1));
        const VI lane = hn::Iota(kI, std::int32_t(i));
        VF sum = hn::Zero(kF), lost = hn::Zero(kF), weight = hn::Zero(kF), transmittance = hn::Set(kF, 1.0f);
        walkBrick<kQuads>(rays, i, brick, [&](const Step& step, VF amount) HWY_ATTR {
            const VF add = hn::Sub(amount, lost);
            const VF total = hn::Add(sum, add);
            lost = hn::Sub(hn::Sub(total, sum), add);
            sum = total;
            const VF at = hn::Mul(hn::Sub(hn::MulAdd(step.length, half, step.begin), begin), per_s);
            const VF row = hn::Max(hn::Min(hn::Floor(at), most), hn::Zero(kF));
            const VI place = hn::Add(hn::ShiftLeft<4>(hn::ConvertTo(kI, row)), lane);
            const VF from = hn::GatherIndex(kF, table.value[0], place),
                     to = hn::GatherIndex(kF, table.value[1], place);
            const VF lit = hn::Exp(kF, hn::Neg(lerp(from, hn::Sub(to, from), hn::Sub(at, row))));
            // In a haze a cell absorbs less than the last bit of 1.
            const VF absorbed = hn::Mul(transmittance, hn::Neg(hn::Expm1(kF, hn::Mul(amount, factor))));
            weight = hn::MulAdd(absorbed, lit, weight);
            transmittance = hn::Sub(transmittance, absorbed);
            return hn::Eq(sum, sum);
        });
        alignas(64) float weighted[kRays], rest[kRays];
        hn::Store(sum, kF, partial);
        hn::Store(lost, kF, rest);
        hn::Store(weight, kF, weighted);
        for (std::size_t k = 0; k < hn::Lanes(kF); ++k) {
            if (!(rays.begin[i + k] < rays.end[i + k])) continue;
            out.depth[i + k] = (double(partial[k]) - double(rest[k])) * rays.unit[i + k];
            out.weight[i + k] = double(weighted[k]);
            out.passed[i + k] = std::exp(-scale * out.depth[i + k]);
            out.last[i + k] = std::exp(-double(table.value[cells][i + k]));
        }
    });
}
HWY_ATTR void ScatterInBrick(const RayPacket& packet, const BrickCells& brick, const LightCells& light,
                             const PacketSpans& spans, double scale, PacketScatter& out) {
    if (brick.quads)
        scatter<true>(packet, brick, light, spans, scale, out);
    else
        scatter<false>(packet, brick, light, spans, scale, out);
}

HWY_ATTR void FindInBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                          const double* targets, double* sums, double* found) {
    forBrick(packet, brick, spans, [&](const LocalRays& rays, std::size_t i) HWY_ATTR {
        alignas(64) float wanted[kRays], place[kRays], total[kRays];
        for (std::size_t k = 0; k < hn::Lanes(kF); ++k)
            wanted[k] = float((targets[i + k] - sums[i + k]) / rays.unit[i + k]);
        const VF target = hn::Load(kF, wanted), never = hn::Set(kF, 1e30f);
        VF sum = hn::Zero(kF), at = never;
        walkBrick<false>(rays, i, brick, [&](const Step& step, VF amount) HWY_ATTR {
            const VF after = hn::Add(sum, amount);
            const MF crossed =
                hn::And(hn::And(hn::Lt(hn::Zero(kF), amount), hn::Eq(at, never)), hn::Ge(after, target));
            const VF part = hn::Max(hn::Div(hn::Sub(target, sum), amount), hn::Zero(kF));
            at = hn::IfThenElse(crossed, hn::MulAdd(step.length, part, step.begin), at);
            sum = after;
            return hn::Lt(after, target);
        });
        hn::Store(at, kF, place);
        hn::Store(sum, kF, total);
        for (std::size_t k = 0; k < hn::Lanes(kF); ++k) {
            if (place[k] < 1e30f) found[i + k] = rays.middle[i + k] + double(place[k]) * rays.unit[i + k];
            sums[i + k] += double(total[k]) * rays.unit[i + k];
        }
    });
}

HWY_ATTR void IntegrateGrid(const RayPacket& packet, const double* low, double edge, const PacketSpans& spans,
                            const float* first, const float* second, double* first_sums,
                            double* second_sums) {
    constexpr int kEdge = 4;
    constexpr int kBegin[3] = {0, 0, 0}, kEnd[3] = {kEdge, kEdge, kEdge};
    LocalRays rays;
    if (!localRays(packet, low, edge / kEdge, kEdge / 2, kBegin, kEnd, spans, rays)) return;
    for (std::size_t i = 0; i < kRays; i += hn::Lanes(kF)) {
        VF sum_first = hn::Zero(kF), sum_second = hn::Zero(kF);
        walk(rays, i, kEdge, kEdge * kEdge, [&](const Step& step) HWY_ATTR {
            sum_first = hn::MulAdd(step.length, hn::GatherIndex(kF, first, step.index), sum_first);
            sum_second = hn::MulAdd(step.length, hn::GatherIndex(kF, second, step.index), sum_second);
            return hn::Eq(step.length, step.length);
        });
        alignas(64) float one[kRays], two[kRays];
        hn::Store(sum_first, kF, one);
        hn::Store(sum_second, kF, two);
        for (std::size_t k = 0; k < hn::Lanes(kF); ++k) {
            first_sums[i + k] += double(one[k]) * rays.unit[i + k];
            second_sums[i + k] += double(two[k]) * rays.unit[i + k];
        }
    }
}

const char* TargetName() { return hwy::TargetName(HWY_TARGET); }

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace brickyard
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace brickyard {

HWY_EXPORT(ClipPackets);
HWY_EXPORT(ClipPacket);
HWY_EXPORT(IntegrateBrick);
HWY_EXPORT(FindInBrick);
HWY_EXPORT(ScatterInBrick);
HWY_EXPORT(IntegrateGrid);
HWY_EXPORT(TargetName);

std::size_t clipPackets(const RayPacket* packets, const std::uint16_t* in, std::size_t count,
                        const double low[3], const double high[3], std::uint16_t* out) {
    return HWY_DYNAMIC_DISPATCH(ClipPackets)(packets, in, count, low, high, out);
}
void clipPacket(const RayPacket& packet, const double low[3], const double high[3], PacketSpans& spans) {
    HWY_DYNAMIC_DISPATCH(ClipPacket)(packet, low, high, spans);
}
void integrateBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                    double* sums) {
    HWY_DYNAMIC_DISPATCH(IntegrateBrick)(packet, brick, spans, sums);
}
void scatterInBrick(const RayPacket& packet, const BrickCells& brick, const LightCells& light,
                    const PacketSpans& spans, double scale, PacketScatter& out) {
    HWY_DYNAMIC_DISPATCH(ScatterInBrick)(packet, brick, light, spans, scale, out);
}
void findInBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                 const double* targets, double* sums, double* found) {
    HWY_DYNAMIC_DISPATCH(FindInBrick)(packet, brick, spans, targets, sums, found);
}
void integrateGrid(const RayPacket& packet, const double low[3], double edge, const PacketSpans& spans,
                   const float first[64], const float second[64], double* first_sums, double* second_sums) {
    HWY_DYNAMIC_DISPATCH(IntegrateGrid)(packet, low, edge, spans, first, second, first_sums, second_sums);
}
const char* kernelTarget() { return HWY_DYNAMIC_DISPATCH(TargetName)(); }

const float* CornerQuads::of(const BrickCells& brick) {
    const std::size_t row = std::size_t(brick.edge_samples), slice = row * row;
    quads_.resize(4 * row * slice);
    for (int z = brick.box_begin[2]; z <= brick.box_end[2]; ++z)
        for (int y = brick.box_begin[1]; y < brick.box_end[1]; ++y) {
            const float* from = brick.samples + std::size_t(z) * slice + std::size_t(y) * row;
            float* to = quads_.data() + 4 * (std::size_t(z) * slice + std::size_t(y) * row);
            for (int x = brick.box_begin[0]; x < brick.box_end[0]; ++x) {
                const std::size_t at = std::size_t(x);
                to[4 * at] = from[at];
                to[4 * at + 1] = from[at + 1];
                to[4 * at + 2] = from[at + row];
                to[4 * at + 3] = from[at + row + 1];
            }
        }
    return quads_.data();
}

}  // namespace brickyard
#endif  // HWY_ONCE

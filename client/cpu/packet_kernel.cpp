// Built once per instruction set by Highway's foreach_target; the functions at the end choose at run time.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "client/cpu/packet_kernel.cpp"
#include "client/cpu/packet_kernel.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
#include "client/cpu/cell_walk.h"

#ifndef BRICKYARD_PACKET_KERNEL_SCALAR  // once, not once per target
#define BRICKYARD_PACKET_KERNEL_SCALAR
namespace brickyard {
namespace {

// Twice the mean of max(0, field) from `from` to `to` in the cell that begins at sample `at`; `otherwise`
// where no corner is negative.
double twiceMeanPositive(const BrickCells& brick, std::int64_t at, const glm::dvec3& from,
                         const glm::dvec3& to, double otherwise) {
    const float* c = brick.samples + at;
    const int sy = brick.edge_samples, sz = sy * sy;
    const Cell cell{{c[0], c[1], c[sy], c[sy + 1], c[sz], c[sz + 1], c[sz + sy], c[sz + sy + 1]}};
    for (double corner : cell.corner)
        if (corner < 0) return 2 * meanPositive(cell, glm::clamp(from, 0.0, 1.0), glm::clamp(to, 0.0, 1.0));
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

constexpr int kRays = RayPacket::kRays;
using D = hn::CappedTag<double, kRays>;
using V = hn::Vec<D>;
using F = hn::Rebind<float, D>;
using VF = hn::Vec<F>;
using I = hn::RebindToSigned<D>;
using VI = hn::Vec<I>;
constexpr D kD;
constexpr F kF;
constexpr I kI;

HWY_ATTR HWY_INLINE VF lowHalves(hn::Vec<hn::Rebind<std::uint64_t, D>> pair) {
    return hn::BitCast(kF, hn::TruncateTo(hn::Rebind<std::uint32_t, D>(), pair));
}
HWY_ATTR HWY_INLINE VF highHalves(hn::Vec<hn::Rebind<std::uint64_t, D>> pair) {
    return lowHalves(hn::ShiftRight<32>(pair));
}
HWY_ATTR HWY_INLINE VF unit(VF v) { return hn::Min(hn::Max(v, hn::Zero(kF)), hn::Set(kF, 1.0f)); }
HWY_ATTR HWY_INLINE VF lerp(VF from, VF way, VF at) { return hn::MulAdd(way, at, from); }

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
        for (std::size_t i = 0; i < kRays; i += hn::Lanes(kD)) {
            V begin, end;
            clip(p, i, low, high, begin, end);
            any |= !hn::AllFalse(kD, hn::Lt(begin, end));
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

// One axis of a walk through a regular grid: where the next plane is, and the cell's place. In units of the
// grid's cells; `base` and `inverse` turn a plane's number into t.
struct Axis {
    V direction, inverse, base;
    V to_cell;  // origin less the cell's number: position in the cell is direction * t + to_cell
    V step;     // +1 or -1
    V plane;    // number of the plane that ends the cell
    V t_next;   // where it is
    V cell;     // of the begin only

    // Narrows [begin, end] to the planes `first` and `last` of the grid.
    HWY_ATTR HWY_INLINE void place(const RayPacket& p, std::size_t i, int a, double low, double edge,
                                   double first, double last, V& begin, V& end) {
        const V origin =
            hn::Mul(hn::Sub(hn::Load(kD, p.origin[a] + i), hn::Set(kD, low)), hn::Set(kD, 1 / edge));
        direction = hn::Mul(hn::Load(kD, p.direction[a] + i), hn::Set(kD, 1 / edge));
        inverse = hn::Mul(hn::Load(kD, p.inverse[a] + i), hn::Set(kD, edge));
        base = hn::Neg(hn::Mul(origin, inverse));
        to_cell = origin;
        const V t0 = hn::MulAdd(hn::Set(kD, first), inverse, base),
                t1 = hn::MulAdd(hn::Set(kD, last), inverse, base);
        begin = hn::Max(begin, hn::Min(t0, t1));
        end = hn::Min(end, hn::Max(t0, t1));
    }
    HWY_ATTR HWY_INLINE void start(V begin, double first, double last) {
        const V position = hn::Floor(hn::MulAdd(begin, direction, to_cell));
        const V lowest = hn::Set(kD, first), highest = hn::Set(kD, last - 1);
        // A NaN is in no range and becomes the first cell: an index is never taken from it.
        cell = hn::IfThenElse(hn::And(hn::Ge(position, lowest), hn::Le(position, highest)), position,
                              hn::IfThenElse(hn::Gt(position, highest), highest, lowest));
        const auto forward = hn::Gt(direction, hn::Zero(kD));
        step = hn::IfThenElse(forward, hn::Set(kD, 1.0), hn::Set(kD, -1.0));
        plane = hn::Add(cell, hn::IfThenElseZero(forward, hn::Set(kD, 1.0)));
        to_cell = hn::Sub(to_cell, cell);
        t_next = hn::MulAdd(plane, inverse, base);
    }
    HWY_ATTR HWY_INLINE void advance(hn::Mask<D> where) {
        const V by = hn::IfThenElseZero(where, step);
        plane = hn::Add(plane, by);
        to_cell = hn::Sub(to_cell, by);
        t_next = hn::MulAdd(plane, inverse, base);
    }
};

// Cells with a negative corner, few in most bricks: the field is cut off at zero there, ray by ray in double.
HWY_ATTR HWY_NOINLINE V meanOfSigned(const BrickCells& brick, VI offset, V t, V t_exit, const Axis& x,
                                     const Axis& y, const Axis& z, V twice_mean) {
    constexpr std::size_t kMost = hn::MaxLanes(D());
    alignas(64) double mean[kMost], from[3][kMost], to[3][kMost];
    alignas(64) std::int64_t offsets[kMost];
    hn::Store(twice_mean, kD, mean);
    hn::Store(offset, kI, offsets);
    const Axis* axes[3] = {&x, &y, &z};
    for (int a = 0; a < 3; ++a) {
        hn::Store(hn::MulAdd(t, axes[a]->direction, axes[a]->to_cell), kD, from[a]);
        hn::Store(hn::MulAdd(t_exit, axes[a]->direction, axes[a]->to_cell), kD, to[a]);
    }
    for (std::size_t lane = 0; lane < hn::Lanes(kD); ++lane)
        mean[lane] =
            twiceMeanPositive(brick, offsets[lane] / 4, {from[0][lane], from[1][lane], from[2][lane]},
                              {to[0][lane], to[1][lane], to[2][lane]}, mean[lane]);
    return hn::Load(kD, mean);
}

// Walks the cells of a brick. take(t, t_exit, length, sum of the field at the two Gauss points) is told of
// each step and returns the lanes that may go on.
template <class Take>
HWY_ATTR HWY_INLINE void walk(const RayPacket& p, std::size_t i, const BrickCells& brick,
                              const PacketSpans& spans, V& begin_out, const Take& take) {
    V t = hn::Load(kD, spans.begin + i), end = hn::Load(kD, spans.end + i);
    Axis x, y, z;
    x.place(p, i, 0, brick.low[0], brick.cell_edge, brick.box_begin[0], brick.box_end[0], t, end);
    y.place(p, i, 1, brick.low[1], brick.cell_edge, brick.box_begin[1], brick.box_end[1], t, end);
    z.place(p, i, 2, brick.low[2], brick.cell_edge, brick.box_begin[2], brick.box_end[2], t, end);
    begin_out = t;
    if (hn::AllFalse(kD, hn::Lt(t, end))) return;
    x.start(t, brick.box_begin[0], brick.box_end[0]);
    y.start(t, brick.box_begin[1], brick.box_end[1]);
    z.start(t, brick.box_begin[2], brick.box_end[2]);

    const int s = brick.edge_samples;
    const V row = hn::Set(kD, 4.0 * s), slice = hn::Set(kD, 4.0 * s * s), four = hn::Set(kD, 4.0);
    VI offset = hn::ConvertTo(kI, hn::MulAdd(z.cell, slice, hn::MulAdd(y.cell, row, hn::Mul(x.cell, four))));
    const VI step_x = hn::ConvertTo(kI, hn::Mul(x.step, four));
    const VI step_y = hn::ConvertTo(kI, hn::Mul(y.step, row));
    const VI step_z = hn::ConvertTo(kI, hn::Mul(z.step, slice));
    // Pairs of floats, x and x + 1, as one 64-bit lane: four gathers a cell.
    using Pair = hn::Rebind<std::uint64_t, D>;
    const auto* samples = reinterpret_cast<const std::uint64_t*>(brick.samples);
    const auto* samples_y = reinterpret_cast<const std::uint64_t*>(brick.samples + s);
    const auto* samples_z = reinterpret_cast<const std::uint64_t*>(brick.samples + s * s);
    const auto* samples_yz = reinterpret_cast<const std::uint64_t*>(brick.samples + s * s + s);

    constexpr double kGauss = 0.28867513459481288225;  // 1 / (2 sqrt 3)
    const V half = hn::Set(kD, 0.5), gauss = hn::Set(kD, kGauss);
    const V gauss_x = hn::Mul(x.direction, gauss), gauss_y = hn::Mul(y.direction, gauss),
            gauss_z = hn::Mul(z.direction, gauss);
    // No ray has more cells than this; a rounding or a NaN must not make it a long walk.
    const int most = (brick.box_end[0] - brick.box_begin[0]) + (brick.box_end[1] - brick.box_begin[1]) +
                     (brick.box_end[2] - brick.box_begin[2]) + 1;
    auto going = hn::Lt(t, end);
    for (int k = 0; k < most; ++k) {
        const V t_exit = hn::Min(hn::Min(x.t_next, y.t_next), hn::Min(z.t_next, end));
        const V length = hn::IfThenElseZero(hn::And(going, hn::Lt(t, t_exit)), hn::Sub(t_exit, t));
        const V middle = hn::Mul(hn::Add(t, t_exit), half);
        const VF mx = hn::DemoteTo(kF, hn::MulAdd(middle, x.direction, x.to_cell));
        const VF my = hn::DemoteTo(kF, hn::MulAdd(middle, y.direction, y.to_cell));
        const VF mz = hn::DemoteTo(kF, hn::MulAdd(middle, z.direction, z.to_cell));
        const VF gx = hn::DemoteTo(kF, hn::Mul(length, gauss_x));
        const VF gy = hn::DemoteTo(kF, hn::Mul(length, gauss_y));
        const VF gz = hn::DemoteTo(kF, hn::Mul(length, gauss_z));
        const VF ax = unit(hn::Sub(mx, gx)), ay = unit(hn::Sub(my, gy)), az = unit(hn::Sub(mz, gz));
        const VF bx = unit(hn::Add(mx, gx)), by = unit(hn::Add(my, gy)), bz = unit(hn::Add(mz, gz));

        const auto p00 = hn::GatherOffset(Pair(), samples, offset);
        const auto p10 = hn::GatherOffset(Pair(), samples_y, offset);
        const auto p01 = hn::GatherOffset(Pair(), samples_z, offset);
        const auto p11 = hn::GatherOffset(Pair(), samples_yz, offset);
        const VF c00 = lowHalves(p00), e00 = highHalves(p00), d00 = hn::Sub(e00, c00);
        const VF c10 = lowHalves(p10), e10 = highHalves(p10), d10 = hn::Sub(e10, c10);
        const VF c01 = lowHalves(p01), e01 = highHalves(p01), d01 = hn::Sub(e01, c01);
        const VF c11 = lowHalves(p11), e11 = highHalves(p11), d11 = hn::Sub(e11, c11);
        const VF a00 = lerp(c00, d00, ax), a01 = lerp(c01, d01, ax);
        const VF a0 = lerp(a00, hn::Sub(lerp(c10, d10, ax), a00), ay);
        const VF a1 = lerp(a01, hn::Sub(lerp(c11, d11, ax), a01), ay);
        const VF b00 = lerp(c00, d00, bx), b01 = lerp(c01, d01, bx);
        const VF b0 = lerp(b00, hn::Sub(lerp(c10, d10, bx), b00), by);
        const VF b1 = lerp(b01, hn::Sub(lerp(c11, d11, bx), b01), by);
        const VF both = hn::Add(lerp(a0, hn::Sub(a1, a0), az), lerp(b0, hn::Sub(b1, b0), bz));
        V twice_mean = hn::PromoteTo(kD, both);
        const VF least = hn::Min(hn::Min(hn::Min(c00, e00), hn::Min(c10, e10)),
                                 hn::Min(hn::Min(c01, e01), hn::Min(c11, e11)));
        if (!hn::AllFalse(kF, hn::Lt(least, hn::Zero(kF))))
            twice_mean = meanOfSigned(brick, offset, t, t_exit, x, y, z, twice_mean);
        going = hn::And(going, take(t, t_exit, length, twice_mean));

        going = hn::And(going, hn::Lt(t_exit, end));
        if (hn::AllFalse(kD, going)) break;
        const auto over_x = hn::And(going, hn::Le(x.t_next, t_exit));
        const auto over_y = hn::And(going, hn::Le(y.t_next, t_exit));
        const auto over_z = hn::And(going, hn::Le(z.t_next, t_exit));
        offset = hn::Add(offset, hn::IfThenElseZero(hn::RebindMask(kI, over_x), step_x));
        offset = hn::Add(offset, hn::IfThenElseZero(hn::RebindMask(kI, over_y), step_y));
        offset = hn::Add(offset, hn::IfThenElseZero(hn::RebindMask(kI, over_z), step_z));
        t = hn::Max(t, t_exit);
        x.advance(over_x);
        y.advance(over_y);
        z.advance(over_z);
    }
}

HWY_ATTR void IntegrateBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                             double* sums) {
    const V half = hn::Set(kD, 0.5);
    for (std::size_t i = 0; i < kRays; i += hn::Lanes(kD)) {
        V sum = hn::Zero(kD), begin;
        walk(packet, i, brick, spans, begin, [&](V, V, V length, V both) HWY_ATTR {
            sum = hn::MulAdd(length, both, sum);
            return hn::Eq(length, length);
        });
        hn::StoreU(hn::MulAdd(sum, half, hn::LoadU(kD, sums + i)), kD, sums + i);
    }
}

HWY_ATTR void FindInBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                          const double* targets, double* sums, double* found) {
    const V half = hn::Set(kD, 0.5);
    for (std::size_t i = 0; i < kRays; i += hn::Lanes(kD)) {
        V sum = hn::LoadU(kD, sums + i), at = hn::LoadU(kD, found + i), begin;
        const V target = hn::LoadU(kD, targets + i);
        walk(packet, i, brick, spans, begin, [&](V t, V, V length, V both) HWY_ATTR {
            const V amount = hn::Mul(hn::Mul(length, half), both);
            const V after = hn::Add(sum, amount);
            const auto crossed =
                hn::And(hn::Lt(hn::Zero(kD), amount), hn::And(hn::Lt(sum, target), hn::Ge(after, target)));
            const V part = hn::Div(hn::Sub(target, sum), amount);
            at = hn::IfThenElse(crossed, hn::MulAdd(length, part, t), at);
            sum = after;
            return hn::Lt(after, target);
        });
        hn::StoreU(sum, kD, sums + i);
        hn::StoreU(at, kD, found + i);
    }
}

HWY_ATTR void StepThroughBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                               PacketSteps& steps) {
    const V half = hn::Set(kD, 0.5);
    int counts[kRays] = {};
    steps.count = 0;
    for (std::size_t i = 0; i < kRays; i += hn::Lanes(kD)) {
        int count = 0;
        V begin;
        walk(packet, i, brick, spans, begin, [&](V t, V t_exit, V length, V both) HWY_ATTR {
            hn::Store(hn::Max(t, t_exit), kD, steps.end[count] + i);
            hn::Store(hn::Mul(hn::Mul(length, half), both), kD, steps.amount[count] + i);
            ++count;
            return hn::Eq(length, length);
        });
        hn::Store(begin, kD, steps.begin + i);
        counts[i] = count;
        if (count > steps.count) steps.count = count;
    }
    // Groups of lanes that ended earlier than others.
    for (std::size_t i = 0; i < kRays; i += hn::Lanes(kD))
        for (int k = counts[i]; k < steps.count; ++k) {
            hn::Store(hn::Zero(kD), kD, steps.amount[k] + i);
            hn::Store(k > 0 ? hn::Load(kD, steps.end[k - 1] + i) : hn::Load(kD, steps.begin + i), kD,
                      steps.end[k] + i);
        }
}

HWY_ATTR void IntegrateGrid(const RayPacket& packet, const double* low, double edge, const PacketSpans& spans,
                            const double* first, const double* second, double* first_sums,
                            double* second_sums) {
    constexpr double kEdge = 4;
    for (std::size_t i = 0; i < kRays; i += hn::Lanes(kD)) {
        V t = hn::Load(kD, spans.begin + i);
        const V end = hn::Load(kD, spans.end + i);
        auto going = hn::Lt(t, end);
        if (hn::AllFalse(kD, going)) continue;
        // The outer faces end nothing: the span does.
        const V never = hn::Set(kD, 1e308);
        auto openOutside = [&](Axis& axis) HWY_ATTR {
            const auto outer =
                hn::Or(hn::Eq(axis.plane, hn::Zero(kD)), hn::Eq(axis.plane, hn::Set(kD, kEdge)));
            axis.t_next = hn::IfThenElse(outer, never, axis.t_next);
        };
        Axis axes[3];
        for (int a = 0; a < 3; ++a) {
            V ignored_begin = t, ignored_end = end;
            axes[a].place(packet, i, a, low[a], edge / kEdge, 0, kEdge, ignored_begin, ignored_end);
            axes[a].start(t, 0, kEdge);
            openOutside(axes[a]);
        }
        const V strides[3] = {axes[0].step, hn::Mul(axes[1].step, hn::Set(kD, kEdge)),
                              hn::Mul(axes[2].step, hn::Set(kD, kEdge * kEdge))};
        V at = hn::MulAdd(axes[2].cell, hn::Set(kD, kEdge * kEdge),
                          hn::MulAdd(axes[1].cell, hn::Set(kD, kEdge), axes[0].cell));
        V sum_first = hn::LoadU(kD, first_sums + i), sum_second = hn::LoadU(kD, second_sums + i);
        for (int k = 0; k < 10; ++k) {  // nine planes inside
            const V t_exit = hn::Min(hn::Min(axes[0].t_next, axes[1].t_next), hn::Min(axes[2].t_next, end));
            const V length = hn::IfThenElseZero(hn::And(going, hn::Lt(t, t_exit)), hn::Sub(t_exit, t));
            const VI place = hn::ConvertTo(kI, at);
            sum_first = hn::MulAdd(length, hn::GatherIndex(kD, first, place), sum_first);
            sum_second = hn::MulAdd(length, hn::GatherIndex(kD, second, place), sum_second);
            going = hn::And(going, hn::Lt(t_exit, end));
            if (hn::AllFalse(kD, going)) break;
            t = hn::Max(t, t_exit);
            for (int a = 0; a < 3; ++a) {
                const auto over = hn::And(going, hn::Le(axes[a].t_next, t_exit));
                at = hn::Add(at, hn::IfThenElseZero(over, strides[a]));
                axes[a].advance(over);
                openOutside(axes[a]);
            }
        }
        hn::StoreU(sum_first, kD, first_sums + i);
        hn::StoreU(sum_second, kD, second_sums + i);
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
HWY_EXPORT(StepThroughBrick);
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
void findInBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                 const double* targets, double* sums, double* found) {
    HWY_DYNAMIC_DISPATCH(FindInBrick)(packet, brick, spans, targets, sums, found);
}
void stepThroughBrick(const RayPacket& packet, const BrickCells& brick, const PacketSpans& spans,
                      PacketSteps& steps) {
    HWY_DYNAMIC_DISPATCH(StepThroughBrick)(packet, brick, spans, steps);
}
void integrateGrid(const RayPacket& packet, const double low[3], double edge, const PacketSpans& spans,
                   const double first[64], const double second[64], double* first_sums, double* second_sums) {
    HWY_DYNAMIC_DISPATCH(IntegrateGrid)(packet, low, edge, spans, first, second, first_sums, second_sums);
}
const char* kernelTarget() { return HWY_DYNAMIC_DISPATCH(TargetName)(); }

}  // namespace brickyard
#endif  // HWY_ONCE

#include "reference_field.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>

namespace brickyard {

namespace {

// GCC's and Clang's 113-bit type; only +, -, * and / are used, which need no library.
__extension__ using Quad = __float128;

// Halvings of a cubic whose sign changes. What is left then is 2^-60 of the step.
constexpr int kMostHalvings = 60;
constexpr std::int64_t kRootEdge = std::int64_t(1) << 33;

Bernstein firstPart(const Bernstein& b, long double s) {
    const long double r = 1 - s;
    const long double b01 = r * b[0] + s * b[1], b12 = r * b[1] + s * b[2], b23 = r * b[2] + s * b[3];
    const long double b012 = r * b01 + s * b12, b123 = r * b12 + s * b23;
    return {b[0], b01, b012, r * b012 + s * b123};
}

Bernstein reversed(const Bernstein& b) { return {b[3], b[2], b[1], b[0]}; }

long double positiveMean(const Bernstein& b, int halvings) {
    const auto [low, high] = std::minmax_element(b.begin(), b.end());
    if (*high <= 0) return 0;
    if (*low >= 0 || halvings == 0) return std::max(0.0L, (b[0] + b[1] + b[2] + b[3]) / 4);
    return 0.5L *
           (positiveMean(part(b, 0, 0.5L), halvings - 1) + positiveMean(part(b, 0.5L, 1), halvings - 1));
}

// Rows of the inverse of the linear part, by cofactors.
std::array<std::array<Quad, 3>, 3> inverseOf(const glm::dmat4& m) {
    auto at = [&](int row, int column) { return Quad(m[column % 3][row % 3]); };
    Quad cofactor[3][3], determinant = 0;
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c)
            cofactor[r][c] = at(r + 1, c + 1) * at(r + 2, c + 2) - at(r + 1, c + 2) * at(r + 2, c + 1);
    for (int c = 0; c < 3; ++c) determinant += at(0, c) * cofactor[0][c];
    std::array<std::array<Quad, 3>, 3> inverse{};
    for (std::size_t r = 0; r < 3; ++r)
        for (std::size_t c = 0; c < 3; ++c) inverse[r][c] = cofactor[c][r] / determinant;
    return inverse;
}

}  // namespace

long double positiveMean(const Bernstein& cubic) { return positiveMean(cubic, kMostHalvings); }

long double valueAt(const Bernstein& cubic, long double s) { return firstPart(cubic, s)[3]; }

Bernstein part(const Bernstein& cubic, long double from, long double to) {
    const Bernstein head = to < 1 ? firstPart(cubic, to) : cubic;
    if (!(from > 0)) return head;
    return reversed(firstPart(reversed(head), 1 - from / std::min(to, 1.0L)));
}

// The ray in index space, begun where it is next to the middle of the medium.
ReferenceField::Ray ReferenceField::enter(const WorldRay& ray, const std::array<std::int64_t, 3>& low,
                                          const std::array<std::int64_t, 3>& high) const {
    const glm::dmat4& matrix = source_.info().index_to_world.matrix();
    const auto inverse = inverseOf(matrix);
    Quad origin[3] = {}, direction[3] = {}, along = 0, square = 0;
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) {
            const Quad entry = inverse[std::size_t(r)][std::size_t(c)];
            origin[r] += entry * (Quad(ray.origin[c]) - Quad(matrix[3][c]));
            direction[r] += entry * Quad(ray.direction[c]);
        }
        const auto a = std::size_t(r);
        along += direction[r] * ((Quad(low[a]) + Quad(high[a])) / 2 - origin[r]);
        square += direction[r] * direction[r];
    }
    const auto distance = (long double)(along / square);
    Ray out{};
    out.distance = distance;
    for (int r = 0; r < 3; ++r) {
        out.origin[r] = (long double)(origin[r] + Quad(distance) * direction[r]);
        out.direction[r] = (long double)direction[r];
    }
    return out;
}

const ReferenceField::Block& ReferenceField::blockAt(const Key& key) const {
    const auto [place, is_new] = blocks_.try_emplace(key);
    Block& block = place->second;
    if (!is_new) return block;
    IndexBox box;
    for (std::size_t a = 0; a < 3; ++a) box.begin[a] = key[a], box.end[a] = key[a] + key[3] + 1;
    const SampleType type = source_.info().type;
    if (const auto uniform = source_.uniformOver(box)) {
        block.uniform = true;
        block.samples = {toDouble(type, uniform->value[0])};
    } else if (key[3] == kBlockEdge) {
        SampleBlock read;
        if (const auto done = source_.read(box, read); !done) throw std::runtime_error(done.error().message);
        const std::size_t bytes = sampleBytes(type);
        for (std::size_t i = 0; i < read.active.size(); ++i) {
            ValueBits bits = 0;
            std::memcpy(&bits, read.values.data() + i * bytes, bytes);
            block.samples.push_back(toDouble(type, bits));
        }
    }
    return block;
}

void ReferenceField::visitCell(const Ray& ray, const Key& cell, Span span, const Block& block,
                               std::vector<ReferenceStep>& out) const {
    ReferenceStep step{span.begin, span.end, {}};
    if (block.uniform) {
        step.cubic.fill((long double)block.samples[0]);
    } else {
        long double from[3], to[3];
        std::size_t first = 0, stride[3] = {1, kBlockEdge + 1, (kBlockEdge + 1) * (kBlockEdge + 1)};
        for (std::size_t a = 0; a < 3; ++a) {
            const auto low = (long double)cell[a];
            from[a] = std::clamp(ray.origin[a] + span.begin * ray.direction[a] - low, 0.0L, 1.0L);
            to[a] = std::clamp(ray.origin[a] + span.end * ray.direction[a] - low, 0.0L, 1.0L);
            first += stride[a] * std::size_t(cell[a] & (kBlockEdge - 1));
        }
        // The field is linear in each coordinate: control point i is its mean over the ways to take i of the
        // three coordinates from the end and the others from the begin.
        for (unsigned ends = 0; ends < 8; ++ends) {
            long double value = 0;
            for (unsigned corner = 0; corner < 8; ++corner) {
                long double weight = 1;
                std::size_t at = first;
                for (unsigned a = 0; a < 3; ++a) {
                    const long double x = (ends >> a & 1) ? to[a] : from[a];
                    weight *= (corner >> a & 1) ? x : 1 - x;
                    if (corner >> a & 1) at += stride[a];
                }
                if (weight != 0) value += weight * (long double)block.samples[at];
            }
            const auto i = std::size_t(__builtin_popcount(ends));
            step.cubic[i] += i == 0 || i == 3 ? value : value / 3;
        }
    }
    if (std::all_of(step.cubic.begin(), step.cubic.end(), [](long double b) { return b == 0; })) return;
    step.begin += ray.distance;
    step.end += ray.distance;
    out.push_back(step);
}

void ReferenceField::visit(const Ray& ray, const Key& box, Span span, const Block* block,
                           std::vector<ReferenceStep>& out) const {
    for (std::size_t a = 0; a < 3; ++a) {
        const auto low = (long double)box[a], high = (long double)(box[a] + box[3]);
        if (ray.direction[a] == 0) {
            if (ray.origin[a] < low || ray.origin[a] >= high) return;
            continue;
        }
        const long double p = (low - ray.origin[a]) / ray.direction[a];
        const long double q = (high - ray.origin[a]) / ray.direction[a];
        span.begin = std::max(span.begin, std::min(p, q));
        span.end = std::min(span.end, std::max(p, q));
    }
    if (!(span.begin < span.end)) return;
    if (!block || (!block->uniform && box[3] >= kBlockEdge)) block = &blockAt(box);
    if (block->uniform || box[3] == 1) return visitCell(ray, box, span, *block, out);
    const std::int64_t half = box[3] / 2;
    for (unsigned octant = 0; octant < 8; ++octant) {
        Key child{box[0], box[1], box[2], half};
        for (std::size_t a = 0; a < 3; ++a)
            if (octant >> a & 1) child[a] += half;
        visit(ray, child, span, block, out);
    }
}

std::vector<ReferenceStep> ReferenceField::along(const WorldRay& world) const {
    const ChannelInfo& info = source_.info();
    std::vector<ReferenceStep> steps;
    if (info.active_box.empty()) return steps;
    std::array<std::int64_t, 3> low{}, high{};
    for (std::size_t a = 0; a < 3; ++a)
        low[a] = info.active_box.begin[a] - 1, high[a] = info.active_box.end[a];
    const Ray ray = enter(world, low, high);
    // The medium's box is closed; the eye is where the ray begins.
    Span span{-ray.distance, std::numeric_limits<long double>::infinity()};
    for (std::size_t a = 0; a < 3; ++a) {
        const auto from = (long double)low[a] - ray.origin[a], to = (long double)high[a] - ray.origin[a];
        if (ray.direction[a] == 0) {
            if (from > 0 || to < 0) return steps;
            continue;
        }
        span.begin = std::max(span.begin, std::min(from / ray.direction[a], to / ray.direction[a]));
        span.end = std::min(span.end, std::max(from / ray.direction[a], to / ray.direction[a]));
    }
    visit(ray, {-kRootEdge, -kRootEdge, -kRootEdge, 2 * kRootEdge}, span, nullptr, steps);
    std::sort(steps.begin(), steps.end(), [](const auto& a, const auto& b) { return a.begin < b.begin; });
    return steps;
}

long double ReferenceField::integral(const WorldRay& ray) const {
    long double sum = 0;
    for (const ReferenceStep& step : along(ray)) sum += (step.end - step.begin) * positiveMean(step.cubic);
    return sum;
}

}  // namespace brickyard

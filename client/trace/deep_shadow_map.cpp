#include "client/trace/deep_shadow_map.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace brickyard {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Of the allowed error, what cutting off the opaque end takes.
constexpr double kCutShare = 0.25;
// Within a piece of the given curve the tolerance is that of its begin, so that it holds in between; long
// pieces are taken in steps of this depth, or the tolerance at their end would be far too tight.
constexpr double kDepthStep = 0.125;
constexpr double kFractions = 4294967295.0;

// The piece under way, and the slopes with which it would meet all tolerances so far.
class ShadowCompressor {
public:
    explicit ShadowCompressor(double error) : error_(error) {}

    // The next place of the curve: its depth there must be within [low, high].
    void add(double distance, double depth, double low, double high) {
        if (!take(distance, low, high)) {
            restart(end());
            if (!take(distance, low, high)) {
                // A jump; or tolerances below rounding, which only the curve itself meets.
                if (distance > begin_.distance)
                    least_ = most_ = std::max(0.0, (depth - begin_.depth) / (distance - begin_.distance));
                else
                    restart({distance, depth});
            }
        }
        last_ = {distance, depth};
    }
    // Between the curve's places `from` and `to`, linear.
    void addPiece(const ShadowVertex& from, const ShadowVertex& to) {
        const bool jump = !(to.distance > from.distance);
        const int steps = jump ? 1 : std::max(1, int(std::ceil((to.depth - from.depth) / kDepthStep)));
        double before = from.depth;
        for (int i = 1; i <= steps; ++i) {
            const double s = double(i) / steps;
            const double depth = i == steps ? to.depth : from.depth + s * (to.depth - from.depth);
            const double distance =
                i == steps ? to.distance : from.distance + s * (to.distance - from.distance);
            // With a deviation d of the depth, that of the transmittance is at most |exp(-d) - 1| times the
            // transmittance at the piece's begin; d is linear, so it is enough that this holds at the ends.
            const double tolerance = error_ * std::exp(jump ? depth : before);
            add(distance, depth, depth - std::log1p(tolerance),
                tolerance < 1 ? depth - std::log1p(-tolerance) : kInfinity);
            before = depth;
        }
    }
    void begin(const ShadowVertex& vertex) { restart(vertex), last_ = vertex; }
    std::vector<ShadowVertex> finish() {
        // What may stay as it is needs no vertex to say so.
        if (least_ > 0) out_.push_back(end());
        return std::move(out_);
    }

private:
    // Whether the piece can go on to there.
    bool take(double distance, double low, double high) {
        const double length = distance - begin_.distance;
        if (!(length > 0)) return begin_.depth >= low && begin_.depth <= high;
        const double least = std::max(least_, (low - begin_.depth) / length);
        const double most = std::min(most_, (high - begin_.depth) / length);
        if (least > most) return false;
        least_ = least;
        most_ = most;
        return true;
    }
    // Where the piece ends: as near to the curve as its slopes allow.
    ShadowVertex end() const {
        const double length = last_.distance - begin_.distance;
        if (!(length > 0)) return {last_.distance, begin_.depth};
        const double slope = std::clamp((last_.depth - begin_.depth) / length, least_, most_);
        return {last_.distance, begin_.depth + slope * length};
    }
    void restart(const ShadowVertex& vertex) {
        begin_ = vertex;
        least_ = 0;  // light does not come back
        most_ = kInfinity;
        out_.push_back(vertex);
    }

    double error_;
    ShadowVertex begin_, last_;
    double least_ = 0, most_ = kInfinity;
    std::vector<ShadowVertex> out_;
};

}  // namespace

std::vector<ShadowVertex> compressShadow(std::span<const ShadowVertex> curve, double error) {
    error = std::min(error, 1.0);
    const double opaque = std::min(-std::log(kCutShare * error), 700.0);
    ShadowCompressor compressor((1 - kCutShare) * error);
    bool begun = false;
    ShadowVertex before;
    auto visit = [&](const ShadowVertex& vertex) {
        if (!begun) {
            // Nothing is in front of the first.
            before = {vertex.distance, 0};
            compressor.begin(before);
            begun = true;
        }
        compressor.addPiece(before, vertex);
        before = vertex;
    };
    for (const ShadowVertex& vertex : curve) {
        if (vertex.depth <= opaque) {
            visit(vertex);
            continue;
        }
        // Cut where the curve becomes opaque.
        double distance = vertex.distance;
        if (begun && vertex.distance > before.distance && std::isfinite(vertex.depth))
            distance = before.distance + (opaque - before.depth) / (vertex.depth - before.depth) *
                                             (vertex.distance - before.distance);
        else if (begun)
            distance = before.distance;
        visit({distance, opaque});
        break;
    }
    if (!begun) return {};
    std::vector<ShadowVertex> out = compressor.finish();
    // A curve that never leaves 0.
    if (out.size() == 1 && out[0].depth == 0) out.clear();
    return out;
}

double transmittanceOf(std::span<const ShadowVertex> curve, double distance) {
    const auto above = std::lower_bound(curve.begin(), curve.end(), distance,
                                        [](const ShadowVertex& v, double d) { return v.distance < d; });
    if (above == curve.begin()) return 1;
    const ShadowVertex& from = *(above - 1);
    if (above == curve.end()) return std::exp(-from.depth);
    const double s = (distance - from.distance) / (above->distance - from.distance);
    return std::exp(-(from.depth + s * (above->depth - from.depth)));
}

DeepShadowMap::DeepShadowMap(LightProjection projection, double error)
    : projection_(std::move(projection)), error_(error), pixels_(projection_.pixelCount()) {
    const double depth = projection_.farthest() - projection_.nearest();
    to_fraction_ = depth > 0 ? kFractions / depth : 0;
}

void DeepShadowMap::set(std::uint32_t pixel, std::span<const ShadowVertex> curve) {
    const std::vector<ShadowVertex> compressed = compressShadow(curve, error_);
    Pixel& out = pixels_[pixel];
    out.count = std::uint32_t(compressed.size());
    out.vertices = compressed.empty() ? nullptr : std::make_unique<Vertex[]>(compressed.size());
    for (std::size_t i = 0; i < compressed.size(); ++i)
        out.vertices[i] = {
            std::uint32_t(std::clamp(std::round(fractionOf(compressed[i].distance)), 0.0, kFractions)),
            float(compressed[i].depth)};
    given_.fetch_add(curve.size(), std::memory_order_relaxed);
}

double DeepShadowMap::along(const Pixel& pixel, double fraction) const {
    const Vertex* const begin = pixel.vertices.get();
    const Vertex* const end = begin + pixel.count;
    const Vertex* const above =
        std::lower_bound(begin, end, fraction, [](const Vertex& v, double f) { return double(v.at) < f; });
    if (above == begin) return 1;
    const Vertex& from = above[-1];
    if (above == end) return std::exp(-double(from.depth));
    const double s = (fraction - double(from.at)) / (double(above->at) - double(from.at));
    return std::exp(-(double(from.depth) + s * (double(above->depth) - double(from.depth))));
}

double DeepShadowMap::transmittance(const glm::dvec3& world, double* deviation) const {
    const LightProjection::Place place = projection_.place(world);
    if (deviation) *deviation = 0;
    if (!place.covered) return 1;
    const double fraction = fractionOf(place.distance);
    double each[4], mean = 0;
    for (std::size_t i = 0; i < 4; ++i) {
        each[i] = along(pixels_[place.pixel[i]], fraction);
        mean += place.weight[i] * each[i];
    }
    if (deviation) {
        double variance = 0;
        for (std::size_t i = 0; i < 4; ++i) variance += place.weight[i] * (each[i] - mean) * (each[i] - mean);
        // The compression's error is anywhere within its bound.
        *deviation =
            std::sqrt(spread_factor_ * spread_factor_ * variance + least_variance_ + error_ * error_ / 3);
    }
    return mean;
}

void DeepShadowMap::calibrate() {
    // Diagonal neighbours are as four pixels of a map half as fine, and the pixel is in their middle. That
    // map's errors over its spreads are at least this one's: equal at edges, twice as large where all is
    // smooth.
    constexpr int kDepths = 6;
    constexpr std::uint32_t kMostAcross = 128;
    struct Sample {
        double spread, error;  // squares
    };
    std::vector<Sample> samples;
    Sample sum{0, 0};
    for (const LightProjection::Face& face : projection_.faces()) {
        const std::uint32_t stride = std::max(1u, std::max(face.width, face.height) / kMostAcross);
        for (std::uint32_t y = 1; y + 1 < face.height; y += stride)
            for (std::uint32_t x = 1; x + 1 < face.width; x += stride)
                for (int d = 1; d <= kDepths; ++d) {
                    const double fraction = kFractions * d / kDepths;
                    auto at = [&](std::uint32_t i, std::uint32_t j) {
                        return along(pixels_[face.first + i + face.width * j], fraction);
                    };
                    const double around[4] = {at(x - 1, y - 1), at(x + 1, y - 1), at(x - 1, y + 1),
                                              at(x + 1, y + 1)};
                    const double mean = 0.25 * (around[0] + around[1] + around[2] + around[3]);
                    Sample sample{0, (at(x, y) - mean) * (at(x, y) - mean)};
                    for (double v : around) sample.spread += 0.25 * (v - mean) * (v - mean);
                    if (sample.spread == 0 && sample.error == 0) continue;  // no medium there
                    samples.push_back(sample);
                    sum.spread += sample.spread;
                    sum.error += sample.error;
                }
    }
    // Not from nothing, nor from the compression's own errors.
    constexpr double kLeastFactor = 0.05, kMostFactor = 2;
    if (!(sum.spread > 0)) return;
    spread_factor_ = std::clamp(std::sqrt(sum.error / sum.spread), kLeastFactor, kMostFactor);
    // Where the spread vanishes, at a crest, the curvature is left: a quarter of the coarser map's error.
    const auto middle = samples.begin() + std::ptrdiff_t(samples.size() / 2);
    std::nth_element(samples.begin(), middle, samples.end(),
                     [](const Sample& a, const Sample& b) { return a.spread < b.spread; });
    double flat = 0;
    for (auto s = samples.begin(); s != middle; ++s) flat += s->error;
    if (middle != samples.begin()) least_variance_ = flat / double(middle - samples.begin()) / 16;
}

std::uint64_t DeepShadowMap::storedVertices() const {
    std::uint64_t count = 0;
    for (const Pixel& pixel : pixels_) count += pixel.count;
    return count;
}

std::uint64_t DeepShadowMap::bytes() const {
    return sizeof(*this) + pixels_.size() * sizeof(Pixel) + storedVertices() * sizeof(Vertex);
}

}  // namespace brickyard

// Light along a reference ray: what glows, and what one light scatters.
#include <algorithm>
#include <cmath>

#include "reference_field.h"

namespace brickyard {

namespace {

// Gauss and Legendre's five points over [0, 1].
constexpr long double kPoints[5] = {0.046910077030668003601L, 0.23076534494715845448L, 0.5L,
                                    0.76923465505284154552L, 0.9530899229693319964L};
constexpr long double kWeights[5] = {0.11846344252809454376L, 0.23931433524968323402L,
                                     0.28444444444444444444L, 0.23931433524968323402L,
                                     0.11846344252809454376L};
// Pieces are halved until nothing in them has a kink and little is absorbed, or this often.
constexpr int kMostHalvings = 16;
constexpr long double kDepthOfPiece = 0.25L;
// Behind this depth lies nothing that 64 bits of mantissa could add: exp(-kHidden) is 1e-52.
constexpr long double kHidden = 120;

bool changesSign(const Bernstein& b) {
    const auto [low, high] = std::minmax_element(b.begin(), b.end());
    return *low < 0 && *high > 0;
}

// A stretch on which density and emission are one cubic each, both scaled.
struct Piece {
    Bernstein density{}, emission{};
    long double length = 0;
};

// Adds the piece's radiance, and its depth to `depth`.
void emitPiece(const Piece& piece, int halvings, long double& depth, long double& radiance) {
    if (depth > kHidden) return;
    const long double whole = piece.length * positiveMean(piece.density);
    const bool smooth = !changesSign(piece.density) && !changesSign(piece.emission) && whole < kDepthOfPiece;
    if (!smooth && halvings < kMostHalvings) {
        for (const long double from : {0.0L, 0.5L})
            emitPiece({part(piece.density, from, from + 0.5L), part(piece.emission, from, from + 0.5L),
                       piece.length / 2},
                      halvings + 1, depth, radiance);
        return;
    }
    for (int i = 0; i < 5; ++i) {
        const long double s = kPoints[i];
        const long double inside = piece.length * s * positiveMean(part(piece.density, 0, s));
        radiance += kWeights[i] * piece.length * std::max(0.0L, valueAt(piece.emission, s)) *
                    std::exp(-depth - inside);
    }
    depth += whole;
}

// The step's cubic over [begin, end], scaled; zero where no step lies there.
Bernstein cubicOver(const std::vector<ReferenceStep>& steps, long double begin, long double end,
                    long double scale) {
    const long double middle = (begin + end) / 2;
    const auto after = std::upper_bound(steps.begin(), steps.end(), middle,
                                        [](long double t, const ReferenceStep& s) { return t < s.begin; });
    if (after == steps.begin() || !((after - 1)->end > middle)) return {};
    const ReferenceStep& step = *(after - 1);
    const long double length = step.end - step.begin;
    Bernstein cubic = part(step.cubic, std::max(0.0L, (begin - step.begin) / length),
                           std::min(1.0L, (end - step.begin) / length));
    for (long double& b : cubic) b *= scale;
    return cubic;
}

}  // namespace

long double emittedRadiance(const std::vector<ReferenceStep>& density, long double density_scale,
                            const std::vector<ReferenceStep>& emission, long double emission_scale) {
    std::vector<long double> breaks;
    for (const auto* steps : {&density, &emission})
        for (const ReferenceStep& step : *steps) breaks.insert(breaks.end(), {step.begin, step.end});
    std::sort(breaks.begin(), breaks.end());
    long double depth = 0, radiance = 0;
    for (std::size_t i = 0; i + 1 < breaks.size(); ++i) {
        if (!(breaks[i] < breaks[i + 1])) continue;
        const Piece piece{cubicOver(density, breaks[i], breaks[i + 1], density_scale),
                          cubicOver(emission, breaks[i], breaks[i + 1], emission_scale),
                          breaks[i + 1] - breaks[i]};
        emitPiece(piece, 0, depth, radiance);
    }
    return radiance;
}

long double scatteredWeight(const ReferenceField& field, const WorldRay& ray, long double density_scale,
                            const glm::dvec3& to_light) {
    constexpr int kPieces = 2;
    long double depth = 0, weight = 0;
    for (const ReferenceStep& step : field.along(ray)) {
        for (int k = 0; k < kPieces; ++k) {
            const Bernstein cubic =
                part(step.cubic, (long double)k / kPieces, (long double)(k + 1) / kPieces);
            const long double length = (step.end - step.begin) / kPieces,
                              begin = step.begin + length * (long double)k;
            for (int i = 0; i < 5; ++i) {
                const long double s = kPoints[i], density = std::max(0.0L, valueAt(cubic, s));
                if (density == 0) continue;
                const long double inside = length * s * positiveMean(part(cubic, 0, s));
                const glm::dvec3 point = ray.origin + double(begin + length * s) * ray.direction;
                const long double to_sun = field.integral({point, to_light});
                weight += kWeights[i] * length * density_scale * density *
                          std::exp(-density_scale * (depth + inside + to_sun));
            }
            depth += length * positiveMean(cubic);
        }
    }
    return weight;
}

}  // namespace brickyard

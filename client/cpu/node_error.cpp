#include "client/cpu/node_error.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "client/cpu/octree_walk.h"

namespace brickyard {

namespace {

constexpr double kTailShare = 0.4;

// effectiveSquare() from the codes of an error grid, for a scale of 1: each code is a power of two.
struct CodeSquares {
    std::array<double, 256> rms{}, bound{};
    CodeSquares() {
        for (int code = 1; code < 256; ++code) {
            const double octaves = (code - 255) / 8.0;
            rms[std::size_t(code)] = std::exp2(2 * (1 - kTailShare) * octaves);
            bound[std::size_t(code)] = std::exp2(2 * kTailShare * octaves);
        }
    }
};
const CodeSquares kCodeSquares;

}  // namespace

double effectiveSquare(double rms, double bound) {
    return rms > 0 ? std::pow(rms, 2 * (1 - kTailShare)) * std::pow(bound, 2 * kTailShare) : 0;
}

double effectiveSquareOfCodes(std::uint8_t rms, std::uint8_t bound) {
    return kCodeSquares.rms[rms] * kCodeSquares.bound[bound];
}

double squareOfNode(const PagedChannel& channel, const NodeKey& key, const NodeRecord& record) {
    const double bound = double(record.bound);
    return std::min(effectiveSquare(double(record.rms), bound) * speckFactor(channel, key), bound * bound);
}

double speckFactor(const PagedChannel& channel, const NodeKey& key) {
    constexpr double kSpeck = 64;
    const double edge = nodeEdge(key, channel.shape());
    const glm::dvec3 low = nodeLow(key, channel.shape());
    double factor = 1;
    for (int a = 0; a < 3; ++a) {
        const double shared =
            std::min(low[a] + edge, channel.clipHigh()[a]) - std::max(low[a], channel.clipLow()[a]);
        factor *= edge / std::clamp(shared, 1.0, edge);
    }
    return factor > kSpeck ? factor : 1;
}

NodeErrors errorsOfNode(const NodeRecord& record, const ErrorGrid* grid) {
    NodeErrors errors;
    errors.bound_scale = double(record.bound);
    if (record.bound == 0) return errors;
    if (!grid) {
        errors.square_scale = kLeafCorrelation * effectiveSquare(double(record.rms), double(record.bound));
        return errors;
    }
    errors.uniform = false;
    errors.square_scale = double(record.bound) * double(record.bound);
    for (std::size_t i = 0; i < kErrorGridCells; ++i) {
        errors.bound[i] = errorFromCode(grid->bound[i], 1);
        errors.square[i] = float(effectiveSquareOfCodes(grid->rms[i], grid->bound[i]));
    }
    return errors;
}

NodeErrors errorsOfDraft(const NodeRecord& record) {
    NodeErrors errors;
    errors.bound_scale = double(record.draft_bound);
    errors.square_scale = effectiveSquare(double(record.draft_rms), double(record.draft_bound));
    return errors;
}

}  // namespace brickyard

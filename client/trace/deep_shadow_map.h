// What a light still has of its power at every depth of a world box: Lokovic, Veach. Deep Shadow Maps. 2000.
//
// Each pixel keeps a piecewise-linear function of distance, compressed within a stated error of
// transmittance. What is linear is the optical depth, not the transmittance as in the paper: between the
// vertices of a medium it is so, and a homogeneous medium takes two vertices however thick it is. Media are
// the caller's business.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "client/trace/light_projection.h"

namespace brickyard {

// Linear between two, 0 before the first, constant behind the last. Two at one distance are a jump (a
// surface).
struct ShadowVertex {
    double distance = 0;
    double depth = 0;  // optical, from the light to here; may be infinite
};

// Fewer vertices of the same kind: everywhere, between vertices too, |exp(-depth) - exp(-given)| <= error.
// None where light comes through whole. Greedy: a piece goes on as long as some slope meets the tolerance at
// all vertices of it. REQUIRES: distances and depths do not fall; 0 < error. Depths behind which no more than
// error / 4 comes through are cut off there.
std::vector<ShadowVertex> compressShadow(std::span<const ShadowVertex> curve, double error);
// The curve's transmittance at a distance; at a jump, that in front of it.
double transmittanceOf(std::span<const ShadowVertex> curve, double distance);

class DeepShadowMap {
public:
    // `error`: of the transmittance along a pixel's ray.
    DeepShadowMap(LightProjection projection, double error);

    const LightProjection& projection() const { return projection_; }
    double error() const { return error_; }

    // The curve along projection().ray(pixel), in any detail. Different pixels may be set by different
    // threads; a pixel that never is lets all light through. Costs one walk over the curve.
    void set(std::uint32_t pixel, std::span<const ShadowVertex> curve);
    // Once all are set, before lookups: compares pixels with what their neighbours would have told, so that
    // deviations are those of this light and this medium. Without it they take every change from pixel to
    // pixel for an edge that can be anywhere between them.
    void calibrate();

    // From the light to a point, between the four pixels around it. Transmittances are interpolated, not
    // depths: light adds up, so the border of a shadow stays in the middle of its blur, where the mean of a
    // depth and an opaque one would be opaque. 1 where the light does not see the box in this direction. Any
    // thread.
    //
    // `deviation`, where it is given: one standard deviation of the expected error, from the spread of the
    // four (for an edge between them, exactly that of not knowing where) and from the compression.
    double transmittance(const glm::dvec3& world, double* deviation = nullptr) const;

    // Of all pixels.
    std::uint64_t givenVertices() const { return given_.load(std::memory_order_relaxed); }
    std::uint64_t storedVertices() const;
    // Memory.
    std::uint64_t bytes() const;

private:
    // `at`: distance as a part of the box's depth, [nearest, farthest], in 2^-32: in a box of 2^22 voxels a
    // 1024th of a voxel.
    struct Vertex {
        std::uint32_t at;
        float depth;
    };
    struct Pixel {
        std::unique_ptr<Vertex[]> vertices;
        std::uint32_t count = 0;
    };
    double fractionOf(double distance) const { return (distance - projection_.nearest()) * to_fraction_; }
    double along(const Pixel& pixel, double fraction) const;

    LightProjection projection_;
    double error_;
    double to_fraction_ = 0;
    double least_variance_ = 0;  // of the error where there is no spread
    double spread_factor_ = 1;   // expected error at most, over the spread of the four
    std::vector<Pixel> pixels_;
    std::atomic<std::uint64_t> given_{0};
};

}  // namespace brickyard

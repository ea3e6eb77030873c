// Colour and opacity by value, for scientific data, and their exact means along a stretch on which the value
// is linear (pre-integration: Engel, Kraus, Ertl. High-Quality Pre-Integrated Volume Rendering. 2001; here in
// closed form, without a table), so that a thin feature survives a long step. Immutable: any thread.
#pragma once

#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "core/result.h"
#include "proto/scene.pb.h"

namespace brickyard {

class TransferFunction {
public:
    struct Point {
        double value = 0;
        glm::dvec3 color{0};  // linear RGB
        double opacity = 0;
    };
    struct Sample {
        glm::dvec3 color{0};  // of what is there: weighted by opacity; 0 where there is none
        double opacity = 0;
    };

    // REQUIRES: at least one point, rising by value, all finite, opacities at least 0.
    explicit TransferFunction(std::vector<Point> points);
    // `low`, `high`: the channel's range, over which a preset without a window is spread. Errors: kInvalid.
    static Result<TransferFunction> create(const Transfer& entry, double low, double high,
                                           const std::string& where);

    Sample at(double value) const;
    // Mean over the values from `a` to `b`, in either order: opacity, and colour weighted by opacity.
    Sample mean(double a, double b) const;
    // Largest opacity anywhere on [low, high].
    double most(double low, double high) const;
    const std::vector<Point>& points() const { return points_; }

private:
    std::vector<Point> points_;
    std::vector<double> opacity_;       // integral of opacity up to each point
    std::vector<glm::dvec3> emission_;  // integral of opacity * color
};

}  // namespace brickyard

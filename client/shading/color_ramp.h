// A colour by value: piecewise linear in linear RGB, constant beyond its ends. Immutable: any thread.
#pragma once

#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "core/result.h"
#include "proto/scene.pb.h"

namespace brickyard {

class ColorRamp {
public:
    struct Point {
        double value = 0;
        glm::dvec3 color{0};
    };
    // REQUIRES: at least one point, rising by value, all finite.
    explicit ColorRamp(std::vector<Point> points);
    // Errors: kInvalid (`where` names the entry in the message).
    static Result<ColorRamp> create(const Ramp& ramp, const std::string& where);

    glm::dvec3 at(double value) const;
    // Largest component anywhere on [low, high].
    double most(double low, double high) const;
    const std::vector<Point>& points() const { return points_; }

private:
    std::vector<Point> points_;
};

// Named colours over [0, 1]: fire, viridis, magma, grey. Empty where there is no such name.
std::vector<ColorRamp::Point> namedColors(const std::string& name);

}  // namespace brickyard

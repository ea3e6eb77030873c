// How much of a light reaches points of the world: the share that no medium in between takes away, in [0, 1].
#pragma once

#include <functional>
#include <glm/vec3.hpp>
#include <span>

#include "core/result.h"

namespace brickyard {

// Fills `transmittance`, one number for each point. Called from one thread at a time. REQUIRES: equal
// lengths. Errors: whatever reading the medium can meet.
using LightSampler =
    std::function<Result<void>(std::span<const glm::dvec3> points, std::span<float> transmittance)>;

}  // namespace brickyard

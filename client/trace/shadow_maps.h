// Deep shadow maps of a picture's lights. Filled once, tile by tile, by many threads; then any thread reads.
#pragma once

#include <cstddef>
#include <glm/vec3.hpp>
#include <optional>

namespace brickyard {

struct Reach;

class ShadowMaps {
public:
    // Nothing where the light has no map, or the point is not in it.
    std::optional<Reach> at(std::size_t light, const glm::dvec3& point) const;
};

}  // namespace brickyard

#include "client/trace/shadow_maps.h"

#include "client/trace/light_reach.h"

namespace brickyard {

std::optional<Reach> ShadowMaps::at(std::size_t, const glm::dvec3&) const { return std::nullopt; }

}  // namespace brickyard

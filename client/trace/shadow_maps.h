// Deep shadow maps of a picture's lights (client/trace/deep_shadow_map.h): which lights have one, how fine it
// is, and what fills it. Filled once, a block of pixels at a time, by many threads; then any thread reads.
#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <vector>

#include "client/trace/deep_shadow_map.h"

namespace brickyard {

struct Reach;
struct TracedWorld;
struct WorldReader;
class SurfaceHits;

class ShadowMaps {
public:
    // Empty maps for the lights that want one. `world` outlives this.
    explicit ShadowMaps(const TracedWorld& world);

    bool empty() const { return blocks_.empty(); }
    std::size_t blockCount() const { return blocks_.size(); }
    // Different blocks may be filled by different threads. What a reader missed is the caller's to ask.
    void fill(std::size_t block, WorldReader& reader, SurfaceHits* surfaces);
    // Once all are filled.
    void calibrate();

    // Nothing where the light has no map. `light`: index in TracedWorld::lights.
    std::optional<Reach> at(std::size_t light, const glm::dvec3& point) const;
    std::uint64_t bytes() const;

private:
    struct Block {
        std::size_t light = 0;
        std::uint32_t begin = 0, end = 0;  // pixels
        double lod = 0;
    };
    const TracedWorld& world_;
    std::vector<std::unique_ptr<DeepShadowMap>> maps_;  // by light
    std::vector<Block> blocks_;
};

}  // namespace brickyard

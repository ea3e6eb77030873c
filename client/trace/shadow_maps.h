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

    // Most levels of detail that a map is coarser than what is seen.
    static double coarserBy(const TracedWorld& world);

    bool empty() const { return blocks_.empty(); }
    std::size_t blockCount() const { return blocks_.size(); }
    // Goes on with a block; gives how many of its pixels are done for good. Behind the first pixel that
    // misses a page it goes on only to find out what else is missing, or with `stop_at_miss` not at all.
    // Different blocks may be filled by different threads.
    std::uint32_t fill(std::size_t block, bool stop_at_miss, WorldReader& reader, SurfaceHits* surfaces);
    bool filled(std::size_t block) const { return blocks_[block].next == blocks_[block].end; }
    // Once all are filled.
    void calibrate();

    // Nothing where the light has no map. `light`: index in TracedWorld::lights.
    std::optional<Reach> at(std::size_t light, const glm::dvec3& point) const;
    std::uint64_t bytes() const;

private:
    struct Block {
        std::size_t light = 0;
        std::uint32_t next = 0, end = 0;  // pixels that are left
        double lod = 0;
    };
    void fillPixel(const Block& block, std::uint32_t pixel, WorldReader& reader, SurfaceHits* surfaces);

    const TracedWorld& world_;
    std::vector<std::unique_ptr<DeepShadowMap>> maps_;  // by light
    std::vector<Block> blocks_;
};

}  // namespace brickyard

// Light samplers that integrate exactly: one ray a point and light, two-point Gauss in every cell.
#pragma once

#include "client/world_settings.h"
#include "core/octree_builder.h"
#include "tools/bake/light_sampler.h"
#include "tools/bake/medium_depth.h"

namespace brickyard {

// Of a directional light, or of a point or spot light, whose cone does not count; of an environment the mean
// over the distant lights that it is made of, by their power. `depth` outlives the sampler. Points are shared
// out by `parallel_for`.
LightSampler exactLight(const WorldLight& light, const MediumDepth& depth, ParallelFor parallel_for);

}  // namespace brickyard

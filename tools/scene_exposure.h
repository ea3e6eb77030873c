// How thick a smoke and how bright a fire would be, in columns through their samples. Pure functions, any
// thread.
#pragma once

#include <functional>

#include "tools/sampled_field.h"

namespace brickyard {

// The median, over the columns across `up` (an index axis, 0 to 2) that meet anything worth it, of the
// integral of max(0, density) along them, in world units. 0 where there is none.
double medianColumn(const SampledField& density, int up);

// Emitted radiance per world unit at sample i, for a scale of 1: the largest of its colours.
using Glow = std::function<double(std::int64_t)>;
// What the brightest columns across `up` (their upper 2 %) show, dimmed by what stands before it: extinction
// is density_scale * density. 0 where nothing glows.
double brightestColumns(const SampledField& density, double density_scale, const Glow& glow, int up);

}  // namespace brickyard

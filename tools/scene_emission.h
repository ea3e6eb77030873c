// How a fire glows that nobody has described. Pure functions, any thread.
#pragma once

#include <cstdint>
#include <vector>

#include "proto/scene.pb.h"

namespace brickyard {

// Three digits, as a person would write it.
double rounded(double value);

// Values of at least 0 at the same samples; of what is not there, none.
struct FireFields {
    std::vector<double> flame, heat;
    bool has_flame = false, has_heat = false;
};

struct FireProposal {
    Emission emission;  // without channel, weight and scale
    std::vector<double>
        glow;  // at each sample: radiance per world unit of the strongest colour, for a scale of 1
};

// A black body of the heat, weighted by the flame; without heat a ramp over the flame. REQUIRES: one of the
// two.
FireProposal proposeEmission(const FireFields& fields, std::int64_t samples);

}  // namespace brickyard

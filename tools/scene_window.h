// Which values of a scan are worth seeing. Pure functions, any thread.
#pragma once

#include "proto/scene.pb.h"
#include "tools/sampled_field.h"

namespace brickyard {

// A preset and its window, from how often which value occurs. `lowest` is the channel's: Hounsfield units are
// known by it.
Transfer proposeTransfer(const SampledField& field, double lowest);

}  // namespace brickyard

// Which channel is the density where nobody names one: the client's scene and the server's camera wish must
// mean the same. Pure function, any thread.
#pragma once

#include <cstdint>
#include <optional>

#include "proto/dataset.pb.h"

namespace brickyard {

// "density" where there is one, else the only scalar channel, "light.0" and its like (docs/bake.md) left out;
// nothing where that is not clear. An index in FrameFooter.channels.
std::optional<std::uint32_t> defaultDensity(const FrameFooter& frame);

}  // namespace brickyard

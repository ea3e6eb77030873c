// A camera for who names none. The client frames what it draws with it, and the server frames the same for a
// cold client that has no footer yet: both must find the same camera. Pure functions, any thread.
#pragma once

#include "proto/dataset.pb.h"
#include "proto/scene.pb.h"

namespace brickyard {

// A camera that sees all of the channel's active box: from the front, a little above; up is the longer of Y
// and Z.
Camera frameChannel(const ChannelFooter& channel, double aspect);

}  // namespace brickyard

// What a manifest repeats of a frame's channels. Pure function, any thread.
#pragma once

#include "proto/dataset.pb.h"

namespace brickyard {

ChannelSummary summarizeChannel(const ChannelFooter& channel);

}  // namespace brickyard

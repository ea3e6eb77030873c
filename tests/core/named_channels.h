// A frame's footer of nothing but channels with names: for what is chosen by name.
#pragma once

#include <initializer_list>
#include <utility>

#include "proto/dataset.pb.h"

namespace brickyard {

inline FrameFooter footerWith(std::initializer_list<std::pair<const char*, unsigned>> channels) {
    FrameFooter footer;
    for (const auto& [name, components] : channels) {
        ChannelFooter* channel = footer.add_channels();
        channel->set_name(name);
        channel->set_components(components);
    }
    return footer;
}

}  // namespace brickyard

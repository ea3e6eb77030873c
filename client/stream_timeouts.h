// How long a client waits for a server. Plain value.
#pragma once

#include <chrono>

namespace brickyard {

struct StreamTimeouts {
    std::chrono::milliseconds connect{10'000};  // name, TCP and WebSocket together
    std::chrono::milliseconds idle{60'000};     // of a server that answers nothing, not even pings
    // Since a connection was lost until it serves again; 0: a lost connection is lost at once.
    std::chrono::milliseconds reconnect{30'000};
};

}  // namespace brickyard

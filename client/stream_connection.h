// A WebSocket to a server, with a thread of its own: whole binary messages out and in, nothing about their
// meaning. Members may be called from any thread; the handlers are called on the connection's thread.
#pragma once

#include <chrono>
#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "client/stream_address.h"
#include "core/result.h"

namespace brickyard {

struct StreamTimeouts {
    std::chrono::milliseconds connect{10'000};  // name, TCP and WebSocket together
    std::chrono::milliseconds idle{60'000};     // of a server that answers nothing, not even pings
};

class StreamConnection {
public:
    struct Handlers {
        std::function<void()> on_open;
        // Says whether to go on reading; after `false`, resumeReading() does.
        std::function<bool(std::span<const std::byte> message)> on_message;
        // Once, and nothing after it. The message begins with the address.
        std::function<void(Error error)> on_lost;
        // Asked when the connection can send: the next whole message, or an empty one where there is none.
        std::function<std::vector<std::byte>()> next_message;
    };

    // Connects in the background.
    StreamConnection(StreamAddress address, StreamTimeouts timeouts, Handlers handlers);
    // Cuts the connection and waits for its thread; no handler is called afterwards.
    ~StreamConnection();
    StreamConnection(const StreamConnection&) = delete;
    StreamConnection& operator=(const StreamConnection&) = delete;

    // There is something to send: next_message will be asked.
    void wakeSender();
    void resumeReading();

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace brickyard

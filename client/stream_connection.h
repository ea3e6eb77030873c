// A WebSocket to a server: whole binary messages out and in, nothing about their meaning. Members may be
// called from any thread; the handlers are called on the network thread that the connection was given, one at
// a time.
#pragma once

#include <chrono>
#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "client/stream_address.h"
#include "client/stream_timeouts.h"
#include "core/result.h"

namespace brickyard {

class NetworkThread;

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

    // Connects in the background, `delay` from now. `thread`: nullptr is NetworkThread::shared().
    StreamConnection(StreamAddress address, StreamTimeouts timeouts, Handlers handlers,
                     std::shared_ptr<NetworkThread> thread = nullptr, std::chrono::milliseconds delay = {});
    // Cuts the connection. Waits for a handler that is running, and none is called afterwards; a handler may
    // destroy its own connection.
    ~StreamConnection();
    StreamConnection(const StreamConnection&) = delete;
    StreamConnection& operator=(const StreamConnection&) = delete;

    // There is something to send: next_message will be asked.
    void wakeSender();
    void resumeReading();

private:
    struct State;
    std::shared_ptr<NetworkThread> thread_;
    std::shared_ptr<State> state_;
};

}  // namespace brickyard

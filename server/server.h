// A running server: datasets on one port, over HTTP/1.1 and WebSocket. docs/protocol.md tells the
// conversation. Any thread.
#pragma once

#include <cstdint>
#include <memory>

#include "core/result.h"
#include "server/catalog.h"
#include "server/server_options.h"

namespace brickyard {

class Server {
public:
    // Listens when this returns. Errors: kIo (the port is taken), kInvalid (no such host).
    static Result<std::unique_ptr<Server>> start(std::unique_ptr<const Catalog> catalog,
                                                 ServerOptions options);
    // Stops.
    ~Server();

    // The real one, where the options asked for any.
    std::uint16_t port() const;
    // Accepts nothing more, says goodbye to every client, and returns when all threads have ended: within
    // seconds.
    void stop();

private:
    struct State;
    explicit Server(std::unique_ptr<State> state);
    std::unique_ptr<State> state_;
};

}  // namespace brickyard

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
    // Listens when this returns. Errors: kIo (the port is taken; a certificate, key or token file cannot be
    // read), kInvalid (no such host; what such a file holds).
    static Result<std::unique_ptr<Server>> start(std::unique_ptr<Catalog> catalog, ServerOptions options);
    // Stops.
    ~Server();

    // The real one, where the options asked for any.
    std::uint16_t port() const;
    // Reads certificate, key and tokens again, for connections from now on; a stream whose token is gone
    // ends. Where one cannot be read, all stay as they were. Errors: those of start().
    Result<void> reload();
    // Accepts nothing more, says goodbye to every client, and returns when all threads have ended: within
    // the drain timeout, and a little more.
    void stop();

private:
    struct State;
    explicit Server(std::unique_ptr<State> state);
    std::unique_ptr<State> state_;
};

}  // namespace brickyard

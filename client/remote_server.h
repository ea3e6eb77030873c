// One connection to a server, for as many of its datasets as one likes: sources that are opened here share
// it. Any thread may call. docs/client.md.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "client/brick_source.h"
#include "client/remote_source.h"
#include "client/stream_address.h"
#include "client/stream_timeouts.h"

namespace brickyard {

class NetworkThread;
class ServerLink;

class RemoteServer {
public:
    // Connects in the background: open() tells whether that worked. `address.dataset` is not used. `thread`:
    // nullptr is NetworkThread::shared().
    RemoteServer(const StreamAddress& address, const std::string& token, StreamTimeouts timeouts = {},
                 std::shared_ptr<NetworkThread> thread = nullptr);
    // Sources that were opened go on.
    ~RemoteServer();

    // Another source of a dataset: its frame, its wishes and what comes for them are its own. At most 16
    // different datasets. Errors: those of RemoteSource::open; kInvalid (one too many).
    Result<std::unique_ptr<RemoteSource>> open(const std::string& dataset,
                                               const std::optional<StartHint>& start = {});
    // The names of the datasets there are, as far as the server has told since they changed.
    std::optional<std::vector<std::string>> catalog() const;

private:
    std::shared_ptr<ServerLink> link_;
};

}  // namespace brickyard

#include "client/remote_server.h"

#include "client/server_link.h"

namespace brickyard {

RemoteServer::RemoteServer(const StreamAddress& address, const std::string& token, StreamTimeouts timeouts,
                           std::shared_ptr<NetworkThread> thread)
    : link_(std::make_shared<ServerLink>(address, token, timeouts, std::move(thread), /*alone=*/false)) {}

RemoteServer::~RemoteServer() = default;

Result<std::unique_ptr<RemoteSource>> RemoteServer::open(const std::string& dataset,
                                                         const std::optional<StartHint>& start) {
    return RemoteSource::open(link_, dataset, start);
}

std::optional<std::vector<std::string>> RemoteServer::catalog() const {
    const std::lock_guard lock(link_->mutex);
    return link_->catalog();
}

}  // namespace brickyard

// One accepted connection: HTTP/1.1 requests until it closes or becomes a WebSocket. Kept alive by its own
// handlers, which run on the socket's strand.
#pragma once

#include <boost/asio/ip/tcp.hpp>
#include <memory>

#include "server/connection_list.h"
#include "server/server_context.h"

namespace brickyard {

void startHttpSession(boost::asio::ip::tcp::socket socket, std::unique_ptr<ConnectionList::Slot> slot,
                      ServerContext& context);

}  // namespace brickyard

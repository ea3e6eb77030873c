// One WebSocket connection: carries a Conversation. Kept alive by its own handlers, which run on the socket's
// strand.
#pragma once

#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/http/message.hpp>
#include <boost/beast/http/string_body.hpp>
#include <memory>

#include "server/connection_list.h"
#include "server/server_context.h"

namespace brickyard {

// REQUIRES: `upgrade` is a WebSocket upgrade; called on the socket's strand.
void startStreamSession(boost::asio::ip::tcp::socket socket,
                        boost::beast::http::request<boost::beast::http::string_body> upgrade,
                        std::unique_ptr<ConnectionList::Slot> slot, ServerContext& context);

}  // namespace brickyard

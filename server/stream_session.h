// One WebSocket connection: carries a Conversation. Kept alive by its own handlers, which run on its thread.
#pragma once

#include <boost/beast/http/message.hpp>
#include <boost/beast/http/string_body.hpp>
#include <memory>

#include "server/connection_list.h"
#include "server/io_threads.h"
#include "server/server_context.h"
#include "transport/byte_stream.h"

namespace brickyard {

// REQUIRES: `upgrade` is a WebSocket upgrade; called on `thread`, whose loop the stream is of.
void startStreamSession(std::unique_ptr<ByteStream> stream,
                        boost::beast::http::request<boost::beast::http::string_body> upgrade,
                        std::unique_ptr<ConnectionList::Slot> slot, IoThread& thread, ServerContext& context);

}  // namespace brickyard

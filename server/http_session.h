// One accepted connection: HTTP/1.1 requests until it closes or becomes a WebSocket. Kept alive by its own
// handlers, which run on its thread.
#pragma once

#include <memory>

#include "server/connection_list.h"
#include "server/io_threads.h"
#include "server/server_context.h"
#include "transport/byte_stream.h"

namespace brickyard {

// REQUIRES: called on `thread`, whose loop the stream is of.
void startHttpSession(std::unique_ptr<ByteStream> stream, std::unique_ptr<ConnectionList::Slot> slot,
                      IoThread& thread, ServerContext& context);

}  // namespace brickyard

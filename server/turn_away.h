// Tells a peer for which there is no place why, and hangs up.
#pragma once

#include <string_view>

#include "server/io_threads.h"
#include "transport/byte_stream.h"

namespace brickyard {

enum class TurnedAwayFor { kServerFull, kAddressFull };

// Waits a moment for the request, because an answer that comes before it is lost in the reset that an unread
// request brings; a few at a time, the others are cut. Any thread.
void turnAway(ByteStream::Socket socket, IoThread& thread, TurnedAwayFor why);

}  // namespace brickyard

// A TCP connection in the clear.
#pragma once

#include <memory>

#include "transport/byte_stream.h"

namespace brickyard {

std::unique_ptr<ByteStream> makePlainStream(ByteStream::Socket socket);

}  // namespace brickyard

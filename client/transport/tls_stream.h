// A TCP connection under TLS. The only header and source that instantiate Asio's TLS streams, which are slow
// to compile.
#pragma once

#include <memory>
#include <string>

#include "transport/byte_stream.h"
#include "transport/tls_context.h"

namespace brickyard {

std::unique_ptr<ByteStream> makeTlsServerStream(ByteStream::Socket socket, TlsContext context);
// The peer must prove to be `host`, a name or an address.
std::unique_ptr<ByteStream> makeTlsClientStream(ByteStream::Socket socket, TlsContext context,
                                                const std::string& host);

}  // namespace brickyard

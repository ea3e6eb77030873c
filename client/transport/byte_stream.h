// A connection as bytes, in the clear or encrypted: whoever speaks HTTP or WebSocket over it is compiled
// once. One thread at a time; handlers run on the executor's thread, never within the call that starts them.
// At most one read and one write at a time. Buffers must live until their handler runs; the stream itself
// too.
#pragma once

#include <array>
#include <boost/asio/buffer.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/system/error_code.hpp>
#include <memory>
#include <string>

#include "transport/once_handler.h"

namespace brickyard {

// A few buffers to be written one behind the other: a buffer sequence of Asio, which copies it.
class WriteBuffers {
public:
    static constexpr std::size_t kMax = 16;

    WriteBuffers() = default;
    explicit WriteBuffers(boost::asio::const_buffer only) { add(only); }
    WriteBuffers(boost::asio::const_buffer first, boost::asio::const_buffer second) {
        add(first);
        add(second);
    }
    // False where there is no room for one more: it is for the next write.
    bool add(boost::asio::const_buffer buffer) {
        if (count_ == kMax) return false;
        buffers_[count_++] = buffer;
        return true;
    }
    const boost::asio::const_buffer* begin() const { return buffers_.data(); }
    const boost::asio::const_buffer* end() const { return buffers_.data() + count_; }

private:
    std::array<boost::asio::const_buffer, kMax> buffers_;
    std::size_t count_ = 0;
};

class ByteStream {
public:
    using Executor = boost::asio::io_context::executor_type;
    using Socket = boost::asio::basic_stream_socket<boost::asio::ip::tcp, Executor>;

    virtual ~ByteStream() = default;

    virtual Socket& socket() = 0;
    // TLS's handshake; nothing in the clear. Before anything else.
    virtual void asyncHandshake(OnceHandler done) = 0;
    virtual void asyncReadSome(boost::asio::mutable_buffer into, OnceHandler done) = 0;
    // How many bytes were written is told.
    virtual void asyncWriteSome(WriteBuffers from, OnceHandler done) = 0;
    // Writes what the socket takes at once, without waiting; would_block where that is nothing, or where the
    // stream cannot tell.
    virtual std::size_t writeNow(const WriteBuffers& from, boost::system::error_code& error) = 0;
    // Says goodbye in good order: the peer reads the end of the stream behind what was written.
    virtual void asyncShutdown(OnceHandler done) = 0;
    // Cuts it; what is pending ends with operation_aborted.
    void close() {
        boost::system::error_code ignored;
        socket().close(ignored);
    }
    // "" in the clear, else the protocol: "TLSv1.3".
    virtual std::string encryption() const = 0;
};

}  // namespace brickyard

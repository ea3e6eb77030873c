// A ByteStream as Boost.Beast wants one: a movable AsyncReadStream and AsyncWriteStream. Owns the stream.
#pragma once

#include <boost/asio/async_result.hpp>
#include <boost/beast/core/role.hpp>
#include <boost/beast/websocket/teardown.hpp>
#include <memory>
#include <utility>

#include "transport/byte_stream.h"

namespace brickyard {

class AnyStream {
public:
    using executor_type = ByteStream::Executor;

    explicit AnyStream(std::unique_ptr<ByteStream> stream) : stream_(std::move(stream)) {}

    executor_type get_executor() const { return stream_->socket().get_executor(); }
    ByteStream& bytes() { return *stream_; }
    std::unique_ptr<ByteStream> release() { return std::move(stream_); }

    template <class Buffers, class Token>
    auto async_read_some(const Buffers& buffers, Token&& token) {
        return boost::asio::async_initiate<Token, void(boost::system::error_code, std::size_t)>(
            [](auto handler, ByteStream* stream, boost::asio::mutable_buffer into) {
                stream->asyncReadSome(into, OnceHandler(std::move(handler)));
            },
            token, stream_.get(), firstOf(buffers));
    }

    template <class Buffers, class Token>
    auto async_write_some(const Buffers& buffers, Token&& token) {
        WriteBuffers some;
        for (auto at = boost::asio::buffer_sequence_begin(buffers);
             at != boost::asio::buffer_sequence_end(buffers) && some.add(*at); ++at) {
        }
        return boost::asio::async_initiate<Token, void(boost::system::error_code, std::size_t)>(
            [](auto handler, ByteStream* stream, const WriteBuffers& from) {
                stream->asyncWriteSome(from, OnceHandler(std::move(handler)));
            },
            token, stream_.get(), some);
    }

private:
    template <class Buffers>
    static boost::asio::mutable_buffer firstOf(const Buffers& buffers) {
        for (auto at = boost::asio::buffer_sequence_begin(buffers);
             at != boost::asio::buffer_sequence_end(buffers); ++at)
            if (boost::asio::mutable_buffer(*at).size() > 0) return *at;
        return {};
    }

    std::unique_ptr<ByteStream> stream_;
};

// What Beast calls to end a WebSocket's connection.
template <class Handler>
void async_teardown(boost::beast::role_type, AnyStream& stream, Handler&& handler) {
    stream.bytes().asyncShutdown(
        OnceHandler([handler = std::forward<Handler>(handler)](boost::system::error_code error,
                                                               std::size_t) mutable { handler(error); }));
}
inline void teardown(boost::beast::role_type, AnyStream& stream, boost::system::error_code& error) {
    stream.bytes().socket().close(error);
}
inline void beast_close_socket(AnyStream& stream) { stream.bytes().close(); }

}  // namespace brickyard

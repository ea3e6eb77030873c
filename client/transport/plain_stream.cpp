#include "transport/plain_stream.h"

#include <boost/asio/post.hpp>

namespace brickyard {
namespace {

namespace asio = boost::asio;
using ErrorCondition = boost::system::error_code;

class PlainStream final : public ByteStream {
public:
    explicit PlainStream(Socket socket) : socket_(std::move(socket)) {}

    Socket& socket() override { return socket_; }
    void asyncHandshake(OnceHandler done) override {
        asio::post(socket_.get_executor(), [done = std::move(done)]() mutable { done({}, 0); });
    }
    void asyncReadSome(asio::mutable_buffer into, OnceHandler done) override {
        socket_.async_read_some(into, std::move(done));
    }
    void asyncWriteSome(WriteBuffers from, OnceHandler done) override {
        socket_.async_write_some(from, std::move(done));
    }
    std::size_t writeNow(const WriteBuffers& from, ErrorCondition& error) override {
        if (!socket_.non_blocking()) socket_.non_blocking(true, error);
        return socket_.write_some(from, error);
    }
    void asyncShutdown(OnceHandler done) override {
        ErrorCondition ignored;
        socket_.shutdown(asio::ip::tcp::socket::shutdown_send, ignored);
        asio::post(socket_.get_executor(), [done = std::move(done)]() mutable { done({}, 0); });
    }
    std::string encryption() const override { return {}; }

private:
    Socket socket_;
};

}  // namespace

std::unique_ptr<ByteStream> makePlainStream(ByteStream::Socket socket) {
    return std::make_unique<PlainStream>(std::move(socket));
}

}  // namespace brickyard

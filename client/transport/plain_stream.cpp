#include "transport/plain_stream.h"

#include <sys/sendfile.h>

#include <boost/asio/post.hpp>
#include <cerrno>

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
    bool canSendFile() const override { return true; }
    void asyncSendFile(int descriptor, std::uint64_t begin, std::uint64_t end, OnceHandler done) override {
        sendFile(descriptor, begin, end, 0, std::move(done), /*at_once=*/false);
    }
    void asyncShutdown(OnceHandler done) override {
        ErrorCondition ignored;
        socket_.shutdown(asio::ip::tcp::socket::shutdown_send, ignored);
        asio::post(socket_.get_executor(), [done = std::move(done)]() mutable { done({}, 0); });
    }
    std::string encryption() const override { return {}; }

private:
    void sendFile(int descriptor, std::uint64_t begin, std::uint64_t end, std::size_t sent, OnceHandler done,
                  bool at_once) {
        ErrorCondition error;
        if (!socket_.non_blocking()) socket_.non_blocking(true, error);
        while (!error && begin < end) {
            auto offset = off_t(begin);
            const ssize_t count = ::sendfile(socket_.native_handle(), descriptor, &offset, end - begin);
            if (count > 0) {
                begin += std::uint64_t(count);
                sent += std::size_t(count);
            } else if (count == 0) {
                error = asio::error::eof;  // the file became shorter
            } else if (errno == EAGAIN) {
                socket_.async_wait(
                    Socket::wait_write, [this, descriptor, begin, end, sent,
                                         done = std::move(done)](ErrorCondition failed) mutable {
                        if (failed) return done(failed, sent);
                        sendFile(descriptor, begin, end, sent, std::move(done), /*at_once=*/true);
                    });
                return;
            } else if (errno != EINTR) {
                error.assign(errno, boost::system::system_category());
            }
        }
        if (at_once) return done(error, sent);
        asio::post(socket_.get_executor(),
                   [done = std::move(done), error, sent]() mutable { done(error, sent); });
    }

    Socket socket_;
};

}  // namespace

std::unique_ptr<ByteStream> makePlainStream(ByteStream::Socket socket) {
    return std::make_unique<PlainStream>(std::move(socket));
}

}  // namespace brickyard

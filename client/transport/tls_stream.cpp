#include "transport/tls_stream.h"

#include <boost/asio/ip/address.hpp>
#include <boost/asio/ssl/host_name_verification.hpp>
#include <boost/asio/ssl/stream.hpp>

namespace brickyard {
namespace {

namespace asio = boost::asio;
namespace ssl = asio::ssl;
using ErrorCondition = boost::system::error_code;

class TlsStream final : public ByteStream {
public:
    TlsStream(Socket socket, TlsContext context, ssl::stream_base::handshake_type role)
        : context_(std::move(context)), stream_(std::move(socket), *context_), role_(role) {}

    void expect(const std::string& host) {
        ErrorCondition is_name;
        asio::ip::make_address(host, is_name);
        // An address is never sent as a server name (RFC 6066, section 3).
        if (is_name) SSL_set_tlsext_host_name(stream_.native_handle(), host.c_str());
        stream_.set_verify_callback(ssl::host_name_verification(host));
    }

    Socket& socket() override { return stream_.next_layer(); }
    void asyncHandshake(OnceHandler done) override {
        stream_.async_handshake(role_,
                                [done = std::move(done)](ErrorCondition error) mutable { done(error, 0); });
    }
    void asyncReadSome(asio::mutable_buffer into, OnceHandler done) override {
        stream_.async_read_some(into, std::move(done));
    }
    void asyncWriteSome(WriteBuffers from, OnceHandler done) override {
        // One record at a time is written in any case.
        for (const asio::const_buffer& buffer : from)
            if (buffer.size() > 0) return stream_.async_write_some(buffer, std::move(done));
        stream_.async_write_some(asio::const_buffer(), std::move(done));
    }
    std::size_t writeNow(const WriteBuffers&, ErrorCondition& error) override {
        error = asio::error::would_block;
        return 0;
    }
    void asyncShutdown(OnceHandler done) override {
        stream_.async_shutdown([done = std::move(done)](ErrorCondition error) mutable { done(error, 0); });
    }
    std::string encryption() const override {
        return SSL_get_version(const_cast<Stream&>(stream_).native_handle());
    }

private:
    using Stream = ssl::stream<Socket>;
    const TlsContext context_;
    Stream stream_;
    const ssl::stream_base::handshake_type role_;
};

}  // namespace

std::unique_ptr<ByteStream> makeTlsServerStream(ByteStream::Socket socket, TlsContext context) {
    return std::make_unique<TlsStream>(std::move(socket), std::move(context), ssl::stream_base::server);
}

std::unique_ptr<ByteStream> makeTlsClientStream(ByteStream::Socket socket, TlsContext context,
                                                const std::string& host) {
    auto stream =
        std::make_unique<TlsStream>(std::move(socket), std::move(context), ssl::stream_base::client);
    stream->expect(host);
    return stream;
}

}  // namespace brickyard
